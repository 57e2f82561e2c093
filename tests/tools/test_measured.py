"""bench/measured: what counts as an addition, and its table; one hidden effect on the measured axis, if it is there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tools import command
from tools.bench import measured
from tools.bench.results import Row


def report(*claims: tuple[str, ...]) -> Row:
    return {
        "verdict": "explained",
        "causes": [{"effect": effect, "alternatives": list(others)} for effect, *others in claims],
        "rms": {"noise_floor": 2.0},
        "detection_limit": {"gravity_load": 1.0, "joint_stiffness": 1.5},
    }


def row(effect: str, size: float, *claims: tuple[str, ...]) -> Row:
    return {"set": "emps", "effect": effect, "size": size, "report": report(*claims)}


@pytest.mark.parametrize(
    ("claims", "told"),
    [
        ((("torque_offset",),), "nothing"),
        ((("torque_offset",), ("gravity_load",)), "found"),
        ((("torque_offset",), ("joint_stiffness", "gravity_load")), "in a group"),
        ((("torque_offset",), ("torque_ripple",)), "wrong"),
    ],
)
def test_what_comes_in_addition_to_what_the_untouched_logs_say(claims: tuple[tuple[str, ...], ...], told: str) -> None:
    untouched = row("", 0.0, ("torque_offset",))
    assert measured.answer(row("gravity_load", 2.0, *claims), untouched) == told


def test_the_table_has_limits_answers_and_halves() -> None:
    rows = [
        row("", 0.0, ("torque_offset",)),
        row("gravity_load", 0.5, ("torque_offset",)),
        row("gravity_load", 4.0, ("torque_offset",), ("gravity_load",)),
        row(measured.HALVES, 0.0),
    ]
    head, lines = measured.table(rows)
    assert head[-2:] == ("0.5", "4")
    assert lines == [
        ("emps", "gravity_load", "0.5", "nothing", "found"),
        ("emps", measured.HALVES, "adds nothing", "", ""),
    ]


def test_what_the_base_model_has_is_no_size_of_an_effect() -> None:
    """Inertia, friction, drag and offset are projected out: an effect made of them has no size."""
    t = np.linspace(0.0, 10.0, 2000)
    omega, acceleration = np.cos(t) + 0.3 * np.cos(2.7 * t), -np.sin(t) - 0.81 * np.sin(2.7 * t)
    motions = [(np.sin(t), omega, acceleration)]
    assert measured.left_of([2.0 * acceleration + np.sign(omega) - 0.5 * omega + 1.0], motions) < 1e-9
    assert measured.left_of([np.abs(omega)], motions) > 0.1


@pytest.mark.slow
def test_a_weight_hidden_in_the_measured_axis_is_named_in_addition() -> None:
    folder = _folder("emps")
    untouched = measured.trial(folder, "", 0.0, None)
    assert "gravity_load" not in measured.names_of(untouched["report"])
    hidden = measured.trial(folder, "gravity_load", 8.0, untouched["report"])
    assert measured.answer(hidden, untouched) in ("found", "in a group")


def _folder(name: str) -> Path:
    data = command.measured_data("tools.bench.measured")
    if data is None or not (data.parent / name).is_dir():
        pytest.skip("the measured sets are not on this machine")
    return data.parent / name
