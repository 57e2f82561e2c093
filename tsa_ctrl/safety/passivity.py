"""Observe passivity in the time domain: compute the energy that the compensation adds to the joint.

If the compensation exceeds the actual friction, c h_model > h_true, it feeds the motion, and the transmission is no
longer passive. The joint's energy shows this at any frequency, even in a motion in one direction:

    E = integral of |omega_J| min(e - m h, term),     e = (tau_J - tau_J*) sgn omega_J
    excess energy:  E - g |integral of tau_J* omega_J| - L |integral of dtau_J*/dt omega_J| - z h |q_J - q_0|

    tau_J    delivered torque, from the joint torque sensor or the tendon elongation, N*m
    tau_J*   set-point, N*m
    h        friction torque of the model at the joint, N*m
    term     friction term at the joint in the direction of the motion, N*m
    m        uncertainty of the model's friction torque, 1

The last three terms bound the error of a healthy sensor: a gain error g, a delay L, and a zero error z h. They grow
with work, set-point change and displacement, not with path length. They stay small for a load that returns its energy.

`min(..., term)` limits the counted torque to the friction term. The energy of a limited torque, a falling weight or a
pulling hand is therefore not attributed to the compensation.

E decays with `MEMORY` and restarts at 0, so it is the largest energy of any window. With the correct friction it stays
at 0 while the joint moves, and a reversal leaves 0.3 mJ. The observer also predicts the energy that is added during
`REACTION`, before a back-off reaches the joint. The prediction is at most the energy already counted, because half a
swing of the motor on its tendons is not a sustained motion.

Two kinds of energy are excluded:

* The peak kinetic energy of the motor's swing against the joint, J_M/2 (omega_M - r_J/r_M omega_J)^2. A reversal that
  is planned for another sheath shape adds about 4 mJ to a motor of 6e-4 kg*m^2, and this energy decays. Only the part
  within the friction term is excluded, so a swing that sustains itself is still detected.
* The energy that the tendons return, e^2/(2 K_J), for an excess e in the new direction at a reversal. This excess
  existed before the term reversed, for example after a limit, a fade-in or a small compensation.

For a minute after a detection, the threshold and the uncertainties are halved (`wary`). A joint that is already fast
then receives less energy before the next detection.

Source: B. Hannaford, J.-H. Ryu, Time-domain passivity control of haptic interfaces, IEEE Trans. Robotics and Automation
18 (2002). Their controller adds damping. Here the guard reduces the compensation immediately, so that the
uncompensated friction damps the joint.
"""

from __future__ import annotations

import math

MEMORY = 2.0  # s, time constant of the energy: longer than a gait cycle
SENSOR = (0.03, 0.03, 0.01)  # g, z, m with a joint torque sensor: the tolerances of its data sheet
STRETCH = (0.2, 0.12, 0.1)  # g, z, m with the elongation: 10 % of the stiffness change the torque by 20 % and h by 10 %
LATE = 3e-3  # s, L: delays of drive, motor and model
REACTION = 5e-3  # s from a back-off to its torque at the joint: command, torque loop, wave fronts through the sheath
SWUNG = 0.03  # s in which the peak of a swing decays: half a period of 16 Hz, before it reaches the joint
SWING = 2.0  # of the threshold, most energy that a swing excuses: 6 mJ and the threshold's 3; at 1 rad/s a joint has 10
WARY = 0.5  # of threshold and uncertainties after a recent detection: no healthy rig reaches it
FEWEST = 2  # cycles that must agree: a single wrong sensor value is not a motion
_WILD = 1e6  # N*m: no real torque is larger, and a value that is not finite fails the same comparison


class Passivity:
    """Observe the energy that the compensation adds to the joint.

    Attributes:
        energy: added energy, J.
        cycles: number of cycles in which it was added.
        ratio: true friction torque over the model's that this energy implies, 1.
        wary: True if the axis had a detection recently.
    """

    def __init__(self, threshold: float, doubts: tuple[float, float, float], period: float, compliance: float) -> None:
        """Prepare the observer.

        Args:
            threshold: permitted energy, J.
            doubts: uncertainties g, z and m of the module docstring, 1.
            period: control period, s.
            compliance: 1/K_J of the joint, rad/(N*m).
        """
        self._threshold = threshold
        self._half_compliance = 0.5 * compliance
        self._gain, self._zero, self._model = doubts
        self._period = period
        self._keep = math.exp(-period / MEMORY)
        self._calm = math.exp(-period / SWUNG)
        self._most_swing = SWING * threshold
        self._swing = 0.0  # J, peak of a recent swing
        self._side = 0.0  # 1 or -1, direction of the joint's last motion
        self._returned = 0.0  # J that the tendons return after a reversal
        self._periods = 1  # since the last update
        self.wary = False
        self.reset()

    def reset(self) -> None:
        """Discard the accumulated energy."""
        self.energy = 0.0
        self.cycles = 0
        self._work = self._late = self._way = 0.0  # J, J/s, rad since the first of these cycles
        self._true = self._modelled = 0.0
        self._swung = self._cut = 0.0  # J, peak of a swing since then, and energy beyond the term

    def skip_cycles(self, periods: int) -> None:
        """Count periods without a cycle, which the next measurement also covers."""
        self._periods += periods

    @property
    def ratio(self) -> float:
        return self._true / self._modelled if self._modelled > 0.0 else math.nan

    def update(
        self,
        tau_j: float,
        wanted: float,
        rate: float,
        omega_j: float,
        term: float,
        half_loop: float,
        swing: float = 0.0,
    ) -> bool:
        """Return True if the added energy exceeds the threshold after this cycle.

        Args:
            tau_j: delivered torque, N*m; nan if unknown.
            wanted: set-point, N*m.
            rate: slope of the set-point, N*m/s.
            omega_j: joint velocity, rad/s.
            term: friction term as sent, at the joint, N*m.
            half_loop: friction torque of the model at the joint, N*m.
            swing: kinetic energy of the motor relative to the joint while the term reverses, J; 0 or nan if unknown.
        """
        periods, self._periods = self._periods, 1
        self._swing *= self._calm
        if swing > self._swing:
            self._swing = swing if swing < self._most_swing else self._most_swing
        side = 1.0
        if omega_j < 0.0:
            side = -1.0
            omega_j, tau_j, wanted, rate, term = -omega_j, -tau_j, -wanted, -rate, -term
        excess = tau_j - wanted
        keep = self._keep
        self._returned *= keep
        if side != self._side:
            self._side = side
            if 0.0 < excess < _WILD:
                self._returned = max(self._returned, self._half_compliance * excess * excess)
        if not -_WILD < excess < _WILD:  # also nan: this cycle has no valid torque
            return False
        over = excess - self._model * half_loop
        beyond = 0.0
        if over > term:
            given = term if term > 0.0 else 0.0
            over, beyond = given, over - given
        way = omega_j * self._period * periods
        energy = self.energy * keep + over * way
        if not energy > 0.0:
            if self.cycles:
                self.reset()
            return False
        self.energy = energy
        self.cycles += 1
        self._true += (term - excess) * way
        self._modelled += half_loop * way
        self._work = work = self._work * keep + wanted * way
        self._late = late = self._late * keep + rate * way
        self._way = moved = self._way * keep + side * way
        self._cut = cut = self._cut * keep + beyond * way
        self._swung *= keep
        if self._swing > self._swung:
            self._swung = self._swing
        coming = REACTION * over * omega_j
        foreseen = energy + (coming if coming < energy else energy)
        share = WARY if self.wary else 1.0
        threshold = share * self._threshold
        if foreseen < threshold or self.cycles < FEWEST:
            return False
        swung = self._swung - cut
        doubt = self._gain * abs(work) + LATE * abs(late) + self._zero * half_loop * abs(moved)
        return foreseen - share * doubt - (swung if swung > 0.0 else 0.0) - self._returned > threshold
