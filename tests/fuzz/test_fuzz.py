"""Small doses of what campaign/fuzz throws at length, and that its judge can tell."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.fuzz import configuring, files, guided, guided_example, master, nodes, requests
from tests.fuzz.part import Part
from tests.fuzz.targets import targets
from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.parameters import load_model
from tsa_ctrl.safety.supervisor import Supervisor

DOSES: list[tuple[Callable[[int, int], Part], int, tuple[str, ...]]] = [  # part, inputs, what must have happened
    (master.run, 30_000, ("cycles with torque", "faults")),
    (nodes.run, 20_000, ("answers", "frames with torque", "resets")),
    (configuring.run, 6, ("succeeded",)),
    (requests.run, 2_000, ("refused", "taken", "commands", "told: refused", "alive")),
    (files.run, 300, ("refused", "taken")),
]


@pytest.mark.slow
@pytest.mark.parametrize(("run", "dose", "happened"), DOSES, ids=[run.__module__.split(".")[-1] for run, *_ in DOSES])
def test_nonsense_does_no_harm(run: Callable[[int, int], Part], dose: int, happened: tuple[str, ...]) -> None:
    """No crash, no torque that may not be, no descriptor left open; and it was not idle."""
    part = run(dose, 1)
    assert part.problems == []
    assert all(part.counts[name] for name in happened), part.counts
    assert part.after.descriptors <= part.before.descriptors


def test_judge_sees_a_supervisor_that_is_blind(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a supervisor that watches nothing, the judge finds torque where there may be none."""
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
    """What once ended in a traceback, or got through, is one line."""
    path = tmp_path / "a.toml"
    path.write_text(line, encoding="utf-8")
    with pytest.raises(UsageError, match=words) as found:
        load_model(path)
    assert "\n" not in str(found.value)


@pytest.mark.parametrize("name", ["a\0b", "a" * 5000])
def test_names_that_are_no_paths(name: str) -> None:
    """The file system's refusal is said in one line, too."""
    with pytest.raises(UsageError):
        load_model(name)


def test_same_seed_same_nonsense() -> None:
    """A problem can be repeated by its seed."""
    assert files._spoil("a = 1\nb = 2", random.Random(3)) == files._spoil("a = 1\nb = 2", random.Random(3))


@pytest.mark.slow
@pytest.mark.parametrize("target", targets(), ids=lambda target: target.name)
def test_what_comes_from_outside_is_taken_or_refused_in_words(target: guided.Target) -> None:
    """The corpus, which must still reach its goal, and a hundred inputs made of it."""
    known = len(target.seeds) + len(guided.kept(target.name))
    part = guided.run(target, 60.0, 1, most=known + 100)
    assert part.problems == []
    assert part.inputs == known + 100


@pytest.mark.slow
def test_coverage_leads_to_what_no_chance_finds() -> None:
    """Three words of a language in a row, each a branch of its own: one is built upon the other."""
    found: list[bytes] = []

    def call(data: bytes) -> None:
        if guided_example.depth(data) == 3:
            found.append(data)

    target = guided.Target(
        "example", call, ("tests.fuzz.guided_example",), (b"....",), (b"\x5b", b"\xa9", b"\x07"), 1.0
    )
    part = guided.run(target, 60.0, 1, most=20_000)
    assert found
    assert part.problems == []


def test_a_goal_that_is_not_reached_and_a_crash_are_problems() -> None:
    def call(data: bytes) -> None:
        if not data:
            raise ValueError("empty")

    target = guided.Target("example", call, ("tests.fuzz.guided_example",), (b"x", b""), (), 0.5)
    said = guided.run(target, 60.0, 1, most=2).problems
    assert "ValueError: empty" in said[0]
    assert said[1] == "0 of 7 lines, the goal is 50%"


FOUND = {  # by it, in its first minutes; each was a traceback, or several lines
    "set-point": b"time,x\n0,0\n",  # none of the wanted columns
    "csv": b"t,tau_j\n0,1\n\xe4\n",  # a row of a wrong length that is no text
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
