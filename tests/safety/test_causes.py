"""Every cause has its own id, title and remedy."""

from __future__ import annotations

import ast
import re

import pytest

from tests.conftest import ROOT
from tsa_ctrl.safety.causes import Cause, Fault, Finding

DO = re.compile(r"\b(check|end|remove|look up|run|choose|compare|give|cut|find out|tsa doctor|tsa drive)\b")


@pytest.mark.parametrize("cause", list(Cause))
def test_every_cause_has_a_remedy(cause: Cause) -> None:
    assert DO.search(cause.remedy)
    assert cause.id == cause.name.lower()


def test_no_two_causes_share_a_title() -> None:
    assert len({cause.title for cause in Cause}) == len(Cause)


def test_the_text_of_a_fault_begins_with_the_title_whatever_its_detail_holds() -> None:
    detail = "drive node 1: 3 cycles in a row; joint encoder node 32: 4 cycles in a row"
    assert str(Fault(Cause.STALE_PDO, detail, 0.0)) == str(Finding(Cause.STALE_PDO, detail)) == f"stale PDO: {detail}"


def test_every_cause_is_tripped_somewhere() -> None:
    """Every cause in the table is used by a module."""
    used = {
        node.attr
        for path in (ROOT / "tsa_ctrl").rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "Cause"
    }
    assert used == {cause.name for cause in Cause}
