"""Test the design of the law from model, bus and motor: durations, leads and gains, and the notes on limits."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.control.laws import PERIOD, plan
from tests.model.actuator import ACTUATOR
from tsa_ctrl.control.law_design import BLIND, LAG, LEAST, MOST_LEAD, Limits, design_law, gain_margin
from tsa_ctrl.control.reversal import FrictionReversal
from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.curvature import Points
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.steady_sliding import motor_stiffness, sliding
from tsa_ctrl.safety.limiter import LimiterSettings

INERTIA = 1e-4


def bent(profile: str | Points) -> TendonSheath:
    return ACTUATOR.with_effects({"elongation_coupling": {"curvature_profile": profile}})


def test_the_delay_is_transport_hold_and_torque_loop() -> None:
    assert plan(bent("uniform")).delay == pytest.approx(1.5 * PERIOD + LAG)
    assert plan(bent("uniform"), transport=0.6 * PERIOD).delay == pytest.approx(1.1 * PERIOD + LAG)
    assert plan(bent("uniform"), delay=3e-3).delay == 3e-3


@pytest.mark.parametrize("period", [5e-4, 1e-3, 4e-3])
def test_a_turn_takes_three_periods_and_the_time_of_the_motor_and_less_towards_the_joint(period: float) -> None:
    names = ("motor_end", "uniform", "joint_end")
    turns = [plan(bent(name), inertia=INERTIA, period=period, transport=period).turn for name in names]
    assert turns == pytest.approx([5e-3 + 3.0 * period, 5e-3 + 3.0 * period, 2e-3 + 3.0 * period])


@pytest.mark.parametrize(
    ("profile", "settings", "values", "note"),
    [
        ("uniform", {}, {"turn": BLIND, "damping": 0.0, "inertia": 0.0}, "law.motor_inertia is not given"),
        (
            "joint_end",
            {"inertia": INERTIA, "speed": 0.5, "speed_key": "drive.max_speed"},
            {},
            "because drive.max_speed allows a motor speed of 0.5 rad/s",
        ),
        (
            "uniform",
            {"inertia": INERTIA, "torque": 0.4},
            {},
            "limits.torque 0.4 N*m does not exceed the friction torque of 0.468 N*m",
        ),
        ("uniform", {"inertia": INERTIA, "delay": 30e-3}, {"damping": 0.0}, "leaves no gain margin of 2"),
        (
            "uniform",
            {"inertia": INERTIA, "has_encoder": False},
            {"lead": 0.0, "damping": 0.0},
            "without a joint encoder",
        ),
        ("late", {"inertia": INERTIA}, {"lead": MOST_LEAD}, "turns late"),
    ],
    ids=["no inertia", "slow", "weak", "no margin", "no encoder", "late velocity"],
)
def test_what_a_plan_cannot_do_is_reported(
    profile: str, settings: dict[str, Any], values: dict[str, float], note: str
) -> None:
    model = bent("uniform" if profile == "late" else profile)
    if profile == "late":
        model = model.with_effects({**model.effects, "velocity_lag": {"time_constant": 0.5}})
    found = plan(model, **settings)
    assert {name: getattr(found, name) for name in values} == values
    assert any(note in each for each in found.notes)


def test_the_limits_of_the_drive_make_it_longer() -> None:
    """The reversal takes longer if the torque rate or the torque for the motor's inertia would exceed its limit."""
    model = bent("uniform")
    slow = plan(model, inertia=INERTIA, rate=150.0)
    assert slow.turn > 8e-3
    half_loop = sliding(model).motor_half_loop
    steps = 2.0 * half_loop * FrictionReversal(slow.front, slow.turn, PERIOD).steepest()
    assert steps <= 150.0 * PERIOD
    heavy = plan(model, inertia=6e-4, torque=0.5)
    moved = half_loop / motor_stiffness(model)
    assert 2.0 * math.pi * 6e-4 * moved / heavy.turn**2 <= 0.5 * 0.5
    assert heavy.turn > 8e-3


@pytest.mark.parametrize(("inertia", "longer"), [(3e-5, False), (1e-4, True), (3.2e-4, True)])
def test_at_the_joint_the_torque_of_a_heavy_motor_does_not_rise_faster_than_the_limiter_lets_it(
    inertia: float, longer: bool
) -> None:
    """With all curvature at the joint, the rate of the inertia torque is at most three times the limiter's rate.

    A heavy motor therefore needs a longer reversal.
    """
    model = bent("joint_end")
    found = plan(model, inertia=inertia, rate=200.0, torque=10.0)
    half_loop = sliding(model).motor_half_loop
    moved = 2.0 * half_loop / motor_stiffness(model)
    assert 4.0 * math.pi**2 * inertia * moved / found.turn**3 <= 600.0
    light = plan(model, inertia=1e-6, rate=200.0, torque=10.0)
    assert (found.turn > light.turn) is longer


@settings(max_examples=30, deadline=None)
@given(
    x=st.floats(0.05, 1.2),
    place=st.floats(0.0, 0.95),
    softness=st.floats(1.0, 2.0),
    speed=st.floats(3.0, 30.0),
    given_turn=st.sampled_from([None, 5e-3, 0.02]),
    inertia=st.sampled_from([None, 3e-5, 6e-4]),
)
def test_a_turn_never_needs_more_than_the_motor_speed_that_is_allowed(
    x: float, place: float, softness: float, speed: float, given_turn: float | None, inertia: float | None
) -> None:
    """The largest step of the planned motion stays below 60 % of the motor speed limit.

    This is tested for soft and stiff tendons and the full friction torque.
    """
    model = dataclasses.replace(bent(((0.0, 0.0), (place, 0.0), (1.0, 1.0))), friction_coefficient=x / 2.6)
    model = dataclasses.replace(model, axial_stiffness=model.axial_stiffness / softness)
    amplitude = sliding(model).motor_half_loop / motor_stiffness(model)  # rad of the motor, all curvature at the joint
    found = plan(model, speed=speed, turn=given_turn, inertia=inertia)
    turn = FrictionReversal(found.front, found.turn, PERIOD)
    turn.reset(-1.0)
    ways = []
    for _ in range(math.ceil(found.turn / PERIOD) + 2):
        turn.update(1.0)
        ways.append(found.front.centre * amplitude * turn.stretch)
    assert max(np.abs(np.diff(ways))) / PERIOD <= 0.6 * speed * (1.0 + 1e-9)
    assert given_turn is None or found.turn >= given_turn


def test_a_speed_at_which_no_turn_is_possible_is_an_error_that_names_the_limit() -> None:
    with pytest.raises(UsageError, match=r"drive.max_speed allows .* 0.1 rad/s; .* needs 0.381 rad/s; raise drive"):
        plan(bent("joint_end"), speed=0.1, speed_key="drive.max_speed")


def test_the_least_speed_limit_counts_and_without_a_joint_encoder_those_of_the_joint() -> None:
    settings_of = LimiterSettings(torque=2.0, joint_speed=6.0, over_speed=9.0, motor_over_speed=20.0)
    found = [Limits.of(settings_of, most, ACTUATOR, encoder)[3:5] for most, encoder in ((30.0, True), (15.0, True))]
    assert found == [(20.0, "limits.motor_over_speed"), (15.0, "drive.max_speed")]
    assert Limits.of(settings_of, 30.0, ACTUATOR, False)[3:5] == (pytest.approx(7.5), "limits.joint_speed")


@pytest.mark.parametrize("has_encoder", [True, False])
@pytest.mark.parametrize(
    ("gear", "motor", "named"),
    [
        (1.0, 20.0, ""),
        (1.0, 6.0, "limits.motor_over_speed 6 rad/s is reached at a joint speed of 4.8 rad/s, before "),
        (2.0, 20.0, "limits.motor_over_speed 20 rad/s is reached at a joint speed of 8 rad/s, before "),
    ],
)
def test_a_motor_speed_limit_that_acts_before_the_fade_of_the_torque_is_noted(
    gear: float, motor: float, named: str, has_encoder: bool
) -> None:
    """The second rig has the shipped limits, but twice the ratio of the radii."""
    model = dataclasses.replace(bent("uniform"), joint_pulley_radius=gear * ACTUATOR.joint_pulley_radius)
    limits = Limits.of(LimiterSettings(torque=2.0, motor_over_speed=motor), motor, model, has_encoder)
    found = design_law(
        model, period=PERIOD, transport=PERIOD, late=0.0, has_encoder=has_encoder, limits=limits, inertia=INERTIA
    )
    noted = [note for note in found.notes if "is reached at a joint speed" in note]
    assert [note.startswith(named) for note in noted] == [True] * bool(named)


def test_a_command_never_runs_farther_ahead_of_the_measured_torque_than_allowed() -> None:
    model = bent("uniform")
    close = plan(model, inertia=INERTIA, distance=0.1)
    steps = 2.0 * sliding(model).motor_half_loop * FrictionReversal(close.front, close.turn, PERIOD).steepest()
    assert steps / PERIOD * (close.delay + PERIOD) <= 0.1
    assert close.turn > plan(model, inertia=INERTIA).turn


def test_the_lead_is_half_the_turn_and_all_delays() -> None:
    model = bent("uniform")
    found = plan(model, inertia=INERTIA)
    assert found.lead == pytest.approx(0.5 * found.turn + found.delay)
    lagging = model.with_effects({**model.effects, "velocity_lag": {"time_constant": 0.003}})
    assert plan(lagging, inertia=INERTIA).lead == pytest.approx(found.lead + 0.003)


@pytest.mark.parametrize("delay", [2e-3, 4e-3])
@pytest.mark.parametrize("inertia", [3e-5, 6e-4])
def test_the_damping_keeps_its_margin(inertia: float, delay: float) -> None:
    found = plan(bent("uniform"), inertia=inertia, delay=delay)
    assert found.ringing == pytest.approx(math.sqrt(motor_stiffness(ACTUATOR) / inertia))
    assert found.damping > 0.0
    assert found.margin >= 0.999 * LEAST
    assert gain_margin(found.damping, inertia, motor_stiffness(ACTUATOR), delay, PERIOD) == found.margin


def test_a_velocity_that_is_late_costs_margin() -> None:
    """The delay of the drive's velocity filter is added to the command delay, which reduces the damping gain."""
    prompt, late = (plan(bent("uniform"), inertia=3e-5, delay=4e-3, late=late) for late in (0.0, 4e-3))
    assert late.damping < prompt.damping


def test_a_damping_without_margin_is_refused_in_one_line() -> None:
    with pytest.raises(UsageError, match=r"knee: law.damping 0.3 N\*m\*s/rad has a gain margin of .* allowed is 2: "):
        plan(bent("uniform"), inertia=INERTIA, damping=0.3, where="knee")
    assert plan(bent("uniform"), inertia=INERTIA, damping=0.01).damping == 0.01
    assert plan(bent("uniform"), inertia=INERTIA, damping=0.0).damping == 0.0


def test_a_measured_ringing_takes_the_place_of_the_models() -> None:
    assert plan(bent("uniform"), inertia=INERTIA, ringing=80.0).ringing == pytest.approx(2.0 * math.pi * 80.0)


def test_reach_is_half_of_a_tendons_compliance_where_nothing_else_is_known() -> None:
    """The minimum of the reach is d/(2 r_J EA) with d = l/2.

    With a smaller value, a trembling torque would cause reversals.
    """
    even = 0.5 * ACTUATOR.unstrained_length / ACTUATOR.axial_stiffness / (2.0 * ACTUATOR.joint_pulley_radius)
    assert plan(bent("uniform")).reach == plan(bent("joint_end")).reach == pytest.approx(even)
    assert plan(bent("motor_end")).reach == pytest.approx(2.0 * even)
    sprung = dataclasses.replace(bent("uniform"), series_stiffness=2e4, series_at_joint=True)
    assert plan(sprung).reach > 2.0 * even


def test_a_moving_joint_slips_by_no_stretch_that_lies_behind_all_bends() -> None:
    even = plan(bent("uniform")).reach
    gives = [plan(bent(name)).give for name in ("motor_end", "uniform", "joint_end")]
    assert gives == pytest.approx([2.0 * even, even, 0.0])


@pytest.mark.parametrize(("lag", "extra"), [(None, 0.0), (3e-3, 0.0), (5e-3, 1.8e-3)])
def test_what_the_loops_own_filter_makes_late_is_not_led(lag: float | None, extra: float) -> None:
    """The lead includes only the part of the velocity lag that exceeds the delay of the loop's own filter."""
    model = bent("uniform")
    late = model if lag is None else model.with_effects({**model.effects, "velocity_lag": {"time_constant": lag}})
    assert plan(late, filtered=3.2e-3).lead == pytest.approx(plan(model).lead + extra)
