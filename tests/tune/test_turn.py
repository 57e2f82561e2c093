"""A tuning takes another slew only where friction turns at once, the motor rings, and the same motion gets better."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from tests.control.sliding import actuator
from tests.tune.test_ringing import COMPENSATION, FRICTION, rig
from tsa_ctrl.tune.estimate import Estimate, Form
from tsa_ctrl.tune.excitation import Bounds, Waveform
from tsa_ctrl.tune.lag import with_lag
from tsa_ctrl.tune.procedure import Procedure, Settings
from tsa_ctrl.tune.run import Run

FREQUENCY = 97.7  # Hz
MOTION = Waveform(np.arange(0.0, 6.0, 0.005), np.zeros(1200))
NEW = Path("new.toml")


class Runner:
    """A rig that rings; with another slew its error is `after` times what it was."""

    def __init__(self, frequency: float, after: float) -> None:
        self.frequency = frequency
        self.after = after
        self.played: list[tuple[str, float | None]] = []

    def play(self, name, model, compensation, waveform, tick, slew=None) -> Run:  # type: ignore[no-untyped-def]
        assert (model, compensation) == (NEW, COMPENSATION)
        self.played.append((name, slew))
        error = 0.06 * (1.0 if slew is None else self.after) * np.ones(100)
        log = rig(self.frequency, 200.0 if slew is None else slew)
        return Run(name, Path(), np.zeros(100), np.zeros(100), error, (log,))


def turned(runner: Runner, lag: float = 0.003, slew: float = 200.0, compensation: float = COMPENSATION):  # type: ignore[no-untyped-def]
    """What the procedure makes of it: the notes, and the slew that it takes."""
    model = with_lag(actuator(), lag) if lag else actuator()
    found = Estimate(model, None, Form.GIVEN, {}, (), ())  # type: ignore[arg-type]
    settings = Settings(10.0, 6.0, compensation, slew, 500.0, certified_gain=False, forms=True, extended=False)
    told: list[float] = []
    procedure = Procedure(
        runner,  # type: ignore[arg-type]
        Path("actuator.toml"),
        actuator(),
        Bounds(1.0, 3.0),
        settings,
        Path(),
        lambda what, share: told.append(share),
    )
    noted, turn = procedure._turn(MOTION, found, NEW)
    assert dataclasses.replace(noted, notes=()) == found
    return noted.notes, turn


def test_a_slew_of_one_period_is_tried_on_the_same_motion_and_taken() -> None:
    runner = Runner(FREQUENCY, 0.7)
    notes, turn = turned(runner)
    assert turn.slew == pytest.approx(2.0 * COMPENSATION * FRICTION * FREQUENCY, rel=0.03)
    assert runner.played == [("turn-1", None), ("turn-2", turn.slew)]
    assert (turn.before, turn.rms_before, turn.rms_after) == (200.0, pytest.approx(0.06), pytest.approx(0.042))
    assert "rings on its tendons" in notes[0]


def test_a_slew_that_does_worse_is_left_and_said() -> None:
    notes, turn = turned(Runner(FREQUENCY, 1.1))
    assert turn is None
    assert notes[0].endswith("not taken")


def test_where_nothing_rings_one_run_is_all() -> None:
    runner = Runner(0.0, 0.7)
    assert turned(runner) == ((), None)
    assert runner.played == [("turn-1", None)]


def test_a_slew_that_is_right_already_stays() -> None:
    runner = Runner(FREQUENCY, 0.7)
    right = 2.0 * COMPENSATION * FRICTION * FREQUENCY
    assert turned(runner, slew=right) == ((), None)
    assert len(runner.played) == 1


@pytest.mark.parametrize(("lag", "compensation"), [(0.0, COMPENSATION), (0.003, 0.0)])
def test_friction_that_turns_gradually_or_is_not_compensated_costs_no_run(lag: float, compensation: float) -> None:
    runner = Runner(FREQUENCY, 0.7)
    assert turned(runner, lag=lag, compensation=compensation) == ((), None)
    assert runner.played == []
