"""A diagnosis by two processes is the one by one process, bit for bit; a caller gets no second one unasked."""

from __future__ import annotations

import os
import tomllib

import pytest

from tests.blind import case
from tsa_ctrl.identify import diagnose
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.model.parameters import model_from
from tsa_ctrl.system.twin import twins


@pytest.mark.slow
@pytest.mark.parametrize(
    ("family", "name"), [("single", "presliding_hysteresis"), ("pair", "any"), ("rigid", "gravity_load")]
)
def test_the_answer_does_not_depend_on_the_number_of_processes(
    family: str, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Down to the last digit, though the other process was asked for a part of it."""
    hidden = case(family, name, 9907, short=True)
    forked: list[int] = []
    fork = os.fork

    def counted() -> int:
        forked.append(fork())
        return forked[-1]

    def answer() -> str:
        logs = [Dataset.from_arrays(log.columns, log.name) for log in hidden.logs]
        return diagnose(logs, model_from(tomllib.loads(hidden.model), "nominal.toml")).to_json()

    monkeypatch.setattr(os, "fork", counted)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    alone = answer()
    assert forked == []
    with twins():
        assert answer() == alone
    assert len(forked) > 5
