"""Test dump, restore and diff of a drive's objects, and the command that runs them."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

from tests.drives.rig import STILL, running
from tests.plant.bench import plant_file
from tsa_ctrl.bus.drive.backup import Backup, StoredObject, load_backup
from tsa_ctrl.bus.drive.bring_up import bring_up
from tsa_ctrl.bus.drive.profile import DriveProfile
from tsa_ctrl.bus.settings import AxisNodes, BusSettings, DriveSettings
from tsa_ctrl.bus.wire.python_can import PythonCan
from tsa_ctrl.cli import main
from tsa_ctrl.cli.drive import command
from tsa_ctrl.errors import TsaError
from tsa_ctrl.plant.cia402 import PowerState
from tsa_ctrl.plant.dictionary import Access, Key, ObjectDictionary
from tsa_ctrl.plant.machine import DriveNode
from tsa_ctrl.plant.pdo import PdoDefault, Rpdo

OBJECTS = "drive.objects = {'0x6072:0' = 2999, '0x60B2:0' = 120, '0x60E0:0' = 400}\n"  # left by another tool


class Simulated:
    """A drive of a plant that runs in a thread, and the channel of its bus."""

    def __init__(self, channel: str, node: DriveNode) -> None:
        self.channel = channel
        self.node = node
        self.values = node.values

    @property
    def dictionary(self) -> ObjectDictionary:
        return self.node.dictionary


@pytest.fixture
def drive(tmp_path: Path) -> Iterator[Simulated]:
    (tmp_path / "plant").mkdir()
    text = f"[[axis]]\nname = 'joint'\ndrive.serial_number = 7\n{OBJECTS}{STILL}"
    with running(plant_file(tmp_path / "plant", text)) as (channel, machine):
        node = machine.axes[0].by_kind["drive"]
        assert isinstance(node, DriveNode)
        yield Simulated(channel, node)


def run(drive: Simulated, *arguments: str) -> str:
    """Run the command on the bus of this drive and return its stdout. Exceptions are raised again."""
    options = ["--node", "1", "--interface", "virtual", "--channel", drive.channel]
    result = CliRunner().invoke(command, [*arguments, *options])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.stdout


def held(drive: Simulated) -> dict[Key, int]:
    """Return the drive's values of all objects that a bring-up writes."""
    keys = [(i, 0) for i in (0x1017, 0x6007, 0x6060, 0x6072, 0x6080, 0x60A9)] + [(0x1016, 1), (0x1400, 1), (0x1600, 0)]
    return {key: drive.values[key] for key in keys}


def configure(drive: Simulated) -> None:
    bus = PythonCan("virtual", drive.channel, 1_000_000)
    axis = AxisNodes(name="knee", drive=DriveSettings(node_id=1))
    bring_up(bus, BusSettings(interface="virtual"), [axis], [DriveProfile()], 0.001)
    bus.close()


def test_dump_restores_the_drive_as_it_was(drive: Simulated, tmp_path: Path) -> None:
    before = held(drive)
    file = tmp_path / "drive.toml"
    run(drive, "dump", "--out", str(file))
    configure(drive)
    assert held(drive) != before
    run(drive, "restore", str(file))
    assert held(drive) == before
    assert "0 differ" in run(drive, "diff", str(file))


def test_dump_holds_what_the_drive_has_and_no_command(drive: Simulated, tmp_path: Path) -> None:
    file = tmp_path / "drive.toml"
    run(drive, "dump", "--out", str(file))
    backup = load_backup(file)
    found = {(item.index, item.subindex): item.value for item in backup.object}
    assert (backup.vendor_id, backup.product_code, backup.serial_number) == (0x0F0F, 0x0402, 7)
    assert (found[0x6072, 0], found[0x60C2, 2], found[0x1400, 1]) == (2999, -3, 0x201)
    assert (found[0x60B2, 0], found[0x60E0, 0]) == (120, 400)  # offset and limit of the torque
    assert not {(0x6040, 0), (0x6071, 0)} & set(found)


@pytest.mark.parametrize(
    ("kind", "value"),
    [("i16", -2), ("f64", -1e-300), ("bool", True)],
)
def test_a_backup_holds_every_basic_type_and_any_name(tmp_path: Path, kind: str, value: float) -> None:
    """A profile may use any text as the name of an object, so special characters must survive writing and reading."""
    names = ('5" drive', "back\\slash", "two\nlines", "tab\t", "'''", "\x7f\x00", "µ")
    stored = [
        StoredObject(index=0x2000, subindex=n, type=kind, value=value, name=name)  # type: ignore[arg-type]
        for n, name in enumerate(names)
    ]
    backup = Backup(node_id=1, vendor_id=0xFB, product_code=1, object=stored)
    file = tmp_path / "drive.toml"
    file.write_text(backup.text(), encoding="utf-8")
    assert load_backup(file) == backup
    assert [item.raw for item in load_backup(file).object] == [item.raw for item in stored]
    assert "vendor_id = 0x000000FB\n" in backup.text()


def test_diff_without_a_file_shows_what_a_bring_up_would_change(drive: Simulated) -> None:
    text = run(drive, "diff")
    assert "0x6072:0 max torque: drive 0xbb7, required 0x3e8" in text
    assert "positive torque limit (0x60E0) is 400 per mille of the rated torque: the drive delivers at most" in text
    configure(drive)
    assert drive.values[0x60B2, 0] == 0
    assert "0 differ" in run(drive, "diff")


def test_diff_lists_nothing_that_the_startup_accepts_or_a_shutdown_leaves(drive: Simulated) -> None:
    """The reaction 2 may stay, because the motor then has no torque. A shutdown sets the heartbeat consumer to 0."""
    configure(drive)
    drive.values[0x605A, 0] = 2
    drive.values[0x1016, 1] = 0
    assert "0 differ" in run(drive, "diff")
    drive.values[0x605A, 0] = 5
    assert "0x605A:0 quick stop reaction: drive 0x5, required 0x0\n" in run(drive, "diff")


def test_diff_looks_at_the_consumer_entry_and_the_rpdos_that_the_startup_uses(drive: Simulated) -> None:
    """The first entry of 0x1016 belongs to another node, and the fifth RPDO is on."""
    drive.values[0x1016, 1], drive.values[0x1016, 2] = 0x0503E8, 0x7F0400
    drive.node.rpdos.append(Rpdo(drive.dictionary, 4, PdoDefault(0x300), lambda: None))
    text = run(drive, "diff")
    assert "0x1016:2 heartbeat consumer: drive 0x7f0400, required 0x7f0064" in text
    assert "0x1016:1" not in text
    assert "0x1404:1 RPDO5 COB-ID: drive 0x301, required 0x80000301" in text


def test_diff_names_what_cannot_be_read_and_compares_the_rest(drive: Simulated) -> None:
    entries = drive.dictionary.entries
    entries[0x6072, 0] = dataclasses.replace(entries[0x6072, 0], access=Access.WO)
    text = run(drive, "diff")
    assert "0x6072:0 max torque cannot be read and was not compared" in text
    assert "0x60B2:0 torque offset: drive 0x78, required 0x0" in text


def test_diff_as_json_is_one_object(drive: Simulated) -> None:
    result = json.loads(run(drive, "diff", "--json"))
    assert result["schema"] == 1
    assert {"index": 0x6072, "subindex": 0, "name": "max torque", "wanted": 1000, "found": 2999} in result[
        "differences"
    ]


@pytest.mark.parametrize("option", [[], ["--json"]])
def test_diff_exits_1_if_objects_differ(drive: Simulated, option: list[str]) -> None:
    line = ["drive", "diff", "--node", "1", "--interface", "virtual", "--channel", drive.channel, *option]
    with pytest.raises(SystemExit) as ended:
        main(line)
    assert ended.value.code == 1
    configure(drive)
    with pytest.raises(SystemExit) as ended:
        main(line)
    assert ended.value.code == 0


def test_nothing_is_written_by_dump_and_diff(drive: Simulated) -> None:
    writable = [key for key, entry in drive.dictionary.entries.items() if entry.access is Access.RW]
    before = {key: drive.values[key] for key in writable}
    run(drive, "dump")
    run(drive, "diff")
    assert {key: drive.values[key] for key in writable} == before


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("vendor_id = 0x00000F0F", "vendor_id = 0x000000FB", "vendor is 0x00000F0F, the backup is of 0x000000FB"),
        # the PDOs would get the other node's identifiers, and both drives would follow the same command
        ("\nnode_id = 1\n", "\nnode_id = 2\n", "node 1: the backup is of node 2 .* identifiers"),
        ("value = 0xBB7", "value = 0x1BB70", "0x6072:0 max torque: value 113520 does not fit u16"),
    ],
)
def test_restore_of_another_backup_is_refused(
    drive: Simulated, tmp_path: Path, old: str, new: str, message: str
) -> None:
    file = tmp_path / "drive.toml"
    run(drive, "dump", "--out", str(file))
    text = file.read_text(encoding="utf-8")
    assert text.count(old) == 1
    file.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(TsaError, match=message):
        run(drive, "restore", str(file))
    assert drive.values[0x6072, 0] == 2999


def test_restore_to_an_enabled_drive_is_refused(drive: Simulated, tmp_path: Path) -> None:
    file = tmp_path / "drive.toml"
    run(drive, "dump", "--out", str(file))
    drive.node.drives[0].machine.state = PowerState.OPERATION_ENABLED
    with pytest.raises(TsaError, match="the drive is enabled"):
        run(drive, "restore", str(file))
    assert drive.values[0x6072, 0] == 2999


def test_no_drive_named_is_a_usage_error() -> None:
    result = CliRunner().invoke(command, ["dump"])
    assert "no drive selected" in str(result.exception)
