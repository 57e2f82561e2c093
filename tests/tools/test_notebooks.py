"""The notebooks run completely, and their results agree with their text."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import ROOT

FOLDER = ROOT / "tools" / "notebooks"


def run(name: str) -> dict[str, Any]:
    """Execute all code cells of a notebook in one namespace, and return it."""
    cells = json.loads((FOLDER / name).read_text(encoding="utf-8"))["cells"]
    names: dict[str, Any] = {"__name__": "notebook"}
    for cell in cells:
        if cell["cell_type"] == "code":
            exec(compile("".join(cell["source"]), f"{name}: {cell['id']}", "exec"), names)
    return names


@pytest.mark.slow
def test_a_csv_leads_to_the_hidden_weight() -> None:
    names = run("from_csv_to_cause.ipynb")
    (cause,) = names["found"].causes
    assert cause.effect == "gravity_load"
    assert cause.parameters["amplitude"].value == pytest.approx(0.3, rel=0.03)
    assert "gravity_load" in (names["folder"] / "extended.toml").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_gait_is_delivered_better_with_compensation() -> None:
    names = run("gait_controller.ipynb")
    assert names["reduction"] > 80.0
    assert names["torn"].axes[0].faults


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.ipynb")), ids=lambda path: path.name)
def test_a_notebook_is_committed_without_outputs(path: Path) -> None:
    found = json.loads(path.read_text(encoding="utf-8"))
    assert found["nbformat"] == 4
    assert not [cell["id"] for cell in found["cells"] if cell.get("outputs") or cell.get("execution_count")]
