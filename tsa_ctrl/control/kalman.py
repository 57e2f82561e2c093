"""Estimate the friction torque recursively, and derive friction angle and pretension; a few microseconds per cycle.

    "sensor":  tau_J = -h sigma + s tau_M + c          h = 2 T_p r_J sinh x,  s = r_J/r_M cosh x,  c: sensor offset
    "motor":   tau_M =  k sigma + s tau_L + c          k = 2 T_p r_M tanh x,  tau_L: the known joint torque

A Kalman filter follows a random walk of (h, s, c). Its data are means over short blocks of steady sliding. The random
walk reduces the weight of old data. The covariance never exceeds the prior, so the filter neither diverges nor stops
adapting. The estimate does not change while no data are admitted.

The tendons slide while the joint moves. They also slide on a joint at rest as soon as the joint torque follows the
motor. After a reversal, they slide from the motor's end on, and the joint torque follows with its full slope s only
once the whole sheath slides. They stick again when the motor reverses. A joint torque sensor therefore also measures
the friction of a locked joint.

s is a nuisance parameter: cosh x is too flat to identify x from it. With `elongation_coupling` in the model, h, k and s
follow from the position of the bends. The torques of the model's effects outside the tendons are subtracted first
(`EffectRemoval`).
"""

from __future__ import annotations

import math

from tsa_ctrl.control.estimator import EstimateState, GatedEstimator, Sample, Split
from tsa_ctrl.control.settings import EstimatorSettings
from tsa_ctrl.model.catalogue import CATALOGUE
from tsa_ctrl.model.composition import Stack
from tsa_ctrl.model.effects.joint import ACCELERATION_TIME
from tsa_ctrl.model.effects.lever import unmoved
from tsa_ctrl.model.effects.specification import Stage
from tsa_ctrl.model.filters import Memories
from tsa_ctrl.model.functions import SCALARS
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.steady_sliding import reversal_travel, sliding

_WITHIN = (Stage.BENDING, Stage.PRETENSION, Stage.FRICTION, Stage.TENSION)


class EffectRemoval:
    """Subtract the torques of the model's effects outside the tendons; call `measure` in every cycle.

    An estimator without this subtraction attributes the friction of motor and joint to the sheath. The law, which adds
    the same effects, would then compensate that friction twice.
    """

    def __init__(self, model: TendonSheath, period: float) -> None:
        """Prepare the effects; `period` in s."""
        self._stack = Stack.of(model.effects, model.source)
        self._period = period
        self._theta = model.bending_angle
        custom = self._stack.custom_at("joint")
        self._memories = Memories(()) if custom is None else custom.memories()
        self.reset()

    @property
    def remembers(self) -> bool:
        """Return True if `joint` must be called in every cycle, because a formula there has a memory of its torque."""
        return bool(self._memories.parts)

    def reset(self) -> None:
        """Reset the last velocity and the memory of a formula."""
        self._memories.reset()
        self._state = unmoved(self._theta)
        self._last = self._time = math.nan

    def measure(self, seen: Sample) -> None:
        """Store the measurements of one cycle; a late loop may have skipped cycles since the last one."""
        state, omega_j = self._state, seen.omega_j
        elapsed = seen.t - self._time
        if not elapsed > 0.0:
            elapsed = self._period
        self._time = seen.t
        self._memories.begin(elapsed)
        if math.isfinite(omega_j - self._last):
            gain = elapsed / (ACCELERATION_TIME + elapsed)
            state.acceleration += gain * ((omega_j - self._last) / elapsed - state.acceleration)
        self._last = omega_j
        state.sigma, state.q_j, state.q_m = seen.sigma, seen.q_j, seen.q_m
        state.temperature, state.t = seen.temperature, seen.t
        lag = self._stack.velocity_lag
        state.omega = omega_j if lag is None else lag.true_velocity(omega_j, state.acceleration)

    def motor(self, tau_m: float) -> float:
        """Return the torque on the motor pulley for the motor torque that the drive reports, both in N*m."""
        return self._stack.on_the_pulley(SCALARS, tau_m, self._state)

    def joint(self, tau_j: float) -> float:
        """Return the torque of the tendons for a torque that is measured or known behind the joint, both in N*m."""
        stack, state = self._stack, self._state
        for effect in stack.joint:
            tau_j += effect.torque(SCALARS, state)
        if (custom := stack.custom_at("joint")) is not None:
            tau_j = custom.invert(tau_j, state, self._memories)
            custom.accept(tau_j, state, self._memories)
        if stack.lever is not None:
            tau_j = stack.lever.invert(SCALARS, tau_j, state)
        return tau_j if stack.load is None else stack.load.invert(SCALARS, tau_j, state.sigma)


def unsupported_reason(model: TendonSheath, has_temperature: bool = False) -> str:
    """Return the reason why the model's effects prevent an estimate of friction angle and pretension, else "".

    `has_temperature`: True if the axis measures the temperature.
    """
    within = [name for name in model.effects if CATALOGUE[name].stage in _WITHIN or name == "sheath_asymmetry"]
    if Stack.of(model.effects, model.source).custom_at("motor") is not None:
        within.append("custom")
    if within:
        return (
            f"the model's {', '.join(within)} changes the estimated quantity, and would count twice in the law; "
            "remove it from the model file"
        )
    for name, parameters in model.effects.items():
        if not has_temperature and ("temperature",) in CATALOGUE[name].needed_live(parameters):
            return (
                f"the model's {name} depends on the temperature, which this axis does not measure; give "
                "[axis.temperature] a source, or remove the effect from the model file"
            )
    return ""


BLOCK = 0.01  # s, length of the means that enter the filter
SLIDING = 0.999  # 1, |sigma| above which the sheath is certain to slide
NOISE = 0.05  # 1, model error of a block mean over the nominal friction torque, without the sensor's noise
OUTLYING = 2.0  # standard deviations to which an innovation is limited; a jerk or a withdrawn term causes larger ones
BOTH_WAYS = 0.3  # s of admitted motion, within memory, that each direction needs
CERTAIN = 0.1  # 1, standard deviation of the friction torque over nominal, below which it counts as estimated
PULLING = 0.95  # 1, share of the motor torque at which a tendon goes slack, up to which both are certain to pull
# Share of the travel in which a reversal runs through a sheath that bends at the motor, after which a moving joint
# counts as sliding. With 0.3, reversals still make the estimate too small there. With 1, it has too few samples on
# random rigs.
GATE = 0.5
FOLLOWS = 0.9  # of the slope s, which is known within a tenth; less shows that a part of the sheath still sticks


class KalmanEstimator(GatedEstimator):
    """Implement the estimator kinds "sensor" and "motor"."""

    def __init__(self, model: TendonSheath, settings: EstimatorSettings, period: float) -> None:
        # The errors of reversals make this estimate rise and fall. If it fell faster, it would be too small on average.
        super().__init__(model, settings, period, down=1.0)
        self._motor = settings.kind == "motor"
        self._removal = EffectRemoval(model, period) if model.effects else None
        self._split = Split(model, settings.attribute, self._motor, settings.bounds)
        per_torque = 0.5 * (sliding(model, 1.0).slope + sliding(model, -1.0).slope)
        half, slope = self._split.nominal, 1.0 / per_torque if self._motor else per_torque
        self._prior = (half, slope, 0.0)
        self._variance = ((settings.bounds * half) ** 2, (0.1 * slope) ** 2, (0.1 * half) ** 2)
        self._noise = (NOISE * half) ** 2
        self._walk = BLOCK / settings.memory
        self._period = period
        self._block = max(1, round(BLOCK / period))
        self._settle = settings.settle
        self._least_speed = settings.least_speed
        self._gate = GATE * reversal_travel(model)  # rad of the joint
        transmission = Stack.of(model.effects, model.source).transmission(model)
        self._pulling = tuple(
            tuple(PULLING * end for end in transmission.limits(sigma, model.friction_angle, model.pretension))
            for sigma in (-1.0, 1.0)
        )
        self._followed = 2.0 * NOISE * half  # N*m of the joint: two standard deviations of a block
        self._most_change = settings.most_acceleration * self._block * period if self._motor else math.inf
        self._load = settings.known_load
        self._worst = settings.residual**2
        self.reset()

    def reset(self) -> None:
        """Return to the model file's values without an estimate, and discard all data."""
        super().reset()
        self.half_loop, self.slope, self.offset = self._prior
        self.residual = 0.0
        self._seen = [0.0, 0.0]
        self._p = [self._variance[0], 0.0, 0.0, self._variance[1], 0.0, self._variance[2]]  # upper triangle
        self._direction = 0
        self._tau_m = self._tau_j = 0.0
        self._first_omega, self._moved = 0.0, False
        self._begin_stroke()
        if self._removal is not None:
            self._removal.reset()

    @property
    def half_loop_ratio(self) -> float:
        """Return the friction torque over the model file's value, 1; nan while it is not estimated."""
        return self.half_loop / self._split.nominal if self.state is EstimateState.ESTIMATED else math.nan

    def update(self, seen: Sample) -> None:
        """Process the data of one cycle."""
        sigma, omega_j, tau_m, tau_j = seen.sigma, seen.omega_j, seen.tau_m, seen.tau_j
        removal = self._removal
        if removal is not None:
            removal.measure(seen)
            if removal.remembers:
                removal.joint(self._load if self._motor else tau_j)
        direction = 1 if sigma > SLIDING else -1 if sigma < -SLIDING else 0
        moves = omega_j * direction > self._least_speed
        if self._motor and not moves:  # without a torque sensor, it is unknown if a joint at rest follows
            direction = 0
        if direction != self._direction or not seen.admit:
            self._direction = direction
            self._begin_stroke()
        elif direction:
            self._since += self._period
            self._way += abs(omega_j) * self._period
            low, high = self._pulling[direction > 0]
            if self._since > self._settle and low < tau_m < high:
                known = self._load if self._motor else tau_j
                if removal is not None:
                    tau_m, known = removal.motor(tau_m), removal.joint(known)
                self._admit(direction, omega_j, moves, tau_m, known)
        self._approach()

    def _begin_stroke(self) -> None:
        self._since, self._way, self._count = 0.0, 0.0, 0
        self._farthest = -math.inf  # N*m, largest motor torque along the direction
        self._begun = -math.inf, math.inf  # N*m along the direction, motor and joint torque from which it must follow
        self._slides = False  # the joint torque has followed the motor torque over the last `_followed`

    def _admit(self, direction: int, omega_j: float, moves: bool, tau_m: float, tau_j: float) -> None:
        if self._count == 0:
            self._tau_m = self._tau_j = 0.0
            self._first_omega = omega_j
            self._moved = True
        self._count += 1
        self._tau_m += tau_m
        self._tau_j += tau_j
        self._moved = self._moved and moves and self._way > self._gate
        if self._count < self._block:
            return
        tau_m, tau_j = self._tau_m / self._count, self._tau_j / self._count
        self._count = 0
        if abs(omega_j - self._first_omega) > self._most_change:
            return
        if not (self._follows(tau_m * direction, tau_j * direction) or self._moved):
            return
        if self._motor:
            self._learn(float(direction), tau_j, tau_m)
        else:
            self._learn(-float(direction), tau_m, tau_j)
        forget = 1.0 - self._walk
        self._seen[0] *= forget
        self._seen[1] *= forget
        self._seen[direction > 0] += self._block * self._period
        self._judge()

    def _follows(self, tau_m: float, tau_j: float) -> bool:
        """Return True if the joint torque follows the motor torque on the model's line (N*m along the direction)."""
        farther = tau_m >= self._farthest
        self._farthest = max(self._farthest, tau_m)
        begun_m, begun_j = self._begun
        if tau_j > begun_j + self._followed:
            self._slides = tau_j - begun_j > FOLLOWS * self.slope * (tau_m - begun_m)
            self._begun = tau_m, tau_j
        elif tau_j < begun_j:
            self._begun = tau_m, tau_j
        return farther and self._slides

    def _learn(self, a: float, b: float, y: float) -> None:
        """Do one Kalman step for y = a h + b s + c."""
        if not math.isfinite(b + y):
            self.residual = math.inf
            return
        p00, p01, p02, p11, p12, p22 = self._p
        v0, v1, v2 = self._variance
        p00 = min(p00 + self._walk * v0, v0)
        p11 = min(p11 + self._walk * v1, v1)
        p22 = min(p22 + self._walk * v2, v2)
        g0 = p00 * a + p01 * b + p02
        g1 = p01 * a + p11 * b + p12
        g2 = p02 * a + p12 * b + p22
        error = y - a * self.half_loop - b * self.slope - self.offset
        variance = self._noise + a * g0 + b * g1 + g2
        scale = 1.0 / variance
        most = OUTLYING * math.sqrt(variance)
        gain = max(-most, min(most, error)) * scale
        self.half_loop += g0 * gain
        self.slope += g1 * gain
        self.offset += g2 * gain
        self._p = [
            p00 - g0 * g0 * scale, p01 - g0 * g1 * scale, p02 - g0 * g2 * scale,
            p11 - g1 * g1 * scale, p12 - g1 * g2 * scale, p22 - g2 * g2 * scale,
        ]  # fmt: skip
        after = y - a * self.half_loop - b * self.slope - self.offset
        if not math.isfinite(self.residual):
            self.residual = 0.0
        self.residual += self._walk * 4.0 * (after * after - self.residual)

    def _judge(self) -> None:
        """Change the state if the data are certain enough or contradict the model."""
        certain = self._p[0] < (CERTAIN * self._split.nominal) ** 2 and min(self._seen) > BOTH_WAYS
        angle, pretension, inside = self._split.solve(self.half_loop)
        if self.residual > self._worst or (certain and not inside):
            self._refuse()
        elif certain:
            self._accept(angle, pretension)
