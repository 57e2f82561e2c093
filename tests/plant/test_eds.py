"""Test the EDS files of the plant with canopen and with the rules of CANopenEditor."""

from __future__ import annotations

import configparser
import io
import re
from pathlib import Path

import pytest
from canopen.objectdictionary import ODVariable
from canopen.objectdictionary.eds import import_eds
from click.testing import CliRunner

from tests.plant.bench import plant_file
from tsa_ctrl.cli import cli
from tsa_ctrl.plant.process import eds_files

# Rules of CANopenEditor (libEDSsharp): sections with their keys, and formats of dates, times and access types.
KEYS = {
    "FileInfo": "FileName FileVersion FileRevision EDSVersion Description CreationTime CreationDate CreatedBy "
    "ModificationTime ModificationDate ModifiedBy",
    "DeviceInfo": "VendorName VendorNumber ProductName ProductNumber RevisionNumber OrderCode BaudRate_10 BaudRate_20 "
    "BaudRate_50 BaudRate_125 BaudRate_250 BaudRate_500 BaudRate_800 BaudRate_1000 "
    "SimpleBootUpMaster SimpleBootUpSlave Granularity DynamicChannelsSupported CompactPDO GroupMessaging NrOfRXPDO "
    "NrOfTXPDO LSS_Supported",
    "DummyUsage": "Dummy0001 Dummy0002 Dummy0003 Dummy0004 Dummy0005 Dummy0006 Dummy0007",
    "Comments": "Lines Line1",
}
ACCESSES = {"ro", "wo", "rw", "rwr", "rww", "const"}
SEVERAL = "".join(
    f"[[axis]]\nname = '{name}'\ndrive.node_id = 1\ndrive.slot = {slot}\nencoder.present = false\n"
    "torque_sensor.present = false\n"
    for slot, name in enumerate("ab", 1)
)


def texts(folder: Path, text: str) -> dict[str, str]:
    return {path.name: content for path, content in eds_files(plant_file(folder, text), folder / "out.eds")}


def parsed(text: str) -> configparser.RawConfigParser:
    parser = configparser.RawConfigParser(strict=True)
    parser.optionxform = str  # type: ignore[assignment, method-assign]
    parser.read_string(text)
    return parser


@pytest.mark.parametrize("kind", ["generic", "epos4"])
def test_canopen_finds_every_object_with_its_type_and_default(tmp_path: Path, kind: str) -> None:
    written = texts(tmp_path, f"[[axis]]\nname = 'joint'\ndrive.kind = '{kind}'\n")
    assert list(written) == ["out-1.eds", "out-32.eds", "out-64.eds"]
    dictionary = import_eds(io.StringIO(written["out-1.eds"]), 5)
    target = dictionary[0x6071]
    assert isinstance(target, ODVariable)
    assert (target.data_type, target.writable, target.pdo_mappable) == (3, True, True)
    assert (dictionary[0x1800][1].default, dictionary[0x1014].default) == (0x40000185, 0x85)
    assert (0x6072 in dictionary) == (kind != "epos4")


def test_one_node_is_one_file(tmp_path: Path) -> None:
    text = "[[axis]]\nname = 'joint'\nencoder.present = false\ntorque_sensor.present = false\n"
    assert list(texts(tmp_path, text)) == ["out.eds"]


@pytest.mark.parametrize("text", ["[[axis]]\nname = 'joint'\n", SEVERAL])
def test_the_rules_of_canopeneditor_hold(tmp_path: Path, text: str) -> None:
    for content in texts(tmp_path, text).values():
        parser = parsed(content)
        for section, keys in KEYS.items():
            assert set(keys.split()) <= set(parser[section]), section
        for key in ("CreationTime", "ModificationTime"):
            assert re.fullmatch(r"\d\d:\d\d[AP]M", parser["FileInfo"][key])
        listed = []
        for section in ("MandatoryObjects", "OptionalObjects", "ManufacturerObjects"):
            count = int(parser[section]["SupportedObjects"])
            listed += [int(parser[section][str(number)], 16) for number in range(1, count + 1)]
            assert len(parser[section]) == count + 1
        objects = [int(section, 16) for section in parser.sections() if re.fullmatch(r"[0-9A-F]{4}", section)]
        assert sorted(listed) == sorted(objects)
        _check_objects(parser, objects)


def _check_objects(parser: configparser.RawConfigParser, objects: list[int]) -> None:
    for index in objects:
        head = parser[f"{index:04X}"]
        members = [section for section in parser.sections() if re.fullmatch(rf"{index:04X}sub[0-9A-F]+", section)]
        assert int(head["ObjectType"], 16) in ((7,) if not members else (8, 9))
        if members:
            assert int(head["SubNumber"], 16) == len(members)
            assert f"{index:04X}sub0" in members
        for section in members or [f"{index:04X}"]:
            assert parser[section]["AccessType"] in ACCESSES
            assert {"ParameterName", "ObjectType", "DataType", "DefaultValue", "PDOMapping"} <= set(parser[section])


def test_quirks_are_in_the_file(tmp_path: Path) -> None:
    quirks = "drive.absent = [0x6502]\ndrive.read_only = ['0x6007']\ndrive.objects = { '0x6007:0' = 3 }\n"
    parser = parsed(texts(tmp_path, f"[[axis]]\nname = 'joint'\n{quirks}")["out-1.eds"])
    assert "6502" not in parser
    assert (parser["6007"]["AccessType"], parser["6007"]["DefaultValue"]) == ("ro", "3")


def test_the_verb_writes_and_ends(tmp_path: Path) -> None:
    plant = plant_file(tmp_path, "[[axis]]\nname = 'joint'\n")
    result = CliRunner().invoke(cli, ["plant", str(plant), "--eds", str(tmp_path / "node.eds")])
    assert result.exit_code == 0, result.output
    assert result.output.split() == [str(tmp_path / f"node-{node}.eds") for node in (1, 32, 64)]
    assert (tmp_path / "node-1.eds").read_bytes().startswith(b"[FileInfo]\r\nFileName=node-1.eds\r\n")
