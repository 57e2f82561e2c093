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
    over_speed=20.0, motor_over_speed=40.0, torque=2.0, rate=1e5, distance=100.0, travel=(-1.0, 1.5)
)


def test_passes_what_breaks_no_limit() -> None:
    """Inside all limits, the output is exactly the desired torque."""
    assert Limiter(LOOSE, PERIOD).update(0.3, **CALM) == (0.3, Reason.NONE)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"enabled": False}, Reason.DISABLED),
        ({"fresh": False}, Reason.STALE),
        ({"tau_m": math.nan}, Reason.NOT_FINITE),
        ({"omega_m": math.inf}, Reason.NOT_FINITE),
        ({"q_j": math.nan}, Reason.NOT_FINITE),
        ({"omega_j": -math.inf}, Reason.NOT_FINITE),
        ({"omega_j": 20.0}, Reason.OVER_SPEED),
        ({"omega_j": -20.0}, Reason.OVER_SPEED),
        ({"omega_m": 40.0}, Reason.OVER_SPEED),
        ({"omega_m": -40.0}, Reason.OVER_SPEED),
    ],
)
def test_fault_gives_zero_in_the_same_cycle(change: dict[str, Any], reason: Reason) -> None:
    """After a fault the torque is exactly 0 at once, and the fault is the reason."""
    limiter = Limiter(LOOSE, PERIOD)
    limiter.update(1.5, **CALM)
    assert limiter.update(1.5, **{**CALM, **change}) == (0.0, reason)


@pytest.mark.parametrize("wanted", [math.nan, math.inf, -math.inf])
def test_wanted_torque_must_be_finite(wanted: float) -> None:
    """A torque of the law that is not finite is never sent."""
    assert Limiter(LOOSE, PERIOD).update(wanted, **CALM) == (0.0, Reason.NOT_FINITE)


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


@pytest.mark.parametrize(("omega", "share"), [(7.9, 1.0), (8.0, 1.0), (9.0, 0.5), (10.0, 0.0), (15.0, 0.0)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_driving_torque_fades_towards_joint_speed(omega: float, share: float, sign: float) -> None:
    """Torque along the motion fades to 0 between 80 % and 100 % of the joint speed limit. Braking torque does not."""
    driving, _ = Limiter(LOOSE, PERIOD).update(sign, **{**CALM, "omega_j": sign * omega})
    braking, _ = Limiter(LOOSE, PERIOD).update(sign, **{**CALM, "omega_j": -sign * omega})
    assert driving == pytest.approx(sign * share)
    assert braking == sign


@pytest.mark.parametrize(
    ("q", "outward", "share"),
    [(1.39, 1.0, 1.0), (1.45, 1.0, 0.5), (1.5, 1.0, 0.0), (2.0, 1.0, 0.0), (-0.95, -1.0, 0.5), (-1.2, -1.0, 0.0)],
)
def test_outward_torque_fades_at_the_ends_of_travel(q: float, outward: float, share: float) -> None:
    """Within the margin, outward torque fades to 0. Beyond the travel it is 0. Inward torque passes."""
    pushed, _ = Limiter(LOOSE, PERIOD).update(outward, **{**CALM, "q_j": q})
    back, _ = Limiter(LOOSE, PERIOD).update(-outward, **{**CALM, "q_j": q})
    assert pushed == pytest.approx(outward * share)
    assert back == -outward


def test_command_stays_near_the_measured_torque() -> None:
    """The command exceeds the measured torque by at most `distance`."""
    limiter = Limiter(LimiterSettings(torque=2.0, rate=1e5, distance=0.5), PERIOD)
    assert limiter.update(1.5, **{**CALM, "tau_m": 0.2}) == (0.7, Reason.DISTANCE)
    assert limiter.update(-1.5, **{**CALM, "tau_m": -0.2}) == (-0.7, Reason.DISTANCE)


@pytest.mark.parametrize("measured", [5.0, -5.0])
def test_a_lying_torque_cannot_pull_the_command_along(measured: float) -> None:
    """A distant measured torque reduces the command at most to 0. It never reverses or increases it."""
    limiter = Limiter(LimiterSettings(torque=2.0, rate=1e5, distance=0.5), PERIOD)
    torque, _ = limiter.update(0.3, **{**CALM, "tau_m": measured})
    assert torque in (0.0, 0.3)


def test_rate_limit() -> None:
    """A step of the desired torque becomes a ramp of `rate`."""
    limiter = Limiter(LimiterSettings(torque=2.0, rate=100.0), PERIOD)
    torques = [limiter.update(1.0, **{**CALM, "tau_m": 1.0}) for _ in range(11)]
    assert [torque for torque, _ in torques[:10]] == pytest.approx([0.1 * n for n in range(1, 11)])
    assert torques[4][1] is Reason.RATE
    assert torques[10] == (1.0, Reason.NONE)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_rate_limit_holds_in_either_direction(sign: float) -> None:
    """From a torque that was reached, the opposite torque grows from 0 by the same ramp, with the rate as reason."""
    limiter = Limiter(LimiterSettings(torque=2.0, rate=100.0), PERIOD)
    for _ in range(10):
        limiter.update(sign, **CALM)
    ramp = [limiter.update(-sign, **CALM) for _ in range(11)]
    assert [torque for torque, _ in ramp] == pytest.approx([-sign * 0.1 * n for n in range(1, 11)] + [-sign])
    assert {reason for _, reason in ramp[:9]} == {Reason.RATE}
    assert ramp[10][1] is Reason.NONE


@pytest.mark.parametrize(
    ("change", "torque"),
    [({"q_j": 2.0}, 0.0), ({"omega_j": 10.0}, 0.0), ({"q_j": 1.45}, 0.5), ({"tau_m": -1.7}, 0.3)],
    ids=["beyond the travel", "at the speed limit", "within the travel's margin", "far from the measured torque"],
)
@pytest.mark.parametrize("rate", [1.0, 100.0])
def test_what_a_limit_demands_comes_at_once_however_slow_the_rate(
    rate: float, change: dict[str, Any], torque: float
) -> None:
    """After `set rate_limit 1`, outward torque must not persist for seconds beyond the travel."""
    limiter = Limiter(LimiterSettings(torque=2.0, rate=1e5, distance=2.0, travel=(-1.0, 1.5)), PERIOD)
    limiter.update(1.0, **CALM)
    limiter.rate = rate
    assert limiter.update(1.0, **{**CALM, **change})[0] == pytest.approx(torque)


@pytest.mark.parametrize("wanted", [0.0, 0.4, 0.999])
def test_a_torque_falls_as_fast_as_it_is_wanted_to(wanted: float) -> None:
    """The rate limit applies only to a growing torque."""
    limiter = Limiter(LimiterSettings(torque=2.0, rate=1e5), PERIOD)
    limiter.update(1.0, **CALM)
    limiter.rate = 0.1
    assert limiter.update(wanted, **CALM) == (wanted, Reason.NONE)


@pytest.mark.parametrize(("q_j", "wanted", "torque"), [(1.45, 1.0, 0.5), (-0.95, -1.0, -0.5)])
def test_outward_torque_fades_before_the_end_of_travel(q_j: float, wanted: float, torque: float) -> None:
    limiter = Limiter(LimiterSettings(torque=2.0, rate=1e5, distance=100.0, travel=(-1.0, 1.5)), PERIOD)
    assert limiter.update(wanted, **{**CALM, "q_j": q_j}) == (pytest.approx(torque), Reason.TRAVEL)
    assert limiter.update(-wanted, **{**CALM, "q_j": q_j}) == (-wanted, Reason.NONE)
    assert limiter.update(0.0, **{**CALM, "q_j": q_j}) == (0.0, Reason.NONE)


def test_ramps_from_zero_after_a_fault() -> None:
    """After a fault the torque starts from 0, not from its previous value."""
    limiter = Limiter(LimiterSettings(torque=2.0, rate=100.0), PERIOD)
    for _ in range(20):
        limiter.update(1.0, **CALM)
    limiter.update(1.0, **{**CALM, "fresh": False})
    assert limiter.update(1.0, **CALM)[0] == pytest.approx(0.1)


@pytest.mark.parametrize("wanted", [2.0000001, 1e9, -2.0000001, -1e9])
def test_absolute_limit(wanted: float) -> None:
    """Beyond the absolute limit, the limit itself is sent."""
    assert Limiter(LOOSE, PERIOD).update(wanted, **CALM) == (math.copysign(2.0, wanted), Reason.ABSOLUTE)


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


@pytest.mark.parametrize("upper", [1.5 + 2.0**-20, 3.0])
def test_travel_just_wider_than_its_margins_is_taken(upper: float) -> None:
    """Two margins and a little more leave a range with full torque, at any position of the travel."""
    settings = LimiterSettings(torque=1.0, travel=(1.0, upper), travel_margin=0.25)
    middle = {**CALM, "q_j": 0.5 * (1.0 + upper)}
    assert Limiter(settings, 1.0).update(1.0, **middle) == (1.0, Reason.NONE)


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
    assert {reason.name: reason.value for reason in Reason} == {
        "NONE": 0,
        "DISABLED": 1,
        "STALE": 2,
        "NOT_FINITE": 3,
        "OVER_SPEED": 4,
        "SPEED": 5,
        "TRAVEL": 6,
        "DISTANCE": 7,
        "RATE": 8,
        "ABSOLUTE": 9,
        "OSCILLATION": 10,
        "DOMAIN": 11,
        "PASSIVITY": 12,
        "SENSE": 13,
        "UNPROVEN": 14,
    }


def test_reset_starts_the_ramp_anew() -> None:
    """An explicit restart begins at 0, not at the previous command."""
    limiter = Limiter(LimiterSettings(torque=2.0, rate=100.0), PERIOD)
    for _ in range(5):
        limiter.update(1.0, **CALM)
    limiter.reset()
    assert limiter.update(1.0, **CALM) == (pytest.approx(0.1), Reason.RATE)


@pytest.mark.parametrize("omega", [math.nextafter(8.0, 10.0), 9.0])
def test_small_driving_torque_fades_too(omega: float) -> None:
    """The fade depends on the sign of the power, not on its size."""
    torque, reason = Limiter(LOOSE, PERIOD).update(1e-3, **{**CALM, "omega_j": omega})
    assert (torque, reason) == (pytest.approx(1e-3 * (10.0 - omega) / 2.0), Reason.SPEED)


@pytest.mark.parametrize("omega", [8.0, -8.0])
def test_at_the_onset_of_the_speed_limit_nothing_is_limited(omega: float) -> None:
    """80 % of the joint speed is still unlimited."""
    assert Limiter(LOOSE, PERIOD).update(math.copysign(0.5, omega), **{**CALM, "omega_j": omega}) == (
        math.copysign(0.5, omega),
        Reason.NONE,
    )


def test_no_torque_is_no_limit() -> None:
    """A desired torque of zero at full speed and beyond the travel does not count as limited."""
    assert Limiter(LOOSE, PERIOD).update(0.0, **{**CALM, "omega_j": 15.0, "q_j": 3.0}) == (0.0, Reason.NONE)
    for measured in (500.0, -500.0):
        assert Limiter(LOOSE, PERIOD).update(0.0, **{**CALM, "tau_m": measured}) == (0.0, Reason.NONE)


def test_a_margin_away_from_the_end_of_travel_nothing_is_limited() -> None:
    """The fade begins inside the margin."""
    settings = LimiterSettings(torque=2.0, rate=1e5, travel=(-1.0, 1.5), travel_margin=0.5)
    assert Limiter(settings, PERIOD).update(1.0, **{**CALM, "q_j": 1.0}) == (1.0, Reason.NONE)
    assert Limiter(settings, PERIOD).update(-1.0, **{**CALM, "q_j": -0.5}) == (-1.0, Reason.NONE)


def test_small_command_stays_near_a_contrary_torque() -> None:
    """A command below 1 N*m is limited to its distance like any other."""
    limiter = Limiter(LimiterSettings(torque=2.0, rate=1e5, distance=0.125), PERIOD)
    assert limiter.update(0.5, **{**CALM, "tau_m": 0.25}) == (0.375, Reason.DISTANCE)
    assert limiter.update(-0.5, **{**CALM, "tau_m": -0.25}) == (-0.375, Reason.DISTANCE)


def test_on_a_limit_nothing_is_limited() -> None:
    """Exactly one step, exactly the absolute limit and exactly the distance pass unchanged."""
    settings = LimiterSettings(torque=2.0, rate=4.0, distance=1.0)
    assert Limiter(settings, 0.25).update(1.0, **CALM) == (1.0, Reason.NONE)
    assert Limiter(settings, 0.25).update(-1.0, **CALM) == (-1.0, Reason.NONE)
    quick = LimiterSettings(torque=2.0, rate=1e5)
    assert Limiter(quick, 0.25).update(2.0, **CALM) == (2.0, Reason.NONE)
    assert Limiter(quick, 0.25).update(-2.0, **CALM) == (-2.0, Reason.NONE)


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
    expected *= min(1.0, max(0.0, room / 0.1))
    assert torque == pytest.approx(expected, abs=1e-12)
