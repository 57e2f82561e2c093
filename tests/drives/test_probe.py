"""`tsa drive probe` sends only SDO reads and writes a profile.

Once the profile is completed, it brings the drive up.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner

from tests.conftest import ROOT
from tests.drives.rig import STILL, Foreign, refused, served
from tsa_ctrl.bus.canopen import objects
from tsa_ctrl.bus.drive.backup import dump, entries_of, load_backup
from tsa_ctrl.bus.drive.plan import drive_plan
from tsa_ctrl.bus.drive.probe import Probe, probe, profile_text
from tsa_ctrl.bus.drive.profile import DriveProfile, drive_scale, load_profile
from tsa_ctrl.bus.drive.session import Session
from tsa_ctrl.cli import cli
from tsa_ctrl.plant.dictionary import Access

KINDS = ("generic", "epos4", "elmo_gold", "technosoft_ipos", "kinco", "nanotec", "copley")
FINISH = {  # lines that a user completes in the profile: before, after
    "epos4": {
        "rated_torque = 1e-3 ": "rated_torque = 1e-6 ",
        "# [torque_clamp]": "[torque_clamp]",
        "# index": "index",
        "# subindex": "subindex",
        "# rated_index": "rated_index",
        "# rated_subindex": "rated_subindex",
    },
    "elmo_gold": {},
    "technosoft_ipos": {
        "torque = 1000.0 ": "torque = 16380.0 ",
        'velocity = "counts/s"': 'velocity = "1/65.536 counts/s"',
        'mode_shows = "written"': 'mode_shows = "enabled"',
        "# [torque_clamp]": '[torque_clamp]\nindex = 0x207F\ntype = "u16"\nrated = 16387\nzero = 32767',
    },
    "kinco": {
        'velocity = "counts/s"': 'velocity = "1/16.384 counts/s"',
        'mode_shows = "written"': 'mode_shows = "enabled"',
    },
    "copley": {'velocity = "counts/s"': 'velocity = "0.1 counts/s"'},
}


def looked_at(foreign: Foreign, slot: int = 1) -> Probe:
    with Session(foreign.wire.host, foreign.settings) as session:
        found = probe(session, "wire", 1, slot)
        assert session.touched == set()
    return found


def refuse(foreign: Foreign, index: int) -> None:
    """Let the drive refuse to send an object that it has."""
    entries = foreign.node.dictionary.entries
    entries.update({key: replace(entry, access=Access.WO) for key, entry in entries.items() if key[0] == index})


def written(folder: Path, foreign: Foreign, kind: str = "generic") -> DriveProfile:
    """Return the profile that the probe writes, completed and loaded."""
    text = profile_text(looked_at(foreign), "here")
    for before, after in FINISH.get(kind, {}).items():
        assert before in text, before
        text = text.replace(before, after)
    (folder / "drives").mkdir(exist_ok=True)
    (folder / "drives" / "mine.toml").write_text(text, encoding="utf-8")
    return load_profile("mine", folder)


@pytest.mark.parametrize("kind", KINDS)
def test_only_questions_are_sent_and_the_finished_profile_brings_the_drive_up(tmp_path: Path, kind: str) -> None:
    foreign = Foreign(tmp_path, f"kind = '{kind}'")
    before = dict(foreign.node.values)
    profile = written(tmp_path, foreign, kind)
    assert foreign.commands() == []
    assert {can_id for can_id, _ in foreign.sent()} == {0x601}
    changed = {key for key, value in foreign.node.values.items() if before[key] != value}
    assert changed <= {(0x6041, 0), (0x6061, 0), (0x6077, 0), (0x606C, 0), (0x6064, 0)}
    foreign.start(profile)
    foreign.enable(0.3)
    assert foreign.drive.command.torque == pytest.approx(0.3, rel=1e-3)
    assert foreign.stop() == []


def test_a_drive_says_most_of_what_a_profile_is_made_of(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path, "kind = 'epos4'", "serial_number = 1234")
    text = profile_text(looked_at(foreign), "can0")
    for line in (
        'name = "EPOS4"',
        'absent = ["max torque"]',
        "vendor_id = 0x000000FB",
        "product_codes = [0x69500000]",
        "# Modes 0x00000200: cyclic torque",
        "# Watchdogs: 4 entries of the heartbeat consumer 0x1016; try them with tsa verify-safety.",
        "rated_torque = 1e-3             # N*m per digit of 0x6076",
        "# index = 0x3001",
        "#   node_id = 1",
        "#   serial_number = 1234",
        "#   rated_torque = 1000  # N*m, if the unit above is right",
        "# RPDO1 now maps: 0x60400010",
    ):
        assert line in text.splitlines(), line


@pytest.mark.parametrize(
    ("quirk", "line"),
    [
        ("sync_producer = true", "produces_sync = true "),
        ("node_guarding = true", 'supervision = "guarding" '),
        ("answer_time = 0.3", "answer_timeout = 0.9 "),
        ("mode_shows = 'enabled'\ndrive.objects = { '0x6060:0' = 10 }", 'mode_shows = "enabled" '),
        ("absent = [0x6502, 0x6080]", 'absent = ["max motor speed", "supported modes"]'),
        ("absent = [0x1402, 0x1403, 0x1803]", "rpdo_count = 2"),
        ("objects = { '0x60B2:0' = 120 }", "# 0x60B2:0 torque offset is 120 per mille of the rated torque; it adds to"),
        ("modes = ['csp']", "# FINISH: no cyclic synchronous torque (bit 9)"),
        ("objects = { '0x1019:0' = 7 }", "# 0x1019:0 SYNC counter is 7; startup sets it to 0"),
    ],
)
def test_what_a_drive_does_otherwise_is_found(tmp_path: Path, quirk: str, line: str) -> None:
    foreign = Foreign(tmp_path, quirk)
    foreign.wait(0.05)
    text = profile_text(looked_at(foreign), "here")
    assert any(found.startswith(line) for found in text.splitlines()), text


@pytest.mark.parametrize("index", [0x6071, 0x1400, 0x1016])
def test_an_object_that_cannot_be_read_is_listed_and_all_others_are_read(tmp_path: Path, index: int) -> None:
    foreign = Foreign(tmp_path)
    refuse(foreign, index)
    text = profile_text(looked_at(foreign), "here")
    assert f"# FINISH: 0x{index:04X}:" in text
    assert "# FINISH: 0x6077" not in text
    assert "tpdo_count = 4" in text.splitlines()


@pytest.mark.parametrize("index", [0x6072, 0x1018])
def test_a_dump_lists_what_cannot_be_read(tmp_path: Path, index: int) -> None:
    foreign = Foreign(tmp_path)
    refuse(foreign, index)
    scale = drive_scale(foreign.axis.drive, foreign.profile, "knee")
    plan = drive_plan(foreign.axis, foreign.profile, scale, foreign.settings, 0.002)
    with Session(foreign.wire.host, foreign.settings) as session:
        backup = dump(session, 1, entries_of(plan))
    assert {name[:6] for name in backup.unreadable} == {f"0x{index:04X}"}
    assert 0x6080 in {item.index for item in backup.object}
    file = tmp_path / "drive.toml"
    file.write_text(backup.text(), encoding="utf-8")
    assert load_backup(file) == backup


def test_a_drive_whose_only_watchdog_is_life_guarding_is_guarded(tmp_path: Path) -> None:
    """The drive has neither a heartbeat consumer nor an RPDO event timer.

    The profile selects guarding only if the drive has the life time factor 0x100D.
    """
    found = looked_at(Foreign(tmp_path))
    for entry in (objects.HEARTBEAT_CONSUMERS, objects.RPDO_EVENT_TIMER):
        del found.values[entry]
    assert 'supervision = "guarding"' not in profile_text(found, "here")
    found.values[objects.LIFE_TIME_FACTOR] = 0
    assert 'supervision = "guarding"        # its only watchdog is life guarding 0x100D' in profile_text(found, "here")


def test_a_device_of_several_axes_names_its_slots(tmp_path: Path) -> None:
    axes = "".join(
        f"[[axis]]\nname = '{name}'\nmotion.kind = 'still'\ndrive.node_id = 1\ndrive.slot = {slot}\n"
        "encoder.present = false\ntorque_sensor.present = false\n"
        for slot, name in enumerate("ab", 1)
    )
    found = looked_at(Foreign(tmp_path, text=axes), slot=2)
    assert (found.slots, found.rpdos) == ([1, 2], 4)
    assert "# The device has axes in slots 1, 2; this is slot 2." in profile_text(found, "here")


def test_something_else_than_a_drive_is_refused(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path, "absent = [0x6071]")
    with refused("device type is 0x00020192, and 0x6071:0 target torque is missing", "correct --node"):
        looked_at(foreign)


def test_beside_a_master_nothing_is_asked(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path)
    foreign.wire.at(foreign.wire.now + 0.01, lambda now: foreign.wire.host.arrived(0x77F, b"\x05"))
    with refused("another master is active"):
        looked_at(foreign)
    assert foreign.sent() == []


@pytest.fixture
def channel(tmp_path: Path) -> Iterator[str]:
    """Run a plant with one drive, node 1, and yield its channel."""
    with served(tmp_path, "[[axis]]\nname = 'joint'\n" + STILL) as name:
        yield name


def checked(folder: Path, profile: str) -> str:
    """Return the output of `tsa run --check`, which accepts a controller with this profile."""
    for name in ("controller.toml", "actuator.toml"):
        shutil.copy(ROOT / "config" / name, folder)
    controller = folder / "controller.toml"
    text = controller.read_text(encoding="utf-8").replace('# profile = "generic"', f'profile = "{profile}"')
    controller.write_text(text, encoding="utf-8")
    done = CliRunner().invoke(cli, ["run", "--check", str(controller)])
    assert done.exit_code == 0, done.output
    return done.output


def test_from_the_bus_to_a_checked_configuration(tmp_path: Path, channel: str) -> None:
    (tmp_path / "drives").mkdir()
    profile = tmp_path / "drives" / "mine.toml"
    where = ["--interface", "virtual", "--channel", channel]
    done = CliRunner().invoke(cli, ["drive", "probe", *where, "--node", "1", "--out", str(profile)])
    assert done.exit_code == 0, done.output
    assert "lines to complete (marked FINISH); then run: tsa run --check" in done.output
    checked(tmp_path, "mine")


def test_what_a_profile_does_not_know_is_told_by_the_check(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "config" / "drives", tmp_path / "drives")
    lines = checked(tmp_path, "copley").splitlines()
    told = [line for line in lines if "not known in the profile of Copley Controls: " in line]
    assert len(told) == len(load_profile("copley", tmp_path).unknown) > 0


def test_nobody_there_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tsa_ctrl.bus.drive.probe.PATIENCE", 0.1)
    where = ["--interface", "virtual", "--channel", "probe-nobody"]
    done = CliRunner().invoke(cli, ["drive", "probe", *where, "--node", "7"])
    assert done.exception is not None
    assert "node 7 does not answer SDO requests" in str(done.exception)
    assert "\n" not in str(done.exception)
