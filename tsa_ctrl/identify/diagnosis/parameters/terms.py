"""The terms that a formula of what is left may have: what transmissions are known to have and the catalogue lacks.

A lever arm, an eccentric pulley or a friction that changes with the angle (products of the load or the direction with
harmonics of q_j or q_m) or at one place in the sheath, losses that grow with speed and load, sensors that saturate or
have a dead zone, and zeros or losses that follow the temperature. What is one thing is one term of one or more parts: a
wave with its phase, a zero with the temperature at which it is right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from tsa_ctrl.identify.diagnosis.fitting.problem import Problem
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import Model, RigidDrive, TendonSheath

# Of an angle: waves of any phase once and twice a turn, a straight line, a parabola
WAVES: tuple[tuple[str, ...], ...] = (("sin({0})", "cos({0})"), ("sin(2*{0})", "cos(2*{0})"))
COURSES: tuple[tuple[str, ...], ...] = (*WAVES, ("{0}",), ("{0}**2",))
FACTORS = ("", "*tau", "*sigma", "*sigma*abs(tau)")
LOADS = ("tau", "abs(tau)", "tau*abs(tau)", "tau**3", "sigma", "sigma*tau", "sigma*abs(tau)", "sigma*tau**2")
# What a dead zone takes of a torque: all of it up to a limit, and no more beyond
DEAD_ZONE = "(abs(tau + {0}) - abs(tau - {0}))"
DEAD_ZONES = (
    0.1,
    0.3,
)  # of the RMS torque, limits: below a tenth it is an offset of either sign, above most is cut off
# What is cut off a torque beyond a limit
CUT = "sign(tau)*(abs(tau) - {0} + abs(abs(tau) - {0}))"
CUTS = (0.05, 0.2)  # of the samples, that lie beyond it: of fewer no law shows, and more are no limit of a sensor
# Friction at one place: a bump as wide as the way between two of so many places over the range of the angle
PLACES, RUB = 9, "sigma*exp(-((q_j - {0})/{1})**2)"
SPEEDS = ("omega_j", "abs(omega_j)", "omega_j*abs(omega_j)", "omega_j*abs(tau)", "tau*abs(omega_j)")
WARMTH = ("*sigma", "*omega_j", "*tau")
ONE = "1"
FURTHER = 3.0  # times narrower or wider than at the beginning that a width may come out: beyond is another term


@dataclass(frozen=True)
class Term:
    """What enters a formula as one: parts with a coefficient each, and numbers within them.

    `inside` are those numbers to begin with, `low` and `high` how far they may go; a part has {0}, {1} for them.
    """

    parts: tuple[str, ...]
    inside: tuple[float, ...] = ()
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()

    def texts(self, numbers: Sequence[object]) -> tuple[str, ...]:
        """The parts with these numbers, or names of them, inside."""
        return tuple(part.format(*numbers) for part in self.parts)


def terms(problem: Problem, model: Model, predicted: Array) -> list[Term]:
    """The terms that these logs have the signals for. predicted: N*m, (n).

    Of both angles the joint's is taken, and the motor's as it would be on stiff tendons: their difference is the
    tendons' stretch, a second measurement of the torque that is to be explained, and a wave of one against a wave of
    the other takes up any cause.
    """
    frame = problem.frame
    rigid = isinstance(model, RigidDrive)
    angles = [("q_j", COURSES)] if rigid or frame.has("q_j") else []
    if isinstance(model, TendonSheath) and frame.has("q_j") and frame.has("q_m"):
        angles.append((f"{model.joint_pulley_radius / model.motor_pulley_radius:.6g}*q_j", WAVES))
    elif frame.has("q_m") and not rigid:
        angles.append(("q_m", COURSES))
    out = [Term((text,)) for text in (*LOADS, *SPEEDS)]
    scale = max(float(np.sqrt(np.mean(np.square(frame.target[problem.mask])))), 1e-9)
    out += [_wide(DEAD_ZONE, share * scale) for share in DEAD_ZONES]
    out += [_wide(CUT, float(np.quantile(np.abs(predicted[problem.mask]), 1.0 - share))) for share in CUTS]
    for angle, courses in angles:
        for course, factor in product(courses, FACTORS):
            out.append(Term(tuple(part.format(angle) + factor for part in course)))
    if frame.has("q_j"):
        low, high = np.quantile(frame.column("q_j")[problem.mask], (0.02, 0.98))
        width = float(high - low) / (PLACES - 1)
        if width > 0.0:
            for place in np.linspace(low, high, PLACES).tolist():
                ends = (place - width, width / FURTHER), (place + width, width * FURTHER)
                out.append(Term((RUB,), (place, width), *ends))
    if frame.has("temperature"):
        warm = f"(temperature - {float(np.mean(frame.column('temperature'))):.4g})"
        out += [Term((warm, ONE)), *(Term((warm + factor,)) for factor in WARMTH)]
    return out


def _wide(text: str, number: float) -> Term:
    return Term((text,), (number,), (number / FURTHER,), (number * FURTHER,))
