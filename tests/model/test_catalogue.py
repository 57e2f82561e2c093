"""The catalogue of effects as data."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from tsa_ctrl.model.catalogue import CATALOGUE, check_effects
from tsa_ctrl.model.effects import EFFECTS
from tsa_ctrl.model.effects.search import Scales
from tsa_ctrl.model.effects.specification import Draw, Parameter, Specification, Stage

STAGES = list(Stage)


def test_order_of_the_table_is_the_order_of_composition() -> None:
    """The stages are in ascending order, and no effect replaces another of the same name."""
    order = [STAGES.index(spec.stage) for spec in CATALOGUE.values()]
    assert order == sorted(order)
    assert len(CATALOGUE) == len(EFFECTS)


@pytest.mark.parametrize("spec", CATALOGUE.values(), ids=list(CATALOGUE))
def test_what_is_hidden_is_allowed(spec: Specification) -> None:
    """Ten random trials of the demo are within the effect's bounds."""
    rng = np.random.default_rng(3)
    for _ in range(10 if spec.demo else 0):
        drawn = {key: size.value(rng) if isinstance(size, Draw) else size for key, size in (spec.demo or {}).items()}
        check_effects({spec.name: drawn}, "demo")


def test_twins_are_written_once_and_exist() -> None:
    """Each indistinguishable pair is listed at one of its two effects. The names are effects or parameter_error.

    An exclusion of an unknown name would have no effect.
    """
    assert {other for spec in CATALOGUE.values() for other in spec.excludes} <= set(CATALOGUE)
    pairs = [frozenset({name, other}) for name, spec in CATALOGUE.items() for t in spec.twins for other in t.names]
    assert len(pairs) == len(set(pairs))
    assert {name for pair in pairs for name in pair} <= {*CATALOGUE, "parameter_error"}


SCALES = Scales(
    torque=0.5,
    motor_torque=0.4,
    largest_motor_torque=1.1,
    speed=1.2,
    speed_noise=0.005,
    acceleration=6.0,
    reach=0.5,
    middle=0.1,
    motor_reach=0.6,
    motor_step=0.002,
    begin=0.0,
    seconds=60.0,
    period=0.002,
    heating=12.0,
    bending=0.3,
    derived_velocity="",
    plain=False,
    offset=False,
    joints={"hip": 0.5, "ankle": 0.3},
)


@pytest.mark.parametrize("spec", CATALOGUE.values(), ids=list(CATALOGUE))
def test_a_fit_starts_within_the_bounds(spec: Specification) -> None:
    """Every start, with its amplitudes set to 0.1, is a valid table of a model file."""
    assert not spec.untestable(SCALES)
    variants = spec.search(spec.name, SCALES)
    assert bool(variants) is spec.hypothesis  # a diagnosis never proposes the user's own formula
    for variant in variants:
        for start in (*variant.starts, *variant.full_strength):
            point = np.array(start)
            point[[i for i in variant.amplitude if point[i] == 0.0]] = 0.1
            assert all(c.low <= u <= c.high for c, u in zip(variant.coordinates, point, strict=True))
            check_effects({spec.name: variant.parameters(point)}, variant.label)


def test_logs_that_cannot_show_an_effect() -> None:
    """The temperature varies too little, the path length is constant, and the velocity is derived from the angle."""
    poor = dataclasses.replace(SCALES, heating=0.1, bending=0.0, derived_velocity="omega_j")
    said = {name: spec.untestable(poor) for name, spec in CATALOGUE.items() if spec.untestable(poor)}
    assert said == {
        "velocity_lag": "omega_j was derived from the angle by a zero-phase filter",
        "stiffness_nonlinearity": "the path length does not vary (no column theta that changes)",
        "thermal_friction_drift": "the temperature varies by only 0.1 K",
    }


def test_without_a_motor_angle_nothing_follows_it() -> None:
    """Torque ripple is not searched, and presliding depends on the joint alone."""
    blind = dataclasses.replace(SCALES, motor_step=math.nan)
    assert not CATALOGUE["torque_ripple"].search("torque_ripple", blind)
    labels = [v.label for v in CATALOGUE["presliding_hysteresis"].search("presliding_hysteresis", blind)]
    assert labels == [f"{n} elements, joint" for n in (1, 2, 4, 8)]


def test_defaults_are_filled_in() -> None:
    """A file may omit the defaults of the catalogue. A value that depends on the log is not filled in."""
    assert check_effects({"pretension_relaxation": {"relaxed_fraction": 0.1, "time_constant": 9}}, "file") == {
        "pretension_relaxation": {"relaxed_fraction": 0.1, "time_constant": 9.0, "law": "exponential"}
    }


@pytest.mark.parametrize(
    ("parameter", "accepted", "refused"),
    [
        (Parameter("1", low=0.0), (0, 0.0, 5.0), (-1e-9, math.nan, math.inf, "1", True, None)),
        (Parameter("1", low=0.0, low_open=True), (1e-9,), (0.0,)),
        (Parameter("1", low=-2.0, high=2.0, low_open=True, high_open=True), (1.99,), (-2.0, 2.0)),
        (Parameter("1", low=1, integer=True), (1, 4.0), (0, 1.5)),
        (Parameter("1", choices=("a", "b")), ("a",), ("c", 1)),
    ],
)
def test_bounds(parameter: Parameter, accepted: tuple[object, ...], refused: tuple[object, ...]) -> None:
    """Bounds are open or closed, and there are integers and choices. Numbers must be finite."""
    assert all(parameter.accepts(value) for value in accepted)
    assert not any(parameter.accepts(value) for value in refused)
