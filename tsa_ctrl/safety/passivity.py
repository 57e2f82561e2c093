"""Time-domain passivity observer: measure the energy that the compensation adds to the joint beyond the set-point's.

If the compensation exceeds the actual friction, c h_model > h_true, it feeds the motion. The transmission is then no
longer passive. The joint shows this at any frequency, also in a motion to one side:

    E = integral of |omega_J| min(e - m h, term),     e = (tau_J - tau_J*) sgn omega_J
    excess energy:  E - g |integral of tau_J* omega_J| - L |integral of dtau_J*/dt omega_J| - z h |q_J - q_0|

    tau_J    delivered torque, from the joint torque sensor or the tendon elongation, N*m
    tau_J*   set-point, N*m
    h        friction torque of the model at the joint, N*m
    term     friction term at the joint in the direction of the motion, N*m
    m        uncertainty of the model's friction torque, 1

The last three terms bound the error of a healthy sensor: a gain error g, a delay L, and a zero error z h. They grow
with work, distance and set-point change, not with the path. A load that returns its energy leaves little of them.

`min(..., term)` limits the count to the friction term. A torque that a limit cuts, a falling weight and a pulling hand
are therefore not attributed to the compensation.

E decays with `MEMORY` and restarts at 0, so it is the largest energy of any window. With the correct friction it stays
at 0 while the joint moves, and a reversal leaves 0.3 mJ. The energy that still passes during `REACTION`, until a
back-off reaches the joint, is predicted. The prediction is at most the energy already counted, because
half a swing of the motor on its tendons is not a sustained motion.

Two kinds of energy are excluded:

* The swing of the motor against the joint, J_M/2 (omega_M - r_J/r_M omega_J)^2 at its maximum. A reversal planned for
  another sheath shape gives a motor of 6e-4 kg*m^2 about 4 mJ, which decay. Only the part within the friction term is
  excluded, so a swing that sustains itself is still detected.
* The energy that the tendons return, e^2/(2 K_J), for an excess e in the new direction at a reversal. This excess
  existed before the term reversed, for example after a limit, a fade-in or a small compensation.

After a detection, half of the threshold and of the uncertainties apply for the next minute (`wary`). A joint that is
already fast then receives less before the next detection.

Source: B. Hannaford, J.-H. Ryu, Time-domain passivity control of haptic interfaces, IEEE Trans. Robotics and Automation
18 (2002). Their controller adds damping. Here the guard reduces the compensation at once, so that
the uncompensated friction damps the joint.
"""

from __future__ import annotations

import math

MEMORY = 2.0  # s in which energy is forgotten: longer than a gait cycle
SENSOR = (0.03, 0.03, 0.01)  # g, z, m with a joint torque sensor: what its data sheet leaves open
STRETCH = (0.2, 0.12, 0.1)  # with the stretch: 10 % of the tendons' stiffness are 20 % of the torque and 10 % of h
LATE = 3e-3  # s, L: drive, motor and the model's own delay
REACTION = 5e-3  # s from a back-off to its torque at the joint: command, torque loop, fronts through the sheath
SWUNG = 0.03  # s in which the peak of a swing decays: half a period of 16 Hz, before it reaches the joint
SWING = 2.0  # of the allowed energy that a swing excuses at most: 6 mJ and those 3, at 1 rad/s the joint has 10
WARY = 0.5  # of threshold and uncertainties after a recent detection: no healthy rig reaches it
FEWEST = 2  # cycles that must agree: one wrong value of a sensor is not a motion
_WILD = 1e6  # N*m: no real torque; values that are not finite also exceed it


class Passivity:
    """Observe the added `energy` (J) and the `ratio` of the true to the model's friction torque that it implies (1)."""

    def __init__(
        self, threshold: float, doubts: tuple[float, float, float], period: float, compliance: float = 0.0
    ) -> None:
        """Prepare the observer.

        Args:
            threshold: allowed energy, J.
            doubts: the uncertainties g, z and m of the module docstring, 1.
            period: s.
            compliance: 1/K_J of the joint, rad/(N*m).
        """
        self._threshold = threshold
        self._half_compliance = 0.5 * compliance
        self._gain, self._zero, self._model = doubts
        self._period = period
        self._keep = math.exp(-period / MEMORY)
        self._calm = math.exp(-period / SWUNG)
        self._most_swing = SWING * threshold
        self._swing = 0.0  # J, fastest recently
        self._side = 0.0  # 1 or -1, of the joint's last motion
        self._returned = 0.0  # J, that tendons return since a reversal
        self._periods = 1  # since the last update
        self.wary = False  # of a rig on which it was seen lately
        self.reset()

    def reset(self) -> None:
        """Forget all energy."""
        self.energy = 0.0
        self.cycles = 0  # for which there was some
        self._work = self._late = self._way = 0.0  # J, J/s, rad since it began
        self._true = self._modelled = 0.0
        self._swung = self._cut = 0.0  # J, fastest since then, and beyond the term

    def pass_over(self, periods: int) -> None:
        """Count periods without a cycle: the next measurement also covers them."""
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
            tau_j: delivered torque, N*m; nan where it is not known.
            wanted: set-point, N*m.
            rate: slope of the set-point, N*m/s.
            omega_j: joint velocity, rad/s.
            term: friction term as sent, at the joint, N*m.
            half_loop: friction torque of the model at the joint, N*m.
            swing: kinetic energy of the motor relative to the joint while the term reverses, J; 0 or nan if not known.
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
        if not -_WILD < excess < _WILD:  # also nan: nothing is known of this cycle
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
