"""Compare a cause with an error of the joint torque sensor, which the catalogue does not contain.

The error of a sensor is a function of its load: of the joint torque, or of the sum of the tendon forces if the sensor
also measures axial force. A motion may couple this function to other signals. If friction exceeds the load, for
example, the sign of the joint torque follows the direction, and two gains by sign look like two different sheaths. An
effect is the only explanation of a log only if no such function explains the log as well.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from tsa_ctrl.identify.diagnosis.criteria import LEAST_SHARE
from tsa_ctrl.identify.diagnosis.fitting.fit import Fit
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem
from tsa_ctrl.identify.diagnosis.selection.step import backward_step, step_from_nominal
from tsa_ctrl.model.effects.search import INF, Coordinate, Value, Variant
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import Model, TendonSheath

# Errors as functions of the torque, with the power of the torque: two gains by sign, a wrong gain of one sign, a soft
# limit or a bridge that is not linear
LAWS = (
    ("abs(tau)", 1),
    ("(abs(tau) + tau)", 1),
    ("(abs(tau) - tau)", 1),
    ("tau**2", 2),
    ("tau*abs(tau)", 2),
    ("tau**3", 3),
)
# Half widths of a dead zone as shares of the RMS torque: a narrower one acts like an offset of either sign, and a wider
# one removes most of the torque
DEAD_ZONES = (0.1, 0.3)


def sensor_fits(problem: Problem, fitted: Fit, index: int) -> Iterator[Fit]:
    """Yield the fits with a sensor error in place of cause number `index` of `fitted`.

    Two causes may imitate a sensor error with a wrong gain or zero. The sensor error then replaces this cause together
    with one other cause. The number of free coordinates remains the same. Nothing is yielded if the logs have no torque
    sensor, or if the model file already has a formula.
    """
    if problem.base.target != "tau_j" or "custom" in problem.base.given.effects:
        return
    smaller = backward_step(problem, fitted, index)
    yield from _steps(problem, smaller, alone=True)
    for other in range(len(smaller.names)):
        yield from _steps(problem, backward_step(problem, smaller, other), alone=False)


def _steps(problem: Problem, smaller: Fit, alone: bool) -> Iterator[Fit]:
    """Yield the fits of `smaller` with each sensor error that can be computed."""
    model = smaller.hypothesis.model(smaller.point)
    for variant in _variants(problem, model, alone):
        found = step_from_nominal(problem, smaller, variant, variant.starts[0])
        if found is not None:
            yield found


def _variants(problem: Problem, model: Model, alone: bool) -> Iterator[Variant]:
    """Yield the search for each sensor error: `alone`, or with a wrong gain or zero of the sensor."""
    torque = problem.frame.target[problem.mask]
    size = float(np.std(torque))
    laws = [*LAWS]
    for width in (share * size for share in DEAD_ZONES):
        # With fewer samples inside it, a dead zone only looks like friction.
        if float(np.mean(np.abs(torque) < width)) > LEAST_SHARE:
            laws.append((f"(abs(tau + {width:.6g}) - abs(tau - {width:.6g}))", 1))
    for text, power in laws:
        law = (text, size ** (1 - power))
        yield _variant(law) if alone else _variant(law, ("tau", 1.0))
    if isinstance(model, TendonSheath) and model.friction_angle > 0.0:  # the sum of the tendon forces, by (3.55)
        forces = 2.0 * model.pretension * model.joint_pulley_radius / math.sinh(model.friction_angle)
        yield _variant((f"({forces:.9g} - sigma*tau)", 1.0)) if alone else _variant(("sigma*tau", 1.0), ("1", size))


def _variant(*terms: tuple[str, float]) -> Variant:
    """Return the search for the coefficients of these terms, each given as its text and the unit of its coefficient."""
    names = "ab"[: len(terms)]
    expression = " + ".join(f"{name}*{text}" for name, (text, _) in zip(names, terms, strict=True))

    def parameters(u: Array) -> dict[str, Value]:
        values = {name: float(value) * unit for name, value, (_, unit) in zip(names, u, terms, strict=True)}
        return {"expression": expression, "stage": "joint", **values}

    free = tuple(Coordinate(name, -INF, INF, 1e-3) for name in names)
    return Variant("custom", free, ((0.0,) * len(free),), tuple(range(len(free))), parameters)
