"""Build a control law with its motion, direction and plan from settings, without a configuration."""

from __future__ import annotations

import math
from typing import Any

from tsa_ctrl.control.direction import Direction
from tsa_ctrl.control.law import Inverse, Law
from tsa_ctrl.control.law_design import Limits, Plan, design_law
from tsa_ctrl.control.motion_filter import Motion
from tsa_ctrl.control.settings import DirectionSettings, LawSettings
from tsa_ctrl.model.feedforward import Feedforward
from tsa_ctrl.model.parameters import TendonSheath

PERIOD = 1e-3
COUNT = 2.0 * math.pi / (1 << 20)  # rad, one count of a joint encoder


class Told(Motion):
    """A prescribed motion that records its inputs."""

    def __init__(self, noise: float = 0.0) -> None:
        self.angle = self.velocity = self.acceleration = 0.0
        self.noise = noise
        self.memory = 0.005
        self.given: list[tuple[float, bool]] = []

    def update(self, angle: float, fresh: bool = True) -> None:
        self.given.append((angle, fresh))


def plan(model: TendonSheath, **changes: Any) -> Plan:
    """Return the plan at 1 kHz with rpdo = "sync" and limits that are never reached."""
    limits = Limits(rate=1e4, torque=10.0)
    limits = limits._replace(**{key: changes.pop(key) for key in Limits._fields if key in changes})
    given = {"period": PERIOD, "transport": PERIOD, "late": 0.0, "has_encoder": True, "limits": limits}
    return design_law(model, **{**given, **changes})


def law(model: TendonSheath, inverse: Inverse | None = None, **settings: Any) -> Law:
    """Return a law.

    `settings` are keys of [axis.law], `encoder` (default True) and `unsure`, the uncertainty of a torque sensor (N*m).
    """
    has_encoder = settings.pop("encoder", True)
    unsure = settings.pop("unsure", math.inf)
    chosen = LawSettings(**settings)
    made = plan(
        model,
        has_encoder=has_encoder,
        delay=chosen.delay,
        turn=chosen.turn,
        lead=chosen.lead,
        inertia=chosen.motor_inertia,
        ringing=chosen.ringing,
        damping=chosen.damping,
    )
    motion = Motion(PERIOD, COUNT, made.lead)
    direction = Direction(
        DirectionSettings(), motion, made.lead, made.reach, model.joint_pulley_radius, PERIOD, made.give, unsure=unsure
    )
    radii = (model.motor_pulley_radius, model.joint_pulley_radius)
    return Law(inverse or Feedforward(model, PERIOD), radii, chosen, made, motion, direction, PERIOD, has_encoder)
