"""Combine the friction torque by the joint torque sensor with that by the tendon elongation.

A torque sensor alone proves nothing: an unplugged, reversed or miscalibrated one shows the compensation itself as
friction. A second measurement must agree:

* The sensor counts while it follows the changes of the torque by the elongation, or by the motor while the tendons
  slide (`SensorEvidence`). An unplugged sensor shows no changes, and a reversed one the opposite changes. Its weight
  fades with the travel since the last change.
* Without such changes, the sensor counts up to the upper bound of the friction by the elongation. If it shows more, the
  elongation counts instead.
* Before the sensor has followed a change, and before the tendons have slid in both directions, nothing can contradict
  the sensor. It then limits the compensation, but does not prove it: an energy credit covers the whole term
  (`control.compensation_limit`).
* An axis without a usable elongation has the sensor alone.
"""

from __future__ import annotations

import math

from tsa_ctrl.observer.proven_friction import MEMORY, ProvenFriction

LATELY = 1.0  # s over which changes of sensor and elongation are compared: a stroke
BRIEFLY = 0.2  # s over which sensor and motor torque are compared while the tendons slide, at least half of it
EVERY = 4  # cycles between two samples of the elongation next to a sensor, which limits the computing time
# 1, of the friction torque: standard deviation of the torque by the elongation from which the sensor must follow it.
# Half of it is the noise of an encoder with 12 bit; 0.75 of the file's friction causes 0.1 at a set-point of 0.
EVIDENT = 0.07
# 1, the same where correlation with the sensor excludes noise. A good compensation leaves only small changes.
FAINT = 0.02
# 1, of the change by the elongation: least share that the sensor must show. An unplugged sensor shows nothing, and a
# reversed one the negative. With 0.5, a correct sensor counted a stroke later on a rig with an inaccurate file.
SHOWN = 0.35
# 1, least correlation of sensor and elongation without their common dependence on the motor torque. Correct sensors
# have 0.8 to 1 on random rigs with an inaccurate file, as soon as the joint moves.
ALIKE = 0.7


class SensorEvidence:
    """Compare the changes of the joint torque by its sensor with the other measurements, in three ways.

    1. With the estimate of the observer, whose error is large while friction, stiffness or bends of the file are wrong.
    2. With the elongation itself, s = c_M tau_M + c_J tau_J + constant. Regression on tau_M eliminates c_M, and thereby
       friction and stiffness of the file. The rest of s must follow the rest of the sensor. This requires that tau_M
       and tau_J do not change in proportion, as they do until the tendons reverse.
    3. With the motor torque, while the tendons slide in one direction: tau_J = a tau_M - b, whatever the friction at a
       constant wrap angle. The change of b with the wrap angle is that of the model. If the set-point is constant, a
       correct sensor shows the change of the torque when the proof fades. A sensor that fails during a motion
       contradicts the motor within about `BRIEFLY`, before the other comparisons forget it.

    Attributes: `slopes`: a of a joint that moves forward and backward, 1.
    """

    def __init__(
        self, half_loop: float, period: float, gearing: float, per_angle: tuple[float, float] = (0.0, 0.0)
    ) -> None:
        """Prepare the comparison.

        Args:
            half_loop: friction torque at the joint, N*m.
            period: s.
            gearing: r_J/r_M, used as `slopes` until they are set.
            per_angle: joint torque per angle of motor and of joint by the elongation, with constant motor torque,
                N*m/rad.
        """
        self._least, self._faint = (EVIDENT * half_loop) ** 2, (FAINT * half_loop) ** 2
        self._period = EVERY * period
        self._forget, self._forget_briefly = self._period / LATELY, self._period / BRIEFLY
        self.slopes = (gearing, gearing)
        self._per_motor, self._per_joint = per_angle
        self.reset()

    def reset(self) -> None:
        """Forget all measurements."""
        self._means = (math.nan,) * 4  # N*m: sensor, observer, elongation, motor
        self._products = (0.0,) * 8  # (N*m)^2, of the deviations from the means
        self._sliding, self._slid = 0, 0.0  # direction in which the tendons slide, and s since they do
        self._brief = (0.0,) * 9  # within `BRIEFLY`: means of sensor, motor at the joint and velocity, and products
        self._since = math.inf  # rad of travel since the sensor last followed the elongation
        self._wait = 0  # cycles

    @property
    def weight(self) -> float:
        """Return the part of the proof by the sensor that is left, 1 to 0.

        It fades around `MEMORY`. A good compensation at a small set-point leaves nothing to follow, and a sudden end
        would be a step of the torque. A gradual one is itself a change that a correct sensor follows.
        """
        return min(1.0, max(0.0, 1.5 - self._since / MEMORY))

    @property
    def follows(self) -> bool:
        """Return True if the sensor has followed another measurement within the last `MEMORY` of travel."""
        return self._since < MEMORY

    def update(
        self,
        sensor: float,
        estimate: float,
        tau_m: float,
        q_m: float,
        q_j: float,
        confirmed: bool,
        omega_j: float,
        sliding: int = 0,
        friction: float = 0.0,
    ) -> None:
        """Process a cycle.

        Args:
            sensor, estimate: joint torque by the sensor and by the observer of the elongation, N*m.
            tau_m, q_m: torque and angle of the motor, N*m and rad.
            q_j, omega_j: angle and velocity of the joint, rad and rad/s.
            confirmed: True unless the elongation contradicts the motor torque, for example by an unknown effect. It is
                then no evidence against the sensor.
            sliding: direction in which the tendons slide, 1 or -1; 0 while unknown.
            friction: friction torque of the model at the present wrap angle, N*m at the motor. Only its changes count.
        """
        self._wait -= 1
        if self._wait > 0:
            return
        self._wait = EVERY
        forget = self._forget
        stretch = self._per_motor * q_m - self._per_joint * q_j
        s, e, y, m = self._means
        if s != s:
            s, e, y, m = sensor, estimate, stretch, tau_m
        ds, de, dy, dm = sensor - s, estimate - e, stretch - y, tau_m - m
        self._means = (s + forget * ds, e + forget * de, y + forget * dy, m + forget * dm)
        ss, ee, yy, mm, se, sy, sm, ym = self._products
        ss += forget * (ds * ds - ss)
        ee += forget * (de * de - ee)
        yy += forget * (dy * dy - yy)
        mm += forget * (dm * dm - mm)
        se += forget * (ds * de - se)
        sy += forget * (ds * dy - sy)
        sm += forget * (ds * dm - sm)
        ym += forget * (dy * dm - ym)
        self._products = ss, ee, yy, mm, se, sy, sm, ym
        motor = self.slopes[sliding < 0] * (tau_m - sliding * friction)
        if sliding != self._sliding:
            self._sliding, self._slid, self._brief = sliding, 0.0, (sensor, motor, omega_j, *(0.0,) * 6)
        follows = self._follows_motor(sensor, motor, omega_j) if sliding != 0 else 0
        self._since += abs(omega_j) * self._period
        least, faint = self._least, self._faint
        if mm > 0.0:  # the parts of sensor and elongation that the motor torque does not explain
            ss -= sm * sm / mm
            yy -= ym * ym / mm
            sy -= sm * ym / mm
        clear = (yy > faint or ss > faint) and sy * sy > ALIKE * ALIKE * ss * yy > 0.0
        if follows < 0:
            self._since = math.inf
        elif (
            follows > 0 or (clear and sy > SHOWN * yy) or (ee > least and se > SHOWN * ee and not (clear and sy < 0.0))
        ):
            self._since = 0.0
        elif (clear and sy < 0.0) or (ee > least and confirmed):
            self._since = math.inf

    def _follows_motor(self, sensor: float, motor: float, omega: float) -> int:
        """Return 1 if the sensor follows the motor torque, -1 if it does not, and 0 without evidence.

        Friction may grow with the velocity. The part of the motor torque that is proportional to the velocity is
        therefore no evidence against the sensor.
        """
        forget = self._forget_briefly
        s, m, w, ss, mm, ww, sm, sw, mw = self._brief
        ds, dm, dw = sensor - s, motor - m, omega - w
        ss += forget * (ds * ds - ss)
        mm += forget * (dm * dm - mm)
        ww += forget * (dw * dw - ww)
        sm += forget * (ds * dm - sm)
        sw += forget * (ds * dw - sw)
        mw += forget * (dm * dw - mw)
        self._brief = s + forget * ds, m + forget * dm, w + forget * dw, ss, mm, ww, sm, sw, mw
        self._slid += self._period
        if not self._slid > 0.5 * BRIEFLY:
            return 0
        if mm > self._faint and sm > SHOWN * mm and sm * sm > ALIKE * ALIKE * ss * mm:
            return 1
        if ww > 0.0:
            mm -= mw * mw / ww
            sm -= sw * mw / ww
        return -1 if mm > self._least and sm < SHOWN * mm else 0


class FrictionProof:
    """Bound the friction torque of an axis by the measurements that it has.

    Attributes: `low`, `middle`, `high`: proven lower bound, estimate and upper bound of the friction torque at the
    motor, N*m; 0, inf and inf while unproven. `reads`: True if this cycle has a reading, False if the bounds come from
    earlier cycles. `contradicted`: True while the sensor shows more friction than the elongation permits.
    """

    def __init__(
        self, by_sensor: ProvenFriction | None, by_elongation: ProvenFriction | None, evidence: SensorEvidence
    ) -> None:
        """Combine the measurements that the axis has; None is a missing one.

        Next to a sensor, the measurement by the elongation has the period of `EVERY` cycles.
        """
        self._sensor, self._elongation = by_sensor, by_elongation
        self._parts = tuple(part for part in (by_sensor, by_elongation) if part is not None)
        self._first = self._parts[0] if self._parts else None
        self._both = len(self._parts) == 2
        self._wait = 0  # cycles until the next update by the elongation
        self._trusted = False
        self.evidence = evidence
        self.contradicted = False
        self._combine()

    @property
    def usable(self) -> bool:
        """Return True if a sensor at the joint can prove friction."""
        return self._first is not None

    @property
    def confirms_sensor(self) -> bool:
        """Return True unless the sensor contradicts the elongation, or has not been compared with it yet."""
        return not self._both or (not self.contradicted and self._weight == 1.0)

    @property
    def confirms_file(self) -> bool:
        """Return True if the friction itself was measured twice, or if the axis has only one measurement."""
        return not self._both or (not self.contradicted and self._is_certain)

    @property
    def _weight(self) -> float:
        return 1.0 if self._is_certain else self.evidence.weight

    @property
    def _is_certain(self) -> bool:
        return self._elongation is not None and self._elongation.certain

    @property
    def modelled(self) -> float:
        """Return the friction torque of the model file at the present wrap angle, N*m at the motor."""
        return 0.0 if self._first is None else self._first.modelled

    @property
    def trusted(self) -> bool:
        """Return True if a tuning of this joint wrote the model file."""
        return self._trusted

    @trusted.setter
    def trusted(self, value: bool) -> None:
        self._trusted = value
        for part in self._parts:
            part.trusted = value

    def set_slopes(self, slopes: tuple[float, float]) -> None:
        """Use d tau_J / d tau_M of a joint that moves forward and backward, 1."""
        if self._sensor is not None:
            self._sensor.slopes = slopes
            self.evidence.slopes = slopes

    def reset(self) -> None:
        """Forget all measurements, including the zero of the elongation."""
        for part in self._parts:
            part.reset()
        self.evidence.reset()
        self.contradicted = False
        self._combine()

    def pause(self) -> None:
        """Skip a cycle without torque."""
        for part in self._parts:
            part.pause()
        self.reads = False

    def miss(self, seconds: float) -> None:
        """Skip `seconds` without measurements."""
        for part in self._parts:
            part.miss(seconds)
        self._combine()

    def update(
        self,
        tau_m: float,
        omega_m: float,
        q_m: float,
        q_j: float,
        tau_j: float,
        velocity: float,
        turning: bool,
        modelled: float,
    ) -> None:
        """Process the measurements of one cycle, see `ProvenFriction.update`."""
        if self._first is not None:
            self._first.update(tau_m, omega_m, q_m, q_j, tau_j, velocity, turning, modelled)
        if self._both and self._elongation is not None:
            self._wait -= 1
            if self._wait <= 0:
                self._wait = EVERY
                self._elongation.update(tau_m, omega_m, q_m, q_j, tau_j, velocity, turning, modelled)
        self._combine()

    def compare(
        self, sensor: float, estimate: float, tau_m: float, q_m: float, q_j: float, confirmed: bool, omega_j: float
    ) -> None:
        """Compare the changes of both measurements, if the axis has both; see `SensorEvidence.update`."""
        if self._both and sensor == sensor and estimate == estimate:
            sliding = self._first.sliding if self._first is not None else 0
            self.evidence.update(sensor, estimate, tau_m, q_m, q_j, confirmed, omega_j, sliding, self.modelled)

    def _combine(self) -> None:
        used = self._first
        if used is None:
            self.low, self.middle, self.high, self.reads = 0.0, math.inf, math.inf, False
            return
        elongation, weight = self._elongation, 1.0
        if self._both and elongation is not None:
            weight = self._weight
            if used.reads:
                shown = 0.5 * (used.low + used.high)
                self.contradicted = shown > elongation.high and not self.evidence.follows
            if self.contradicted:
                used = elongation
        self.low, self.middle, self.high = weight * used.low, 0.5 * (used.low + used.high), used.high
        self.reads = used.reads
