"""Test reading valid and broken EDS files."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.bus.local_nodes import bench
from tests.bus.nodes import axis_nodes
from tsa_ctrl.bus.canopen.eds import check_plan, load_eds, read_eds
from tsa_ctrl.bus.canopen.objects import MAX_TORQUE, Object, Type, Write
from tsa_ctrl.bus.drive.bring_up import bring_up
from tsa_ctrl.bus.drive.profile import DriveProfile
from tsa_ctrl.bus.settings import BusSettings
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
    assert load_eds(write(tmp_path, GOOD.replace("Max torque", "Größtes Moment")))[0x6072].name == "Größtes Moment"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("DataType=0x0006\n", "", r"section \[6072\]: No option 'DataType'"),
        ("DataType=0x0006", "DataType=u16", r"section \[6072\]: ValueError: .*'u16'"),
        ("[1018]\n", "[1017]\n", r"section \[1018sub0\]: KeyError"),
        (GOOD, "rubbish\n", "describes no object that this controller uses"),
    ],
)
def test_broken_section_is_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(UsageError, match=message) as error:
        load_eds(write(tmp_path, GOOD.replace(old, new)))
    assert "\n" not in str(error.value)


SLIPS = {
    "empty numbers": ("VendorName=nobody\n", "VendorName=nobody\nVendorNumber=\nProductNumber=\nRevisionNumber=\n", 0),
    "leading zeros": ("HighLimit=3000", "HighLimit=03000", 0),
    "comment of C": ("DataType=0x0006", "DataType=0x0006 // UNSIGNED16", 0),
    "keys in another case": ("HighLimit=3000", "highlimit=3000", 0),
    "heading in another case": ("[1018sub1]", "[1018SUB1]", 0),
    "heading with 0x": ("[6072]", "[0x6072]", 0),
    "no number": ("LowLimit=0\n", "LowLimit=none\n", 1),
    "stray line": ("[FileInfo]\n", "[FileInfo]\nthis is not an assignment\n", 1),
    "line before the first section": ("[DeviceInfo]", "created by an editor\n[DeviceInfo]", 1),
    "section twice": ("[6072]", "[1000]\nDataType=0x0007\n[6072]", 1),
    "no name": ("ParameterName=Max torque\n", "", 0),
    "no access type": ("DataType=0x0006\nAccessType=rw\n", "DataType=0x0006\n", 1),
    "miscounted comments": ("[FileInfo]", "[Comments]\nLines=3\nLine1=one\n[FileInfo]", 0),
    "broken object of the vendor": ("[6072]", "[2031]\nParameterName=x\nDataType=float\nAccessType=rw\n[6072]", 2),
    "sub-index of nothing": ("[6072]", "[2031sub1]\nParameterName=x\nDataType=5\nAccessType=rw\n[6072]", 1),
}


@pytest.mark.parametrize("slip", SLIPS)
def test_a_slip_of_a_vendor_is_mended_and_told(tmp_path: Path, slip: str) -> None:
    """An EDS with a common vendor error is read completely, with the expected number of notes."""
    old, new, told = SLIPS[slip]
    assert old in GOOD
    dictionary, notes = read_eds(write(tmp_path, GOOD.replace(old, new)))
    assert (dictionary[0x6072].max, dictionary[0x1018][1].data_type, len(notes)) == (3000, 7, told)


def test_a_read_only_object_that_is_as_wanted_is_no_contradiction(tmp_path: Path) -> None:
    path = write(tmp_path, GOOD.replace("AccessType=rw\n", "AccessType=const\nDefaultValue=1000\n"))
    assert check_plan(load_eds(path), path, [Write(MAX_TORQUE, 1000)]) == [
        "its EDS states that 0x6072:0 max torque cannot be written"
    ]


def test_limits_of_nothing_are_no_limits(tmp_path: Path) -> None:
    path = write(tmp_path, GOOD.replace("LowLimit=0", "LowLimit=5000"))
    assert check_plan(load_eds(path), path, [Write(MAX_TORQUE, 1000)]) == []


def test_plan_that_fits_has_no_notes_but_for_what_is_lacking(tmp_path: Path) -> None:
    path = write(tmp_path, GOOD)
    plan = [Write(MAX_TORQUE, 1000), Write(Object(0x6080, 0, Type.U32, "max motor speed"), 1)]
    assert check_plan(load_eds(path), path, plan) == ["its EDS lacks 0x6080:0 max motor speed"]


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
        check_plan(load_eds(path), path, [Write(MAX_TORQUE, 1000)])


def test_bring_up_reports_what_the_eds_lacks(tmp_path: Path) -> None:
    profile = DriveProfile(eds=str(write(tmp_path, GOOD)))
    with bench() as nodes:
        report = bring_up(nodes.bus, BusSettings(interface="virtual"), [axis_nodes()], [profile], 0.001)
    assert "its EDS lacks 0x6080:0 max motor speed" in report.nodes[0].notes
