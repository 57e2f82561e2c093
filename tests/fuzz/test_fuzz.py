"""Run small parts of campaign/fuzz, and check that its judge detects faults."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.fuzz import configuring, master
from tests.fuzz.corpus import Target
from tests.fuzz.part import Part
from tests.fuzz.targets import targets
from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.parameters import load_model
from tsa_ctrl.safety.supervisor import Supervisor

DOSES: list[tuple[Callable[[int, int], Part], int, tuple[str, ...]]] = [  # part, number of inputs, required events
    (master.run, 30_000, ("cycles with torque", "faults")),
    (configuring.run, 6, ("succeeded",)),
]


@pytest.mark.slow
@pytest.mark.parametrize(("run", "dose", "happened"), DOSES, ids=[run.__module__.split(".")[-1] for run, *_ in DOSES])
def test_nonsense_does_no_harm(run: Callable[[int, int], Part], dose: int, happened: tuple[str, ...]) -> None:
    """There are no problems and no leaked descriptors, and each required event occurred."""
    part = run(dose, 1)
    assert part.problems == []
    assert all(part.counts[name] for name in happened), part.counts
    assert part.after.descriptors <= part.before.descriptors


def test_judge_sees_a_supervisor_that_is_blind(monkeypatch: pytest.MonkeyPatch) -> None:
    """The checks of the supervisor are disabled, and the judge reports problems."""
    monkeypatch.setattr(Supervisor, "_watch", lambda self, image, now: None)
    monkeypatch.setattr(Supervisor, "_check_running", lambda self, image, state, now: None)
    assert master.run(20_000, 1).problems


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("a = " + "[" * 2000 + "]" * 2000, "nested too deeply"),
        ("[pretension]\nvalue = nan", "pretension.value: found nan; give a finite number"),
        ("[pretension]\nvalue = 1e999", "found inf"),
    ],
)
def test_files_that_were_found_by_it(tmp_path: Path, line: str, words: str) -> None:
    """Inputs that once caused a traceback or were wrongly accepted give a one-line error."""
    path = tmp_path / "a.toml"
    path.write_text(line, encoding="utf-8")
    with pytest.raises(UsageError, match=words) as found:
        load_model(path)
    assert "\n" not in str(found.value)


@pytest.mark.parametrize("name", ["a\0b", "a" * 5000])
def test_names_that_are_no_paths(name: str) -> None:
    """A file name that the file system rejects gives a UsageError."""
    with pytest.raises(UsageError):
        load_model(name)


@pytest.mark.slow
@pytest.mark.parametrize("target", targets(), ids=lambda target: target.name)
@given(data=st.data())
@settings(max_examples=100, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
def test_what_comes_from_outside_is_taken_or_refused_in_words(target: Target, data: st.DataObject) -> None:
    target.call(data.draw(target.changed()))


@pytest.mark.parametrize("target", targets(), ids=lambda target: target.name)
def test_what_once_reached_a_new_line_is_taken_or_refused_in_words(target: Target) -> None:
    for data in target.inputs:
        target.call(data)


FOUND = {  # by coverage-guided fuzzing; each once caused a traceback or several lines
    "set-point": b"time,x\n0,0\n",  # none of the required columns
    "csv": b"t,tau_j\n0,1\n\xe4\n",  # a row of the wrong length that is not UTF-8
    "mcap": None,
    "eds": b"[6072]\n=0x1000\n",
    "http": b"GET /?to\xc0en=secret\nhost: localhost:8123\n\n",
}


@pytest.mark.parametrize("name", FOUND)
def test_what_was_found_by_coverage(name: str, capfd: pytest.CaptureFixture[str]) -> None:
    target = next(each for each in targets() if each.name == name)
    data = FOUND[name]
    target.call(target.seeds[0].replace(b"tsa_ctrl/Cycle", b"tsa_ctrl\n/Cycl") if data is None else data)
    assert capfd.readouterr().err == ""
