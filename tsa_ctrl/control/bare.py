"""The tendons alone: measured torques without what the model's effects take on either side of them.

An estimator that fits (3.55) to torques with friction of the motor or the joint in them finds that friction in the
sheath, and the law, which adds the same effects, gives it twice. What stands beside the transmission is taken off here;
what changes friction or pretension themselves cannot be parted from them (`why_not`).
"""

from __future__ import annotations

import math

from tsa_ctrl.model.catalogue import CATALOGUE
from tsa_ctrl.model.composition import Stack
from tsa_ctrl.model.effects.joint import ACCELERATION_TIME
from tsa_ctrl.model.effects.lever import unmoved
from tsa_ctrl.model.effects.specification import Stage
from tsa_ctrl.model.filters import Memories
from tsa_ctrl.model.functions import SCALARS
from tsa_ctrl.model.parameters import TendonSheath

_WITHIN = (Stage.BENDING, Stage.PRETENSION, Stage.FRICTION, Stage.TENSION)


class Bare:
    """One axis' measurements at the tendons; `measure` every cycle, the rest when it is wanted."""

    def __init__(self, model: TendonSheath, period: float) -> None:
        """`period` in s."""
        self._stack = Stack.of(model.effects, model.source)
        self._gain = period / (ACCELERATION_TIME + period)
        self._period = period
        self._theta = model.bending_angle
        custom = self._stack.custom_at("joint")
        self._memories = Memories(()) if custom is None else custom.memories()
        self.reset()

    @property
    def remembers(self) -> bool:
        """Whether `joint` belongs to every cycle: a formula there has a memory of its torque."""
        return bool(self._memories.parts)

    def reset(self) -> None:
        """Forget the last velocity, and what a formula remembers."""
        self._memories.reset()
        self._state = unmoved(self._theta)
        self._last = math.nan

    def measure(self, sigma: float, omega_j: float, q_j: float, q_m: float) -> None:
        """One cycle's motion: 1, rad/s, rad, rad."""
        state = self._state
        self._memories.begin(self._period)
        if self._last == self._last:
            state.acceleration += self._gain * ((omega_j - self._last) / self._period - state.acceleration)
        self._last = omega_j
        state.sigma, state.q_j, state.q_m = sigma, q_j, q_m
        lag = self._stack.velocity_lag
        state.omega = omega_j if lag is None else lag.true_velocity(omega_j, state.acceleration)

    def motor(self, tau_m: float) -> float:
        """N*m on the motor's pulley, of a motor torque as the drive reports it."""
        for effect in self._stack.motor_torque:
            tau_m = effect.apply(SCALARS, tau_m, self._state)
        return tau_m

    def joint(self, tau_j: float) -> float:
        """N*m that the tendons give, of a torque that is measured or known behind the joint."""
        stack, state = self._stack, self._state
        for effect in stack.joint:
            tau_j += effect.torque(SCALARS, state)
        if (custom := stack.custom_at("joint")) is not None:
            tau_j = custom.invert(tau_j, state, self._memories)
            custom.accept(tau_j, state, self._memories)
        if stack.lever is not None:
            tau_j = stack.lever.invert(SCALARS, tau_j, state)
        return tau_j if stack.load is None else stack.load.invert(SCALARS, tau_j, state.sigma)


def why_not(model: TendonSheath) -> str:
    """Why friction angle and pretension cannot be estimated beside this model's effects; empty when they can."""
    within = [name for name in model.effects if CATALOGUE[name].stage in _WITHIN or name == "sheath_asymmetry"]
    if Stack.of(model.effects, model.source).custom_at("motor") is not None:
        within.append("custom")
    if not within:
        return ""
    return (
        f"the model's {', '.join(within)} changes what it estimates, and would count twice in the law; remove it from "
        "the model file"
    )
