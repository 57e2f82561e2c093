"""Every cause has its own id, title and remedy."""

from __future__ import annotations

import re

from tests.conftest import ROOT
from tsa_ctrl.bus.drive.profile import DriveProfile
from tsa_ctrl.config import ControllerFile
from tsa_ctrl.model.actuator_file import ActuatorFile
from tsa_ctrl.safety.causes import Cause, Fault, Finding
from tsa_ctrl.settings import tables_of

DO = re.compile(r"\b(check|end|remove|look up|run|choose|compare|give|cut|find out|tsa doctor|tsa drive)\b")


def test_every_cause_has_a_remedy_whose_keys_and_tables_exist() -> None:
    tables = [table for kind in (ControllerFile, DriveProfile, ActuatorFile) for table in tables_of(kind)]
    keys = {table.header: table.keys for table in tables}
    all_keys = {key for table in tables for key in table.keys}
    for cause in Cause:
        assert DO.search(cause.remedy), cause
        assert cause.id == cause.name.lower()
        assert set(re.findall(r"[a-z]+_[a-z_]+", cause.remedy)) <= all_keys, cause
        for header, key in re.findall(r"(\[[\w.]+\])(?: (\w+))?", cause.remedy):
            assert header in keys, cause
            assert not key or key in keys[header], cause


def test_no_two_causes_share_a_title() -> None:
    assert len({cause.title for cause in Cause}) == len(Cause)


def test_the_text_of_a_fault_begins_with_the_title_whatever_its_detail_holds() -> None:
    detail = "drive node 1: 3 cycles in a row; joint encoder node 32: 4 cycles in a row"
    assert str(Fault(Cause.STALE_PDO, detail, 0.0)) == str(Finding(Cause.STALE_PDO, detail)) == f"stale PDO: {detail}"


def test_every_cause_is_tripped_somewhere() -> None:
    """Every cause in the table is used by a module."""
    texts = (path.read_text(encoding="utf-8") for path in (ROOT / "tsa_ctrl").rglob("*.py"))
    used = {name for text in texts for name in re.findall(r"\bCause\.([A-Z][A-Z_]+)", text)}
    assert used == {cause.name for cause in Cause}
