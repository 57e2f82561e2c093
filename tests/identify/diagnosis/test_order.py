"""The stages of a diagnosis import each other in one direction only, in the order of `pipeline.diagnose`."""

from __future__ import annotations

import pytest

from tests.test_layers import graph

DIAGNOSIS = "identify.diagnosis."
STAGES = (
    "criteria",
    "data",
    "hypotheses",
    "noise",
    "fitting",
    "selection",
    "residual",
    "rivals",
    "parameters",
    "refusals",
    "report",
    "pipeline",
)


def stage(module: str) -> int:
    return STAGES.index(module.removeprefix(DIAGNOSIS).split(".")[0])


@pytest.mark.slow
@pytest.mark.xdist_group("layers")  # runs with tests/test_layers.py, which has already read the import graph
def test_a_stage_imports_only_stages_before_it() -> None:
    inside = {name: others for name, others in graph().items() if name.startswith(DIAGNOSIS)}
    wrong = [
        f"{name}, line {line}: imports {other}, a later stage"
        for name, others in inside.items()
        for other, line in others.items()
        if other.startswith(DIAGNOSIS) and stage(other) > stage(name)
    ]
    assert {stage(name) for name in inside} == set(range(len(STAGES)))
    assert not wrong, "\n" + "\n".join(wrong)
