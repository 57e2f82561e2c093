"""The selection terminates: a cause that pruning removes does not enter a second time."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tsa_ctrl.identify.diagnosis.selection import forward


def _fit(*names: str) -> Any:
    return SimpleNamespace(names=names, rss=1.0)


def _selected(
    monkeypatch: pytest.MonkeyPatch, order: Sequence[str], pruned: dict[frozenset[str], tuple[str, ...]]
) -> Any:
    """Return the causes selected when each of `order` always enters and pruning returns `pruned`."""
    rounds: list[int] = []

    def one_round(_problem: Any, fitted: Any, *_: Any) -> Any:
        rounds.append(1)
        assert len(rounds) < 20, "the selection goes round in circles"
        steps = tuple(_fit(*fitted.names, name) for name in order if name not in fitted.names)
        return SimpleNamespace(steps=steps, threshold=0.0)

    monkeypatch.setattr(forward, "_round", one_round)
    monkeypatch.setattr(forward, "_nominal_steps", lambda *_: ())
    monkeypatch.setattr(forward, "_plain_steps", lambda *_: ())
    monkeypatch.setattr(forward, "enters", lambda *_: True)
    monkeypatch.setattr(
        forward, "_entered", lambda problem, entry, _: (problem, _fit(*pruned.get(frozenset(entry.names), entry.names)))
    )
    monkeypatch.setattr(forward, "_evidence", lambda *_: ())
    problem: Any = None
    return forward.select(problem, _fit(), {}, np.random.default_rng(0)).fitted.names


def test_a_cause_that_pruning_drops_at_once_does_not_enter_again_and_the_next_one_may(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    dropped = {frozenset("ab"): ("a",), frozenset("acb"): ("a", "c")}
    assert _selected(monkeypatch, "abc", dropped) == ("a", "c")


def test_two_causes_that_drive_each_other_out_do_not_take_turns_without_end(monkeypatch: pytest.MonkeyPatch) -> None:
    assert _selected(monkeypatch, "ab", {frozenset("ab"): ("b",)}) == ("b",)
