"""A diagnosis by two processes is the one by one process, bit for bit; a caller gets no second one unasked."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Callable
from typing import Any

import pytest

from tests.blind import case
from tsa_ctrl.identify import diagnose
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.model.parameters import model_from
from tsa_ctrl.system import twin


@pytest.mark.slow
@pytest.mark.parametrize(
    ("family", "name"), [("single", "presliding_hysteresis"), ("pair", "any"), ("rigid", "gravity_load")]
)
def test_the_answer_does_not_depend_on_the_number_of_processes(
    family: str, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Down to the last digit, though the other process was asked for a part of it."""
    hidden = case(family, name, 9907, short=True)
    met: list[str] = []
    swapped = twin._Other.swapped

    def counted(other: Any, mine: object, where: str, *rest: Any) -> Any:
        found = swapped(other, mine, where, *rest)  # raises where the two are no longer in step
        met.append(where)
        return found

    def answer(leads: bool = True) -> str:
        logs = [Dataset.from_arrays(log.columns, log.name) for log in hidden.logs]
        return diagnose(logs, model_from(tomllib.loads(hidden.model), "nominal.toml")).to_json()

    monkeypatch.setattr(twin._Other, "swapped", counted)
    monkeypatch.setattr(twin, "PATIENCE", 300.0)  # the other may be kept from its processor, but never astray
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    alone, pieces = counted_alone(answer, monkeypatch)
    assert met == []
    assert twin.in_step(answer) == alone
    assert len(met) == pieces > 10


def counted_alone(work: Callable[[], str], monkeypatch: pytest.MonkeyPatch) -> tuple[str, int]:
    """What `work` gives, and how often one process comes to a pair of pieces that is in no other piece."""
    seen = depth = 0
    both = twin._both

    def noted(here: Callable[[], Any], there: Callable[[], Any], known: Any, where: str) -> tuple[Any, Any]:
        nonlocal seen, depth
        seen += depth == 0
        depth += 1
        try:
            return both(here, there, known, where)
        finally:
            depth -= 1

    with monkeypatch.context() as patched:
        patched.setattr(twin, "_both", noted)
        return work(), seen
