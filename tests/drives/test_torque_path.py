"""Startup of drives in which another tool left an offset, a limit or a ramp of the torque."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.drives.rig import Foreign, refused
from tsa_ctrl.bus.drive.profile import DriveProfile
from tsa_ctrl.bus.live.read_back import held_by
from tsa_ctrl.plant.dictionary import Access, Entry, Type
from tsa_ctrl.plant.pdo import PdoDefault, Rpdo


def notes(foreign: Foreign, profile: DriveProfile | None = None, **drive: float) -> list[str]:
    report = foreign.start(profile, **drive) if profile else foreign.start(**drive)
    return [note for node in report.nodes for note in node.notes]


@pytest.mark.parametrize("slot", [1, 2])
def test_offsets_of_another_tool_are_set_to_zero(tmp_path: Path, slot: int) -> None:
    left = {0x60B0: 4000, 0x60B1: -77, 0x60B2: -120}
    objects = ", ".join(f"'0x{index:04X}:0' = {value}" for index, value in left.items())
    foreign = Foreign(tmp_path, f"slot = {slot}", f"objects = {{{objects}}}")
    report = foreign.start(slot=slot)
    rows = {row.entry.index: row for node in report.nodes for row in node.rows}
    for index, value in left.items():
        own = index + 0x800 * (slot - 1)
        assert foreign.node.values[own, 0] == 0
        assert (rows[own].before, rows[own].after) == (value, 0)


def test_an_offset_that_the_drive_keeps_is_refused(tmp_path: Path) -> None:
    """The drive confirms the write but keeps its old value."""
    foreign = Foreign(tmp_path, "objects = {'0x60B2:0' = 120}")
    write = foreign.node.dictionary.write

    def keep(key: tuple[int, int], data: bytes) -> None:
        if key != (0x60B2, 0):
            write(key, data)

    foreign.node.dictionary.write = keep  # type: ignore[method-assign]
    with refused("0x60B2:0 torque offset: wrote 0x0, read back 0x78", "only 0 is allowed"):
        foreign.start()


LIMITS = {
    0x60E0: "positive torque limit (0x60E0) is 250 per mille of the rated torque: the drive delivers at most",
    0x60E1: "negative torque limit (0x60E1) is 250 per mille of the rated torque: the drive delivers at most",
    0x6073: "max current (0x6073) is 250 per mille of the rated current: the drive delivers at most",
    0x6087: "torque slope (0x6087) is 250 per mille of the rated torque per s: 4 s from zero to max_torque",
}


@pytest.mark.parametrize("index", LIMITS)
def test_a_limit_or_ramp_of_the_drive_is_reported_by_its_name(tmp_path: Path, index: int) -> None:
    (note,) = notes(Foreign(tmp_path, f"objects = {{'0x{index:04X}:0' = 250}}"))
    assert note.startswith(LIMITS[index])


def test_a_limit_above_the_clamp_is_not_reported(tmp_path: Path) -> None:
    assert notes(Foreign(tmp_path, "objects = {'0x60E0:0' = 250}"), max_torque=0.25) == []


def test_a_limit_that_cannot_be_read_is_reported(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path)
    foreign.node.dictionary.add(Entry(0x60E0, 0, Type.U16, Access.WO))
    (note,) = notes(foreign)
    assert note == "0x60E0:0 positive torque limit cannot be read, so its effect on the torque is unknown"


def test_what_adds_to_the_torque_or_scales_it_is_read_back_while_the_loop_runs(tmp_path: Path) -> None:
    held = {each.entry.index for each in held_by(Foreign(tmp_path).start())}
    assert held >= {0x607E, 0x6075, 0x6076, 0x60B2}


@pytest.mark.parametrize("on", [True, False])
def test_an_rpdo_of_another_tool_beyond_the_fourth_is_switched_off(tmp_path: Path, on: bool) -> None:
    foreign = Foreign(tmp_path)
    cob_id = 0x300 if on else 0x80000300
    node = foreign.node
    node.rpdos.append(Rpdo(node.dictionary, 4, PdoDefault(cob_id, 255, ((0x60B2, 0),)), node._changed))
    report = foreign.start()
    assert node.values[0x1404, 1] == 0x80000301
    assert (0x1404 in {row.entry.index for found in report.nodes for row in found.rows}) is on


def test_an_rpdo_that_is_on_is_switched_off_whatever_the_profile_counts(tmp_path: Path) -> None:
    """The profile counts one RPDO. The drive lacks the second one, and its third one is on."""
    foreign = Foreign(tmp_path, "absent = [0x1401]", "objects = {'0x1402:1' = 0x401}")
    foreign.start(DriveProfile(rpdo_count=1))
    assert foreign.node.values[0x1402, 1] == 0x80000401


@pytest.mark.parametrize("count", [1, 4])
def test_an_rpdo_that_stays_on_is_a_rejected_start(tmp_path: Path, count: int) -> None:
    foreign = Foreign(tmp_path, "read_only = ['0x1401:1']", "objects = {'0x1401:1' = 0x301}")
    with refused("0x1401:1", "it holds 0x301; disable this RPDO and store that with the maker's tool"):
        foreign.start(DriveProfile(rpdo_count=count))
