"""Test reading valid and broken EDS files."""

from __future__ import annotations

from pathlib import Path

import pytest

from tsa_ctrl.bus.canopen.eds import check_plan, read_eds
from tsa_ctrl.bus.canopen.objects import (
    FAULT_REACTION_OPTION,
    HEARTBEAT_CONSUMER,
    MAX_TORQUE,
    Object,
    Type,
    Write,
)
from tsa_ctrl.errors import UsageError

GOOD = """\
[DeviceInfo]
VendorName=nobody
[FileInfo]
FileName=drive.eds
[1000]
ParameterName=Device type
ObjectType=0x7
DataType=0x0007
AccessType=ro
[1018]
ParameterName=Identity
ObjectType=0x9
SubNumber=2
[1018sub0]
ParameterName=Number of entries
DataType=0x0005
AccessType=ro
[1018sub1]
ParameterName=Vendor
DataType=0x0007
AccessType=ro
[6072]
ParameterName=Max torque
ObjectType=0x7
DataType=0x0006
AccessType=rw
LowLimit=0
HighLimit=3000
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "drive.eds"
    path.write_bytes(text.encode("latin-1"))
    return path


def test_file_in_the_encoding_of_a_vendors_editor_is_read(tmp_path: Path) -> None:
    path = write(tmp_path, GOOD.replace("Max torque", "Größtes Moment"))
    assert read_eds(path)[0x6072, 0]["parametername"] == "Größtes Moment"


def test_a_file_without_objects_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="describes no object"):
        read_eds(write(tmp_path, "rubbish\n[FileInfo]\nFileName=drive.eds\n"))


SLIPS = {
    "leading zeros": ("HighLimit=3000", "HighLimit=03000"),
    "comment of C": ("DataType=0x0006", "DataType=0x0006 // UNSIGNED16"),
    "keys in another case": ("HighLimit=3000", "highlimit=3000"),
    "heading in another form": ("[6072]", "[0x6072SUB0]"),
    "no number": ("LowLimit=0\n", "LowLimit=none\n"),
    "stray line": ("[6072]\n", "[6072]\nthis is not an assignment\n"),
    "line before the first section": ("[DeviceInfo]", "created by an editor\n[DeviceInfo]"),
    "section twice": ("[6072]", "[6072]\nHighLimit=50\n[6072]"),
    "no access type": ("DataType=0x0006\nAccessType=rw\n", "DataType=0x0006\n"),
    "broken object of the vendor": ("[6072]", "[2031]\nParameterName=x\nDataType=float\nAccessType=rw\n[6072]"),
}


@pytest.mark.parametrize("slip", SLIPS)
def test_a_slip_of_a_vendor_does_no_harm(tmp_path: Path, slip: str) -> None:
    """The limit of 3000 is read from an EDS with a common vendor error."""
    old, new = SLIPS[slip]
    assert old in GOOD
    path = write(tmp_path, GOOD.replace(old, new))
    assert check_plan(path, [Write(MAX_TORQUE, 3000)]) == []
    with pytest.raises(UsageError, match=r"0 to 3000|at most 3000"):
        check_plan(path, [Write(MAX_TORQUE, 3001)])


def test_limits_of_a_signed_object_may_be_hexadecimal(tmp_path: Path) -> None:
    path = write(tmp_path, GOOD + "[605E]\nDataType=0x0003\nAccessType=rw\nLowLimit=0xFFFE\nHighLimit=2\n")
    assert check_plan(path, [Write(FAULT_REACTION_OPTION, -2)]) == []
    with pytest.raises(UsageError, match="-2 to 2"):
        check_plan(path, [Write(FAULT_REACTION_OPTION, 3)])


def test_a_compact_array_describes_its_entries(tmp_path: Path) -> None:
    path = write(tmp_path, GOOD + "[1016]\nDataType=0x0007\nAccessType=rw\nCompactSubObj=2\n")
    assert check_plan(path, [Write(HEARTBEAT_CONSUMER, 5)]) == []


def test_a_read_only_object_that_is_as_wanted_is_no_contradiction(tmp_path: Path) -> None:
    path = write(tmp_path, GOOD.replace("AccessType=rw\n", "AccessType=const\nDefaultValue=1000\n"))
    assert check_plan(path, [Write(MAX_TORQUE, 1000)]) == ["its EDS states that 0x6072:0 max torque cannot be written"]


def test_limits_of_nothing_are_no_limits(tmp_path: Path) -> None:
    path = write(tmp_path, GOOD.replace("LowLimit=0", "LowLimit=5000"))
    assert check_plan(path, [Write(MAX_TORQUE, 1000)]) == []


def test_plan_that_fits_has_no_notes_but_for_what_is_lacking(tmp_path: Path) -> None:
    path = write(tmp_path, GOOD)
    plan = [Write(MAX_TORQUE, 1000), Write(Object(0x6080, 0, Type.U32, "max motor speed"), 1)]
    assert check_plan(path, plan) == ["its EDS lacks 0x6080:0 max motor speed"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("DataType=0x0006", "DataType=0x0007", r"section \[6072\]: DataType is 0x0007, .* has 0x0006 \(u16\)"),
        ("AccessType=rw", "AccessType=const\nDefaultValue=500", r"\[6072\]: .* is 'const' with 500, but must be 1000"),
        ("HighLimit=3000", "HighLimit=500", r"section \[6072\]: .* must be 1000, but the EDS allows 0 to 500"),
        ("LowLimit=0\nHighLimit=3000", "HighLimit=500", r"must be 1000, but the EDS allows at most 500"),
    ],
)
def test_plan_that_contradicts_the_eds_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = write(tmp_path, GOOD.replace(old, new, 1) if "DataType" not in old else GOOD.replace(old, new))
    with pytest.raises(UsageError, match=message):
        check_plan(path, [Write(MAX_TORQUE, 1000)])
