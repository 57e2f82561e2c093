"""Defaults and bounds of the tables of an axis. `tests.safety.test_limiter` tests [axis.limits]."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import pytest

from tsa_ctrl.control.settings import Component, DirectionSettings, LawSettings, SetPointSettings
from tsa_ctrl.safety.settings import OscillationSettings, PassivitySettings, PlausibilitySettings

Row = tuple[float | None, float | None, float]  # default, smallest value (None: above 0), largest value

TABLES: dict[Any, dict[str, Row]] = {
    PlausibilitySettings: {
        "torque": (None, None, 10_000.0),
        "joint_torque": (None, None, 10_000.0),
        "duration": (0.1, 0.001, 10.0),
        "slip": (None, None, 10_000.0),
    },
    PassivitySettings: {"energy": (3e-3, None, 100.0), "buzz": (0.03, None, 100.0)},
    OscillationSettings: {"speed": (0.5, None, 100.0), "duration": (1.0, None, 60.0)},  # keys of earlier versions
    DirectionSettings: {"zone": (0.005, None, 100.0), "play": (1e-6, None, 1e-3)},
    LawSettings: {
        "compensation": (0.95, 0.0, 1.2),
        "fade_in": (1.0, 0.0, 60.0),
        "slew": (10_000.0, None, 10_000.0),
        "settle": (0.03, 0.0, 0.5),
        "motor_inertia": (None, None, 1.0),
        "delay": (None, None, 0.2),
        "turn": (None, None, 0.2),
        "lead": (None, 0.0, 0.03),
        "ringing": (None, None, 2000.0),
        "damping": (None, 0.0, 100.0),
        "feedback": (0.0, 0.0, 10.0),
    },
    SetPointSettings: {
        "offset": (0.0, -1000.0, 1000.0),
        "amplitude": (0.0, -1000.0, 1000.0),
        "frequency": (0.5, None, 200.0),
        "end_frequency": (5.0, None, 200.0),
        "duration": (20.0, None, 86_400.0),
        "at": (1.0, 0.0, 86_400.0),
        "timeout": (0.2, None, 60.0),
        "rate": (50.0, None, 10_000.0),
    },
    Component: {"phase": (0.0, -7.0, 7.0)},
}
REQUIRED: dict[Any, dict[str, float]] = {Component: {"amplitude": 1.0, "frequency": 1.0}}


@pytest.mark.parametrize("table", TABLES)
def test_a_setting_has_its_default_and_is_bounded_from_both_sides(table: Any) -> None:
    """No numeric value disables a check."""
    required = REQUIRED.get(table, {})

    def read(**values: float) -> Any:
        return msgspec.convert({**required, **values}, table)

    for key, (default, least, most) in TABLES[table].items():
        assert getattr(read(), key) == default, key
        for good in (1e-9 if least is None else least, most):
            assert getattr(read(**{key: good}), key) == good
        below = 0.0 if least is None else math.nextafter(least, -math.inf)
        for bad in (below, math.nextafter(most, math.inf), math.nan):
            with pytest.raises(msgspec.ValidationError):
                read(**{key: bad})
    with pytest.raises(msgspec.ValidationError):
        read(unknown=1.0)


def test_a_set_point_is_a_constant_of_0_without_settings() -> None:
    given = SetPointSettings()
    assert (given.kind, given.components, given.file, given.loop) == ("constant", (), "", False)
