"""Test dump, restore and diff of a drive's objects, and the command that runs them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

from tests.bus.local_nodes import U8, U32, Bench, Dictionary, bench
from tests.bus.nodes import axis_nodes
from tsa_ctrl.bus.drive.backup import Backup, StoredObject, load_backup, restore_plan
from tsa_ctrl.bus.drive.bring_up import bring_up
from tsa_ctrl.bus.drive.profile import DriveProfile
from tsa_ctrl.bus.settings import BusSettings
from tsa_ctrl.cli import main
from tsa_ctrl.cli.drive import command
from tsa_ctrl.errors import TsaError


@pytest.fixture
def nodes() -> Iterator[Bench]:
    with bench() as made:
        yield made


def run(nodes: Bench, *arguments: str) -> str:
    """Run the command on the bus of these nodes and return its stdout. Exceptions are raised again."""
    channel = nodes.bus.name.partition(":")[2]
    options = ["--node", "1", "--interface", "virtual", "--channel", channel]
    result = CliRunner().invoke(command, [*arguments, *options])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.stdout


def held(nodes: Bench) -> dict[tuple[int, int], int]:
    """Return the drive's values of all objects that a bring-up writes."""
    dictionary = nodes.nodes[1].object_dictionary
    keys = [(i, 0) for i in (0x1017, 0x6007, 0x6060, 0x6072, 0x6080, 0x60A9)] + [(0x1016, 1), (0x1400, 1), (0x1600, 0)]
    return {key: nodes.get(1, *key) for key in keys if key[0] in dictionary}


def configure(nodes: Bench) -> None:
    bring_up(nodes.bus, BusSettings(interface="virtual"), [axis_nodes()], [DriveProfile()], 0.001)


def test_dump_restores_the_drive_as_it_was(nodes: Bench, tmp_path: Path) -> None:
    before = held(nodes)
    file = tmp_path / "drive.toml"
    run(nodes, "dump", "--out", str(file))
    configure(nodes)
    assert held(nodes) != before
    run(nodes, "restore", str(file))
    assert held(nodes) == before
    assert "0 differ" in run(nodes, "diff", str(file))


def test_dump_holds_what_the_drive_has_and_no_command(nodes: Bench, tmp_path: Path) -> None:
    file = tmp_path / "drive.toml"
    run(nodes, "dump", "--out", str(file))
    backup = load_backup(file)
    found = {(item.index, item.subindex): item.value for item in backup.object}
    assert (backup.vendor_id, backup.product_code, backup.serial_number) == (0x0F0F, 0x0402, 7)
    assert (found[0x6072, 0], found[0x60C2, 2], found[0x1400, 1]) == (3000, -3, 0x201)
    assert (found[0x60B2, 0], found[0x60E0, 0]) == (120, 400)  # offset and limit of the torque
    assert not {(0x6040, 0), (0x6071, 0), (0x1402, 1)} & set(found)


@pytest.mark.parametrize(
    ("kind", "value"),
    [("i16", -2), ("f32", 0.5), ("f64", -1e-300), ("u64", (1 << 64) - 1), ("i24", -5), ("bool", True)],
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


def test_diff_without_a_file_shows_what_a_bring_up_would_change(nodes: Bench) -> None:
    text = run(nodes, "diff")
    assert "0x6072:0 max torque: drive 0xbb8, required 0x3e8" in text
    assert "positive torque limit (0x60E0) is 400 per mille of the rated torque: the drive delivers at most" in text
    configure(nodes)
    assert nodes.get(1, 0x60B2, 0) == 0
    assert "0 differ" in run(nodes, "diff")


def test_diff_lists_nothing_that_the_startup_accepts_or_a_shutdown_leaves(nodes: Bench) -> None:
    """The reaction 2 may stay, because the motor then has no torque. A shutdown sets the heartbeat consumer to 0."""
    configure(nodes)
    held = nodes.nodes[1].data_store
    held[0x605A][0] = b"\x02\x00"
    held[0x1016][1] = bytes(4)
    assert "0 differ" in run(nodes, "diff")
    held[0x605A][0] = b"\x05\x00"
    assert "0x605A:0 quick stop reaction: drive 0x5, required 0x0\n" in run(nodes, "diff")


def test_diff_looks_at_the_consumer_entry_and_the_rpdos_that_the_startup_uses() -> None:
    """The first entry of 0x1016 belongs to another node, and the fifth RPDO is on."""
    consumers: Dictionary = {(0x1016, 0): (U8, 2), (0x1016, 1): (U32, 0x0503E8), (0x1016, 2): (U32, 0x7F0400)}
    rpdo: Dictionary = {(0x1404, 1): (U32, 0x301), (0x1404, 2): (U8, 255), (0x1604, 0): (U8, 0)}
    with bench(drive=consumers | rpdo) as nodes:
        text = run(nodes, "diff")
        assert "0x1016:2 heartbeat consumer: drive 0x7f0400, required 0x7f0064" in text
        assert "0x1016:1" not in text
        assert "0x1404:1 RPDO5 COB-ID: drive 0x301, required 0x80000301" in text
        configure(nodes)
        assert "0 differ" in run(nodes, "diff")


def test_diff_names_what_cannot_be_read_and_compares_the_rest(nodes: Bench) -> None:
    nodes.nodes[1].object_dictionary[0x6072].access_type = "wo"
    text = run(nodes, "diff")
    assert "0x6072:0 max torque cannot be read and was not compared" in text
    assert "0x60B2:0 torque offset: drive 0x78, required 0x0" in text


def test_diff_as_json_is_one_object(nodes: Bench) -> None:
    result = json.loads(run(nodes, "diff", "--json"))
    assert result["schema"] == 1
    assert {"index": 0x6072, "subindex": 0, "name": "max torque", "wanted": 1000, "found": 3000} in result[
        "differences"
    ]


@pytest.mark.parametrize("option", [[], ["--json"]])
def test_diff_exits_1_if_objects_differ(nodes: Bench, option: list[str]) -> None:
    channel = nodes.bus.name.partition(":")[2]
    line = ["drive", "diff", "--node", "1", "--interface", "virtual", "--channel", channel, *option]
    with pytest.raises(SystemExit) as ended:
        main(line)
    assert ended.value.code == 1
    configure(nodes)
    with pytest.raises(SystemExit) as ended:
        main(line)
    assert ended.value.code == 0


def test_nothing_is_written_by_dump_and_diff(nodes: Bench) -> None:
    run(nodes, "dump")
    run(nodes, "diff")
    assert (nodes.written, nodes.commands) == ([], [])


def test_restore_reads_back(nodes: Bench, tmp_path: Path) -> None:
    file = tmp_path / "drive.toml"
    run(nodes, "dump", "--out", str(file))
    configure(nodes)
    nodes.nodes[1].add_read_callback(lambda index, subindex, od: 900 if index == 0x6072 else None)
    with pytest.raises(TsaError, match="wrote 0xbb8, read back 0x384"):
        run(nodes, "restore", str(file))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("vendor_id = 0x00000F0F", "vendor_id = 0x000000FB", "vendor is 0x00000F0F, the backup is of 0x000000FB"),
        # the PDOs would get the other node's identifiers, and both drives would follow the same command
        ("\nnode_id = 1\n", "\nnode_id = 2\n", "node 1: the backup is of node 2 .* identifiers"),
        ("value = 0xBB8", "value = 0x1BB80", "0x6072:0 max torque: value 113536 does not fit u16"),
    ],
)
def test_restore_of_another_backup_is_refused(nodes: Bench, tmp_path: Path, old: str, new: str, message: str) -> None:
    file = tmp_path / "drive.toml"
    run(nodes, "dump", "--out", str(file))
    text = file.read_text(encoding="utf-8")
    assert text.count(old) == 1
    file.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(TsaError, match=message):
        run(nodes, "restore", str(file))
    assert nodes.written == []


def test_restore_to_an_enabled_drive_is_refused(nodes: Bench, tmp_path: Path) -> None:
    file = tmp_path / "drive.toml"
    run(nodes, "dump", "--out", str(file))
    nodes.nodes[1].data_store.setdefault(0x6041, {})[0] = b"\x37\x16"
    with pytest.raises(TsaError, match="the drive is enabled"):
        run(nodes, "restore", str(file))
    assert nodes.written == []


def test_restore_maps_pdos_by_the_procedure() -> None:
    stored = [
        StoredObject(index=0x1A00, subindex=0, type="u8", value=1),
        StoredObject(index=0x1A00, subindex=1, type="u32", value=0x60410010),
        StoredObject(index=0x1A00, subindex=2, type="u32", value=0x60770010),
        StoredObject(index=0x1800, subindex=1, type="u32", value=0x181),
        StoredObject(index=0x1800, subindex=2, type="u8", value=1),
        StoredObject(index=0x6072, subindex=0, type="u16", value=500),
    ]
    assert [(*write.entry.key, write.value) for write in restore_plan(stored)] == [
        (0x1800, 1, 0x80000181),
        (0x1A00, 0, 0),
        (0x1A00, 1, 0x60410010),
        (0x1A00, 0, 1),
        (0x1800, 2, 1),
        (0x1800, 1, 0x181),
        (0x6072, 0, 500),
    ]


def test_no_drive_named_is_a_usage_error() -> None:
    result = CliRunner().invoke(command, ["dump"])
    assert "no drive selected" in str(result.exception)
