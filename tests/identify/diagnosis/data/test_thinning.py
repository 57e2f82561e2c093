"""Selection of the most informative logs. The logs are synthetic, and each test checks which logs must be selected."""

from __future__ import annotations

import functools
import re
import zlib

import numpy as np
import pytest

from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.diagnosis import diagnose
from tsa_ctrl.identify.diagnosis.data import prepare
from tsa_ctrl.identify.diagnosis.data.prepare import informative
from tsa_ctrl.model.parameters import RigidDrive

SECONDS, RATE = 20.0, 50.0


def log(name: str, speed: float, load: float = 0.0, spring: float = 0.0) -> Dataset:
    """Return a log of a sine of 1 rad with an angular frequency of `speed` rad/s.

    The torque is a constant load, friction of 0.3 N*m, viscous friction and a spring.
    """
    t = np.arange(round(SECONDS * RATE)) / RATE
    q, omega = np.sin(speed * t), speed * np.cos(speed * t)
    noise = 0.01 * np.random.default_rng(zlib.crc32(name.encode())).standard_normal(len(t))
    tau = load + 0.3 * np.sign(omega) + 0.05 * omega + spring * q + noise
    return Dataset.from_arrays({"t": t, "tau_m": tau, "q_m": q, "omega_m": omega}, name)


def names(logs: list[Dataset]) -> list[str]:
    return [each.name for each in logs]


def test_few_logs_stay_as_they_are() -> None:
    logs = [log(f"a{number}", 1.0) for number in range(5)]
    assert informative(logs, None) == logs


def test_what_differs_stays_and_what_repeats_goes() -> None:
    same = [log(f"same{number:02d}", 1.0) for number in range(40)]
    rare = [log("fast", 4.0), log("loaded", 1.0, 2.0), log("slow", 0.2)]
    kept = informative([*same[:20], *rare, *same[20:]], None, 200.0)
    assert {"fast", "loaded", "slow"} <= set(names(kept))
    assert sum(each.seconds for each in kept) <= 200.0
    assert len(kept) >= 9
    assert names(kept) == [name for name in names([*same[:20], *rare, *same[20:]]) if name in names(kept)]


def test_what_is_held_out_has_its_share() -> None:
    logs = [log(f"a{number:02d}", 1.0 + 0.1 * number) for number in range(20)]
    logs += [log(f"held{number:02d}", 1.0 + 0.1 * number) for number in range(20)]
    kept = names(informative(logs, "held*", 300.0))
    assert sum(name.startswith("held") for name in kept) == 5
    assert len(kept) == 15


@pytest.mark.slow
def test_a_diagnosis_uses_the_logs_that_tell_most_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """The diagnosis uses 100 s out of 12 logs. The limit for fifty logs (below) is 600 s."""
    monkeypatch.setattr(prepare, "informative", functools.partial(informative, longest=100.0))
    drive = RigidDrive(coulomb_friction=0.25, viscous_friction=0.06)
    found = diagnose([log(f"{number:02d}", 0.5 + 0.2 * number, spring=0.2) for number in range(12)], drive)
    assert found.causes[0].effect == "joint_stiffness"
    assert found.details is not None
    assert found.details.notes[0] == "5 of 12 logs, 100 s, are used: the others repeat them"


@pytest.mark.slow
@pytest.mark.soak
def test_fifty_logs_are_diagnosed_as_thirty_are() -> None:
    """Regression test with 1,000 s of logs.

    When the sampling rate fell with the length, friction reversals were lost.
    """
    drive = RigidDrive(coulomb_friction=0.25, viscous_friction=0.06)
    logs = {f"{number:02d}": log(f"{number:02d}", 0.5 + 0.05 * number, spring=0.2) for number in range(50)}
    found = diagnose(list(logs.values()), drive)
    assert found.verdict.value == "explained"
    assert found.causes[0].effect == "joint_stiffness"
    assert found.causes[0].parameters["stiffness"].low < 0.2 < found.causes[0].parameters["stiffness"].high  # type: ignore[union-attr]
    assert found.details is not None
    assert re.match(r"\d+ of 50 logs, \d+ s, are used: the others repeat them", found.details.notes[0])


def test_a_pattern_that_matches_no_log_is_told_as_before() -> None:
    logs = [log(f"a{number:02d}", 1.0) for number in range(40)]
    with pytest.raises(UsageError, match="'b\\*' matches no log"):
        diagnose(logs, RigidDrive(coulomb_friction=0.3), hold_out="b*")


@pytest.mark.parametrize(("rates", "resampled"), [((1000, 1400), False), ((3000, 1000), False), ((100, 140), True)])
def test_logs_of_two_loggers_are_averaged_over_equal_times(rates: tuple[int, int], resampled: bool) -> None:
    """All logs share one noise model, in samples of the averages."""
    logs = []
    for rate in rates:
        t = np.arange(10 * rate) / rate
        columns = {"t": t, "tau_m": np.sin(2.0 * t), "q_m": np.sin(3.0 * t), "omega_m": 3.0 * np.cos(3.0 * t)}
        logs.append(Dataset.from_arrays(columns, f"at {rate} Hz"))
    runs = prepare.prepare(logs, RigidDrive(inertia=0.1))
    assert runs[0].period == pytest.approx(runs[1].period, rel=0.05)
    for run in runs:
        times = run.average(run.signals.t)
        np.testing.assert_allclose(run.average(run.target), np.sin(2.0 * times), atol=2e-3)
    notes = " ".join(note for run in runs for note in run.raw.notes)
    assert ("at 140 Hz: resampled by straight lines from 140 Hz to 100 Hz" in notes) is resampled
