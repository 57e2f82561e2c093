"""Test one axis: the common start, stop and reset of its parts."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from tests.daemon.machine import Machine
from tsa_ctrl.control.axis import BENT, ControlAxis
from tsa_ctrl.control.estimator import Sample
from tsa_ctrl.safety.causes import Cause, Fault, Finding
from tsa_ctrl.safety.compensation_backoff import Observed
from tsa_ctrl.safety.limiter import Reason
from tsa_ctrl.safety.supervisor import Phase, Request

PARTS = ("set_point", "estimator", "law", "guard", "plausibility")


@pytest.fixture
def told(axis: ControlAxis, monkeypatch: pytest.MonkeyPatch) -> list[tuple[float, ...]]:
    """Return a list of the parameters that the law gets from now on."""
    parameters: list[tuple[float, ...]] = []
    monkeypatch.setattr(axis.law, "set_parameters", lambda *given: parameters.append(given[:2]))
    return parameters


@pytest.fixture
def axis(tmp_path: Path) -> Iterator[ControlAxis]:
    machine = Machine(tmp_path)
    yield machine.axis
    machine.close()


def use(axis: ControlAxis, friction_angle: float, pretension: float) -> None:
    """Set the estimate to these parameters and let the law use them."""
    axis.estimator.friction_angle, axis.estimator.pretension, axis.estimator.use = friction_angle, pretension, True
    axis.adapt()


def test_a_new_axis_wants_nothing_and_did_nothing(axis: ControlAxis) -> None:
    """The terms of a new axis are 0. A shutdown or a log record before the first cycle reads them."""
    assert (axis.request, axis.ramp) == (Request.DISABLE, 1.0)
    terms = axis.terms
    assert (terms.tau_j_des, terms.tau_m_cmd, terms.reason, terms.permitted) == (0.0, 0.0, Reason.DISABLED, False)


def test_at_rest_is_disabled_or_in_fault(axis: ControlAxis) -> None:
    for phase in Phase:
        axis.supervisor.phase = phase
        assert axis.at_rest is (phase in (Phase.STANDBY, Phase.FAULT))


def test_a_stop_turns_any_request_into_a_disable(axis: ControlAxis) -> None:
    """A stop cancels a pending reset. An enabled axis stays enabled for the ramp, unless torque is not permitted."""
    axis.request = Request.RESET
    axis.stop()
    assert axis.request is Request.DISABLE
    axis.enable()
    axis.release()  # keeps an enable that waits for the drive
    assert axis.request is Request.ENABLE
    axis.stop()
    assert axis.request is Request.ENABLE
    axis.release()  # torque is no longer permitted
    assert axis.request is Request.DISABLE
    axis.request = Request.RESET
    axis.release()  # keeps a reset that was requested after the stop
    assert axis.request is Request.RESET


@pytest.mark.parametrize("again", [False, True])
def test_a_stop_ramps_by_time_from_the_cycle_that_sees_it(axis: ControlAxis, again: bool) -> None:
    """At each stop the ramp falls linearly with time to exactly 0. The drive is disabled only at 0."""
    if again:
        axis.enable()
        axis.stop()
        axis.since_enable(1.0)
        axis.release()
    axis.enable()
    assert axis.since_enable(16.0) == 0.0
    axis.stop()
    for cycle in range(1, 300):
        assert axis.since_enable(16.0 + 1e-3 * cycle) == pytest.approx(1e-3 * cycle)
        assert (axis.ramp, axis.request) == (pytest.approx(1.0 - cycle / 300), Request.ENABLE)
    axis.since_enable(16.301)
    assert (axis.ramp, axis.request) == (0.0, Request.DISABLE)


def test_lost_cycles_do_not_lengthen_the_ramp(axis: ControlAxis) -> None:
    """In a cycle after the end of the ramp, the ramp factor is 0 and not negative."""
    axis.enable()
    axis.stop()
    axis.since_enable(16.0)
    axis.since_enable(16.5)
    assert (axis.ramp, axis.request) == (0.0, Request.DISABLE)


def test_every_enable_begins_without_the_ramp_of_the_last_stop(axis: ControlAxis) -> None:
    """After a release, the ramp factor of the next enable is 1."""
    axis.enable()
    assert axis.since_enable(10.0) == 0.0
    assert axis.since_enable(10.5) == 0.5
    axis.stop()
    for cycle in range(100):
        axis.since_enable(11.0 + 1e-3 * cycle)
    assert 0.0 < axis.ramp < 0.8
    axis.release()
    axis.enable()
    assert axis.ramp == 1.0
    assert axis.since_enable(20.0) == 0.0
    assert axis.ramp == 1.0


def test_without_an_encoder_the_joint_is_where_the_motor_says(axis: ControlAxis) -> None:
    """Joint angle and velocity are the motor values, converted with the pulley radii."""
    axis.image.q_j, axis.image.omega_j, axis.image.q_m, axis.image.omega_m = 0.1, 0.2, 2.0, 3.0
    assert axis.joint() == (0.1, 0.2)
    axis._has_encoder = False
    assert axis.joint() == pytest.approx((1.6, 2.4))


def test_release_forgets_everything(
    axis: ControlAxis, told: list[tuple[float, ...]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A release resets back-off, set-point and estimate, and restores the parameters that the law uses."""
    reset: list[str] = []
    for part in PARTS:
        monkeypatch.setattr(getattr(axis, part), "reset", lambda part=part: reset.append(part))
    axis.since_enable(1.0)
    axis.terms.tau_j_des = 0.7
    use(axis, 0.1, 20.0)
    axis.release()
    assert sorted(reset) == sorted(PARTS)
    assert axis.terms.tau_j_des == 0.0
    assert told == [(0.1, 20.0), (axis.model.friction_angle, axis.model.pretension)]
    reset.clear()
    axis.release()  # a second release resets nothing
    assert reset == []


def test_a_set_point_counts_from_when_its_client_wanted_it(axis: ControlAxis, monkeypatch: pytest.MonkeyPatch) -> None:
    """The time of a set-point is relative to the enable at 10 s. The cycle is at 12.25 s.

    A future time becomes the time of the cycle, and -inf stays -inf.
    """
    received: list[tuple[float, float]] = []
    monkeypatch.setattr(axis.set_point, "receive", lambda value, t: received.append((value, t)))
    assert axis.since_enable(10.0) == 0.0
    for time, t in ((12.0, 2.0), (12.25, 2.25), (9.0, -1.0), (12.5, 2.25), (1e9, 2.25), (-math.inf, -math.inf)):
        received.clear()
        axis.connect(iter([(0.2, time), None]).__next__)
        for _ in range(2):
            axis.receive_setpoint(12.25, axis.since_enable(12.25))
        assert received == [(0.2, t)]


class Calls(list[tuple[Any, ...]]):
    """The calls of an axis to its parts after a torque command, in order."""

    def __init__(self, axis: ControlAxis, monkeypatch: pytest.MonkeyPatch, wrong: Finding | None = None) -> None:
        super().__init__()
        asked = {"law": "applied", "plausibility": "update", "estimator": "update", "guard": "update"}
        for part, method in asked.items():
            finding = wrong if part == "plausibility" else None
            monkeypatch.setattr(getattr(axis, part), method, partial(self._note, finding, part))
        image, terms = axis.image, axis.terms
        image.tau_m, image.q_m, image.omega_m, image.tau_j, image.fresh = 0.31, 0.32, 0.33, 0.34, True
        terms.q_j, terms.omega_j, terms.tau_j_des, terms.tau_m_cmd, terms.sigma = 0.41, 0.42, 0.43, 0.44, 1.0
        terms.reason, terms.permitted = Reason.NONE, True
        axis.bending.fixed, axis.bending.commanded = False, 1.5
        axis.since_enable(1.0)

    def _note(self, finding: str | None, *call: Any) -> str | None:
        self.append(call)
        return finding


def test_every_part_learns_from_the_cycle(axis: ControlAxis, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each part gets the command that was sent, and the measured values."""
    axis.instruments.connect({"t1": lambda now: 21.0, "t3": lambda now: 22.0, "temperature": lambda now: 23.0})
    calls = Calls(axis, monkeypatch)
    monkeypatch.setattr(type(axis.direction), "follows", True)
    axis.after_command(2.0)
    x, radii = axis.model.friction_angle, (axis.model.motor_pulley_radius, axis.model.joint_pulley_radius)
    at_joint = 2.0 * axis.model.pretension * radii[1] * math.tanh(x)
    bare, friction = 0.31 / radii[0] * math.cosh(x), 2.0 * axis.model.pretension * math.sinh(x)
    expected = (radii[1] * (bare - BENT * friction), radii[1] * (bare + BENT * friction))
    assert calls == [
        ("law", 0.44),
        (
            "plausibility",
            2.0,
            0.44,
            (0.31, 0.32, 0.33),
            0.41,
            0.34,
            pytest.approx(expected, rel=1e-12),
            0.0,
        ),
        ("estimator", Sample(1.0, 0.42, 1.5, 0.31, 0.34, True, 0.41, 0.32, 21.0, 22.0, temperature=23.0, t=1.0)),
        ("guard", Observed(0.34, 0.43, 0.0, 0.0, 0.0, pytest.approx(at_joint), 0.44, 0.0, 0.0, True)),
    ]
    assert axis.terms.theta == 1.5
    assert axis.supervisor.fault is None


def test_what_is_learned_in_a_cycle_is_used_from_the_next_on(
    axis: ControlAxis, told: list[tuple[float, ...]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A new estimate is passed to the law at the end of the cycle."""
    Calls(axis, monkeypatch)

    def learn(*measured: float) -> None:
        axis.estimator.friction_angle, axis.estimator.pretension = 0.2, 40.0

    axis.estimator.use = True
    monkeypatch.setattr(axis.estimator, "update", learn)
    axis.after_command(2.0)
    assert told == [(0.2, 40.0)]


@pytest.mark.parametrize(("share", "limited"), [(1.0, False), (0.95, False), (0.6, True)])
def test_the_law_learns_whether_the_compensation_limit_causes_the_error(
    axis: ControlAxis, monkeypatch: pytest.MonkeyPatch, share: float, limited: bool
) -> None:
    learned: list[tuple[float, bool]] = []
    monkeypatch.setattr(axis.law, "learn", lambda *given: learned.append(given))
    Calls(axis, monkeypatch)
    axis.law.compensation = 1.0
    axis.compensation_limit.share = share * axis.compensation_limit.ceiling
    axis.after_command(2.0)
    assert [given[1] for given in learned] == [limited]


def test_stale_measurements_contradict_nobody(axis: ControlAxis, monkeypatch: pytest.MonkeyPatch) -> None:
    """Stale measurements are not checked for plausibility, and the estimator does not admit them."""
    calls = Calls(axis, monkeypatch, wrong=Finding(Cause.MOVED_APART, "nonsense"))
    axis.image.fresh = False
    axis.after_command(2.0)
    assert [call[0] for call in calls] == ["law", "estimator", "guard"]
    assert calls[1][1].admit is False
    assert axis.supervisor.fault is None


def test_without_permission_nobody_learns(axis: ControlAxis, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without permission for torque, only the wrap angle and the instruments are read. No part is updated."""
    calls = Calls(axis, monkeypatch, wrong=Finding(Cause.MOVED_APART, "nonsense"))
    axis.terms.permitted, axis.terms.reason = False, Reason.OVER_SPEED
    axis.after_command(2.0)
    assert calls == []
    assert (axis.terms.theta, axis.instruments.tau_j) == (1.5, 0.34)
    assert axis.terms.tau_j_des == 0.0  # released
    assert axis.supervisor.fault is None


def test_a_contradiction_trips_in_its_words(axis: ControlAxis, monkeypatch: pytest.MonkeyPatch) -> None:
    """A finding of the plausibility check becomes a fault with its text and the time of the cycle."""
    finding = Finding(Cause.MOVED_APART, "a tendon is torn")
    Calls(axis, monkeypatch, wrong=finding)
    axis.after_command(2.0)
    assert axis.supervisor.fault is not None
    assert axis.supervisor.fault == Fault(*finding, 2.0)


@pytest.mark.parametrize(
    ("reason", "cause"), [(Reason.OVER_SPEED, Cause.OVER_SPEED), (Reason.NOT_FINITE, Cause.NOT_FINITE)]
)
def test_over_speed_and_what_is_not_finite_trip(
    axis: ControlAxis, monkeypatch: pytest.MonkeyPatch, reason: Reason, cause: Cause
) -> None:
    """Only these two limit reasons cause a fault. The others only reduce the torque."""
    Calls(axis, monkeypatch)
    for other in set(Reason) - {Reason.OVER_SPEED, Reason.NOT_FINITE}:
        axis.terms.reason = other
        axis.after_command(2.0)
        assert axis.supervisor.fault is None, other
    axis.terms.reason = reason
    axis.after_command(2.0)
    assert axis.supervisor.fault is not None
    assert axis.supervisor.fault.cause is cause


def test_the_law_follows_an_estimate_that_changed_by_a_thousandth(
    axis: ControlAxis, told: list[tuple[float, ...]]
) -> None:
    """A change of more than 0.1 % of either parameter is passed to the law once, and a smaller change is not."""
    for part in (0, 1):
        for change in (9e-4, -9e-4, 1.1e-3, -1.1e-3):
            use(axis, 0.2, 40.0)
            told.clear()
            estimate = [0.2, 40.0]
            estimate[part] *= 1.0 + change
            use(axis, *estimate)
            axis.adapt()
            assert told == ([tuple(estimate)] if abs(change) > 1e-3 else [])


def test_an_estimate_that_may_not_be_used_is_not(axis: ControlAxis, told: list[tuple[float, ...]]) -> None:
    """If the estimate may not be used, the law keeps the values of the model file or gets them once."""
    nominal = (axis.model.friction_angle, axis.model.pretension)
    axis.estimator.friction_angle, axis.estimator.pretension, axis.estimator.use = 0.1, 20.0, False
    axis.adapt()
    assert told == []
    use(axis, 0.2, 40.0)
    axis.estimator.use = False
    axis.adapt()
    assert told == [(0.2, 40.0), nominal]


def test_periods_without_a_cycle_count_for_the_guard_from_the_enable_on(
    axis: ControlAxis, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only periods that are skipped between enable and release count, because others put no energy into the joint."""
    told: list[int] = []
    monkeypatch.setattr(axis.guard, "skip_cycles", told.append)
    axis.skip_cycles(7)
    axis.since_enable(1.0)
    axis.skip_cycles(2)
    axis.release()
    axis.skip_cycles(5)
    assert told == [2]
