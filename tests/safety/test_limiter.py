"""The limiter: a fault sets the torque to 0 at once, limits reduce it, and it never exceeds the request."""

from __future__ import annotations

import ast
import math
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tsa_ctrl.safety import limiter as module
from tsa_ctrl.safety.limiter import Limiter, LimiterSettings, Reason

PERIOD = 1e-3
SETTINGS = LimiterSettings(
    torque=2.0,
    rate=100.0,
    distance=1.0,
    joint_speed=10.0,
    over_speed=20.0,
    motor_over_speed=40.0,
    travel=(-1.0, 1.5),
    travel_margin=0.1,
)
CALM: dict[str, Any] = {
    "enabled": True,
    "fresh": True,
    "tau_m": 0.0,
    "omega_m": 0.0,
    "q_j": 0.0,
    "omega_j": 0.0,
}
LOOSE = LimiterSettings(
    over_speed=20.0,
    motor_over_speed=40.0,
    torque=2.0,
    rate=1e5,
    distance=100.0,
    travel=(-1.0, 1.5),
    travel_margin=0.125,
)


@pytest.mark.parametrize(
    ("wanted", "change", "reason"),
    [
        (1.5, {"enabled": False}, Reason.DISABLED),
        (1.5, {"fresh": False}, Reason.STALE),
        (math.nan, {}, Reason.NOT_FINITE),
        (math.inf, {}, Reason.NOT_FINITE),
        (-math.inf, {}, Reason.NOT_FINITE),
        (1.5, {"tau_m": math.nan}, Reason.NOT_FINITE),
        (1.5, {"omega_m": math.inf}, Reason.NOT_FINITE),
        (1.5, {"q_j": math.nan}, Reason.NOT_FINITE),
        (1.5, {"omega_j": -math.inf}, Reason.NOT_FINITE),
        (1.5, {"omega_j": 20.0}, Reason.OVER_SPEED),
        (1.5, {"omega_j": -20.0}, Reason.OVER_SPEED),
        (1.5, {"omega_m": 40.0}, Reason.OVER_SPEED),
        (1.5, {"omega_m": -40.0}, Reason.OVER_SPEED),
    ],
)
def test_fault_gives_zero_in_the_same_cycle(wanted: float, change: dict[str, Any], reason: Reason) -> None:
    """After a fault the torque is exactly 0 at once, and the fault is the reason."""
    limiter = Limiter(LOOSE, PERIOD)
    limiter.update(1.5, **CALM)
    assert limiter.update(wanted, **{**CALM, **change}) == (0.0, reason)


def test_over_speed_latches_until_reset() -> None:
    """After over-speed the torque stays 0 at standstill and through a disable, until an explicit reset."""
    limiter = Limiter(LOOSE, PERIOD)
    limiter.update(1.0, **{**CALM, "omega_m": 41.0})
    limiter.update(1.0, **{**CALM, "enabled": False})
    assert limiter.update(1.0, **CALM) == (0.0, Reason.OVER_SPEED)
    limiter.reset()
    assert limiter.update(1.0, **CALM) == (1.0, Reason.NONE)


@pytest.mark.parametrize("speed", [19.999, -19.999])
def test_over_speed_boundary(speed: float) -> None:
    """Just below the over-speed limit, nothing latches."""
    limiter = Limiter(SETTINGS, PERIOD)
    limiter.update(0.0, **{**CALM, "omega_j": speed})
    assert not limiter.over_speed


@pytest.mark.parametrize(
    ("wanted", "change", "torque", "reason"),
    [
        (0.3, {}, 0.3, Reason.NONE),
        (0.5, {"omega_j": 8.0}, 0.5, Reason.NONE),  # 80 % of the joint speed is still unlimited
        (-0.5, {"omega_j": -8.0}, -0.5, Reason.NONE),
        (1e-3, {"omega_j": math.nextafter(8.0, 10.0)}, 1e-3, Reason.SPEED),  # the size of the power does not matter
        (1e-3, {"omega_j": 9.0}, 0.5e-3, Reason.SPEED),
        (1.0, {"omega_j": 10.0}, 0.0, Reason.SPEED),
        (-1.0, {"omega_j": -15.0}, 0.0, Reason.SPEED),
        (1.0, {"omega_j": -15.0}, 1.0, Reason.NONE),  # a braking torque
        (1.0, {"q_j": 1.375}, 1.0, Reason.NONE),  # exactly a margin away from the end
        (-1.0, {"q_j": -0.875}, -1.0, Reason.NONE),
        (1.0, {"q_j": 1.4375}, 0.5, Reason.TRAVEL),
        (-1.0, {"q_j": -0.9375}, -0.5, Reason.TRAVEL),
        (1.0, {"q_j": 1.5}, 0.0, Reason.TRAVEL),
        (-1.0, {"q_j": -1.2}, 0.0, Reason.TRAVEL),
        (1.0, {"q_j": -1.2}, 1.0, Reason.NONE),  # an inward torque
        (0.0, {"q_j": 1.4375}, 0.0, Reason.NONE),  # no torque does not count as limited
        (0.0, {"q_j": 3.0, "omega_j": 15.0}, 0.0, Reason.NONE),
        (0.0, {"tau_m": 500.0}, 0.0, Reason.NONE),
        (0.0, {"tau_m": -500.0}, 0.0, Reason.NONE),
        (2.0, {}, 2.0, Reason.NONE),
        (-2.0, {}, -2.0, Reason.NONE),
        (2.0000001, {}, 2.0, Reason.ABSOLUTE),
        (-1e9, {}, -2.0, Reason.ABSOLUTE),
    ],
)
def test_each_limit_begins_at_its_edge(wanted: float, change: dict[str, Any], torque: float, reason: Reason) -> None:
    assert Limiter(LOOSE, PERIOD).update(wanted, **{**CALM, **change}) == (pytest.approx(torque), reason)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_on_the_limit_of_rate_or_distance_nothing_is_limited(sign: float) -> None:
    """Exactly one step and exactly the distance pass unchanged."""
    settings = LimiterSettings(torque=2.0, rate=4.0, distance=1.0)
    assert Limiter(settings, 0.25).update(sign, **CALM) == (sign, Reason.NONE)


def ramp(limiter: Limiter, wanted: float, cycles: int) -> list[tuple[float, Reason]]:
    return [limiter.update(wanted, **CALM) for _ in range(cycles)]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_step_becomes_a_ramp_in_either_direction(sign: float) -> None:
    """The opposite torque grows from 0 by the same ramp, and so does the torque after a fault or a reset."""
    limiter = Limiter(LimiterSettings(torque=2.0, rate=100.0), PERIOD)
    for way in (sign, -sign):
        torques, reasons = zip(*ramp(limiter, way, 11), strict=True)
        assert torques == pytest.approx([way * 0.1 * n for n in range(1, 11)] + [way])
        assert set(reasons[:9]) == {Reason.RATE}
        assert reasons[10] is Reason.NONE
    limiter.update(-sign, **{**CALM, "fresh": False})
    assert limiter.update(-sign, **CALM) == (pytest.approx(-0.1 * sign), Reason.RATE)
    ramp(limiter, -sign, 5)
    limiter.reset()
    assert limiter.update(-sign, **CALM) == (pytest.approx(-0.1 * sign), Reason.RATE)


@pytest.mark.parametrize(
    ("change", "torque"),
    [({"q_j": 2.0}, 0.0), ({"omega_j": 10.0}, 0.0), ({"q_j": 1.45}, 0.5), ({"tau_m": -1.7}, 0.3)],
    ids=["beyond the travel", "at the speed limit", "within the travel's margin", "far from the measured torque"],
)
def test_what_a_limit_demands_comes_at_once_however_slow_the_rate(change: dict[str, Any], torque: float) -> None:
    """After `set rate_limit 1`, outward torque must not persist for seconds beyond the travel."""
    limiter = Limiter(LimiterSettings(torque=2.0, rate=1e5, distance=2.0, travel=(-1.0, 1.5)), PERIOD)
    limiter.update(1.0, **CALM)
    limiter.rate = 1.0
    assert limiter.update(1.0, **{**CALM, **change})[0] == pytest.approx(torque)


@pytest.mark.parametrize("wanted", [0.0, 0.4, 0.999])
def test_a_torque_falls_as_fast_as_it_is_wanted_to(wanted: float) -> None:
    """The rate limit applies only to a growing torque."""
    limiter = Limiter(LimiterSettings(torque=2.0, rate=1e5), PERIOD)
    limiter.update(1.0, **CALM)
    limiter.rate = 0.1
    assert limiter.update(wanted, **CALM) == (wanted, Reason.NONE)


def test_lowered_limit_holds_at_once() -> None:
    """The absolute limit takes precedence over the rate."""
    limiter = Limiter(LimiterSettings(torque=2.0, rate=2000.0), PERIOD)
    limiter.update(2.0, **CALM)
    limiter.torque = 0.5
    limiter.rate = 1.0
    assert limiter.update(2.0, **CALM) == (0.5, Reason.ABSOLUTE)


values = st.floats(-100.0, 100.0) | st.sampled_from([0.0, math.nan, math.inf, -math.inf])
cycles = st.tuples(values, st.booleans(), st.booleans(), values, values, values, values)


@given(st.lists(cycles, min_size=1, max_size=40))
def test_invariants_over_any_sequence(sequence: list[tuple[float, bool, bool, float, float, float, float]]) -> None:
    """The torque is finite and within the request and the limit, and grows by one step at most.

    It is 0 unless the axis is enabled and the feedback is fresh.
    """
    limiter = Limiter(SETTINGS, PERIOD)
    before = 0.0
    for wanted, enabled, fresh, tau_m, omega_m, q_j, omega_j in sequence:
        torque, reason = limiter.update(wanted, enabled, fresh, tau_m, omega_m, q_j, omega_j)
        assert math.isfinite(torque)
        assert abs(torque) <= SETTINGS.torque
        grown = abs(torque) - (abs(before) if torque * before > 0.0 else 0.0)
        assert grown <= SETTINGS.rate * PERIOD + 1e-12
        if not (enabled and fresh) or limiter.over_speed:
            assert torque == 0.0
        assert (reason is Reason.NONE) == (torque == wanted and reason.value == 0)
        assert abs(torque) <= abs(wanted) or math.isnan(wanted)
        before = torque


def test_imports_nothing_of_the_law() -> None:
    """The limiter is independent: it imports nothing of the package."""
    tree = ast.parse(Path(module.__file__).read_text(encoding="utf-8"))
    imported = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    imported |= {name.name for node in ast.walk(tree) if isinstance(node, ast.Import) for name in node.names}
    assert not {name for name in imported if name and name.startswith("tsa_ctrl")}


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"joint_speed": 20.0, "over_speed": 20.0}, "not above joint_speed"),
        ({"travel": (0.0, 0.1)}, "not wider than"),
        ({"travel": (1.0, -1.0)}, "not wider than"),
        ({"travel": (1.0, 1.5), "travel_margin": 0.25}, "not wider than two travel margins of 0.25 rad"),
    ],
)
def test_contradictory_settings_are_refused(settings: dict[str, Any], words: str) -> None:
    """Contradictory limits are an error before anything moves."""
    with pytest.raises(ValueError, match=words):
        LimiterSettings(torque=1.0, **settings).check_order()


def test_travel_just_wider_than_its_margins_is_taken() -> None:
    """Two margins and a little more leave a range with full torque."""
    settings = LimiterSettings(torque=1.0, travel=(1.0, 1.5 + 2.0**-20), travel_margin=0.25)
    assert Limiter(settings, 1.0).update(1.0, **{**CALM, "q_j": 1.25}) == (1.0, Reason.NONE)


def test_defaults_are_those_of_the_example_file() -> None:
    """The defaults, which apply if the file has no value, are conservative."""
    assert msgspec.to_builtins(LimiterSettings(torque=2.0)) == {
        "torque": 2.0,
        "torque_share": None,
        "rate": 200.0,
        "distance": None,
        "joint_speed": 10.0,
        "over_speed": 12.0,
        "motor_over_speed": 20.0,
        "travel": None,
        "travel_margin": 0.1,
    }


BOUNDS = [  # key, smallest value (rejected), largest value (accepted)
    ("torque", 0.0, 1000.0),
    ("distance", 0.0, 1000.0),
    ("rate", 0.0, 100_000.0),
    ("over_speed", 0.0, 1000.0),
    ("motor_over_speed", 0.0, 1000.0),
    ("travel_margin", 0.0, 10.0),
]


@pytest.mark.parametrize(("key", "low", "high"), BOUNDS, ids=[key for key, *_ in BOUNDS])
def test_settings_are_bounded_from_both_sides(key: str, low: float, high: float) -> None:
    """A setting just inside its bounds is accepted. The open bound and values just outside are rejected."""
    wide = {"torque": 1.0, "joint_speed": 1e-9, "over_speed": 1000.0}

    def read(value: float) -> LimiterSettings:
        return msgspec.convert({**wide, key: value}, LimiterSettings, strict=True)

    for good in (1e-3, high):
        assert getattr(read(good), key) == good
    for bad in (low, -1e-3, math.nextafter(high, math.inf)):
        with pytest.raises(msgspec.ValidationError):
            read(bad)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("ceiling", "most", "reason"), [(0.3, 0.3, Reason.SENSE), (2.0, 2.0, Reason.ABSOLUTE)])
def test_a_ceiling_is_an_absolute_limit_for_now(sign: float, ceiling: float, most: float, reason: Reason) -> None:
    limiter = Limiter(LimiterSettings(torque=2.0, rate=100_000.0, distance=100.0), PERIOD)
    limiter.ceiling = ceiling
    assert limiter.update(sign * 5.0, **CALM) == (sign * most, reason)
    limiter.ceiling = math.inf
    assert limiter.update(sign * 5.0, **CALM) == (sign * 2.0, Reason.ABSOLUTE)


def test_reasons_are_the_codes_of_the_log() -> None:
    """Existing logs stay readable."""
    names = (
        "NONE DISABLED STALE NOT_FINITE OVER_SPEED SPEED TRAVEL DISTANCE RATE ABSOLUTE OSCILLATION DOMAIN PASSIVITY "
        "SENSE UNPROVEN"
    )
    assert [reason.name for reason in Reason] == names.split()
    assert [reason.value for reason in Reason] == list(range(15))


sizes = st.floats(1e-3, 100.0)


@given(sizes, sizes, st.floats(-2.0, 2.0), st.sampled_from([-1.0, 1.0]))
def test_distance_sweep(distance: float, wanted: float, measured: float, sign: float) -> None:
    """For any measured torque, the command is the desired one or lies on the bound, and it is never reversed."""
    settings = LimiterSettings(torque=1000.0, rate=1e5, distance=distance)
    torque, reason = Limiter(settings, 1.0).update(sign * wanted, **{**CALM, "tau_m": sign * measured})
    bound = max(0.0, measured + distance)
    assert sign * torque == pytest.approx(min(wanted, bound))
    assert (reason is Reason.DISTANCE) == (wanted > measured + distance)


@given(st.floats(-30.0, 30.0), st.floats(-3.0, 3.0), st.floats(-2.0, 2.0))
def test_speed_and_travel_sweep(omega: float, q: float, wanted: float) -> None:
    """The reference is the rule: the torque is scaled by the remaining speed and by the remaining travel.

    Each factor is between 0 and 1 and acts only on torque that makes it worse.
    """
    torque, _ = Limiter(LOOSE, PERIOD).update(wanted, **{**CALM, "omega_j": omega, "q_j": q})
    expected = wanted
    if abs(omega) >= 20.0:
        expected = 0.0
    if wanted * omega > 0.0:
        expected *= min(1.0, max(0.0, (10.0 - abs(omega)) / 2.0))
    room = 1.5 - q if wanted > 0.0 else q + 1.0
    expected *= min(1.0, max(0.0, room / 0.125))
    assert torque == pytest.approx(expected, abs=1e-12)
