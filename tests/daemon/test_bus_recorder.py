"""Test the bus recorder, a separate process that records the frames of all programs in common file formats."""

from __future__ import annotations

import os
from pathlib import Path

import can
import pytest

from tsa_ctrl.bus.settings import BusSettings
from tsa_ctrl.bus.wire.link import open_bus
from tsa_ctrl.daemon.bus_recorder import recorded
from tsa_ctrl.errors import UsageError

MULTICAST = BusSettings(interface="udp_multicast", channel=f"239.74.{os.getpid() % 250}.77")
DATAGRAM = BusSettings(interface="datagram", channel=f"recorder-{os.getpid()}")
FRAMES = [(0x181 + n, bytes(range(n + 1))) for n in range(8)]


@pytest.mark.parametrize(
    ("settings", "suffix"), [(MULTICAST, ".log"), (MULTICAST, ".asc"), (MULTICAST, ".blf"), (DATAGRAM, ".log")]
)
def test_frames_of_all_programs_are_recorded_in_order(tmp_path: Path, settings: BusSettings, suffix: str) -> None:
    path = tmp_path / f"run{suffix}"
    bus = open_bus(settings)
    said: list[str] = []
    with recorded([settings], path, said.append):
        for frame in FRAMES:
            assert bus.send(*frame)
    bus.close()
    found = [(message.arbitration_id, bytes(message.data)) for message in can.LogReader(path)]
    assert found == FRAMES
    assert not said
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize(
    ("name", "interface", "reason"),
    [
        ("run.txt", "udp_multicast", "the suffix is not one of"),
        ("no/run.log", "udp_multicast", "no such folder"),
        ("old.log", "udp_multicast", "exists already"),
        ("run.log", "slcan", "can be opened by one program only"),
    ],
)
def test_what_cannot_be_recorded_is_one_line(tmp_path: Path, name: str, interface: str, reason: str) -> None:
    (tmp_path / "old.log").write_text("")
    with (
        pytest.raises(UsageError, match=reason),
        recorded([BusSettings(interface=interface)], tmp_path / name, lambda line: None),
    ):
        pass
    assert (tmp_path / "old.log").read_text() == ""


def test_without_a_path_nothing_is_started() -> None:
    with recorded([BusSettings(interface="slcan")], None, lambda line: None):
        pass
