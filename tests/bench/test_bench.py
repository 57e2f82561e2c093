"""Test `tsa bench`: the rate calculated from measured times, and the whole command on a bus in this process."""

from __future__ import annotations

import importlib
import json
import math
import shutil
import time
from dataclasses import replace
from pathlib import Path

import can
import msgspec
import pytest
from click.testing import CliRunner, Result
from hypothesis import given
from hypothesis import strategies as st

from tests.bus.nodes import axis_nodes
from tests.conftest import ROOT
from tests.drives.rig import STILL, served
from tsa_ctrl.bench.responder import standing_in
from tsa_ctrl.bench.run import Measured, Times, bounds, holds, rounded_down
from tsa_ctrl.bus.drive.profile import DriveProfile
from tsa_ctrl.bus.live.rig import Rig, check_startup
from tsa_ctrl.bus.settings import BusSettings
from tsa_ctrl.bus.wire.link import open_bus
from tsa_ctrl.cli import cli, main
from tsa_ctrl.config import HIGHEST_RATE, LOWEST_RATE

QUICK = Times(1e-5, 2e-5, 3e-5, 9e-5)
MEASURED = Measured(
    rate=1000.0,
    cycles=1000,
    lost=0,
    late=0,
    enabled=1000,
    lateness=QUICK,
    command=Times(1e-4, 2e-4, 3e-4, 1e-3),
    busy=Times(2e-4, 3e-4, 5e-4, 2e-3),
)


def test_the_slowest_thing_bounds_the_rate() -> None:
    """With a margin of 30 %, a cycle of 0.5 ms limits the rate to 1400 Hz.

    Answers after 0.3 ms, which must come within 60 % of the period, give the same limit.
    """
    found = {bound.name: bound.rate for bound in bounds(MEASURED, 0.3, 0.6, 1488.0, 0.9)}
    assert found == pytest.approx(
        {"cycle": 1400.0, "answers": 1400.0, "bit rate": 1488.0, "configuration": HIGHEST_RATE}
    )


def test_bounds_come_with_the_lowest_first() -> None:
    """The first bound is the lowest one, of any kind."""
    assert bounds(MEASURED, 0.3, 0.6, 100.0, 0.9)[0].name == "bit rate"
    assert bounds(replace(MEASURED, busy=Times(0.1, 0.1, 0.1, 0.1)), 0.3, 0.6, 100.0, 0.9)[0].name == "cycle"


def test_nothing_measured_allows_no_rate() -> None:
    """Times that are not a number give a rate of 0."""
    nothing = Times(math.nan, math.nan, math.nan, math.nan)
    lowest = bounds(replace(MEASURED, busy=nothing, command=nothing), 0.3, 0.6, 1488.0, 0.9)[0]
    assert rounded_down(lowest.rate) == 0.0


@given(st.floats(LOWEST_RATE, HIGHEST_RATE))
def test_rounding_is_down_and_by_less_than_a_tenth(rate: float) -> None:
    """A rate below the lowest configurable one, or not a number, becomes 0."""
    assert 0.9 * rate < rounded_down(rate) <= rate * (1.0 + 1e-9)
    assert [rounded_down(low) for low in (9.999, 0.0, -1.0, math.nan)] == [0.0] * 4


@pytest.mark.parametrize(
    ("change", "good"),
    [({}, True), ({"lost": 1}, False), ({"late": 1}, False), ({"busy": Times(2e-4, 3e-4, 9e-4, 2e-3)}, False)],
)
def test_a_rate_holds_when_nothing_is_lost_or_late(change: dict[str, object], good: bool) -> None:
    """A rate passes without lost or late answers and if half of the margin stays free."""
    assert holds(replace(MEASURED, **change), 0.3) is good  # type: ignore[arg-type]


VIRTUAL = ('interface = "socketcan"', 'interface = "virtual"')
SLOW = ("rate = 1000.0", "rate = 50.0"), ("# rpdo_timeout = 0.02 ", "rpdo_timeout = 1.0 ")


def edited(folder: Path, *edits: tuple[str, str]) -> str:
    """Copy the example with these changes, and return the path of its controller.toml."""
    shutil.copytree(ROOT / "config", folder, dirs_exist_ok=True)
    path = folder / "controller.toml"
    text = path.read_text(encoding="utf-8")
    for before, after in edits:
        assert before in text
        text = text.replace(before, after)
    path.write_text(text, encoding="utf-8")
    return str(path)


def bench(folder: Path, *edits: tuple[str, str]) -> Result:
    path = edited(folder, ("# allow_without = false", "allow_without = true"), *edits)
    return CliRunner().invoke(cli, ["bench", path, "--seconds", "0.3", "--json"])


def test_a_rate_is_named_on_a_bus_in_this_process(tmp_path: Path) -> None:
    """On python-can's virtual bus, without permissions and nodes, the rate does not exceed any bound.

    This also holds on a busy machine.
    """
    run = bench(tmp_path, VIRTUAL, *SLOW)
    assert run.exit_code == 0, run.output
    found = json.loads(run.stdout)
    assert (found["schema"], found["nodes"]) == (1, "simulated")
    assert 0.0 <= found["rate"]["highest"] <= min(bound["rate"] for bound in found["bounds"])
    assert found["rate"]["fits"] is (found["rate"]["highest"] >= 50.0)
    busy = found["measured"][0]["busy"]
    assert 0.0 < busy["p50"] <= busy["p99"] <= busy["p999"] <= busy["worst"]


@pytest.mark.parametrize(
    ("drive", "profile"),
    [
        ({}, {}),
        ({"pdo": "lean"}, {}),
        ({"slot": 2}, {}),
        ({"pdo_node_id": 9}, {}),
        ({}, {"absent": ["error code"]}),
        ({"pdo": "lean"}, {"absent": ["error code"], "supervision": "guarding"}),
    ],
)
def test_simulated_nodes_send_the_frames_that_the_loop_expects(
    drive: dict[str, object], profile: dict[str, object]
) -> None:
    """Each node answers each SYNC in time, with the mode, and with alternating answers to node guarding."""
    axes, profiles = [axis_nodes(**drive)], [msgspec.convert(profile, DriveProfile)]
    settings = BusSettings(interface="virtual", channel="stand-in")
    bus = open_bus(settings)
    with standing_in(settings, axes, profiles):
        rig = Rig(bus, settings, axes, profiles)
        rig.start()
        check_startup(rig, 0.01)
    bus.close()
    image = rig.axes[0].image
    assert image.mode == 10
    assert [node.untoggled for node in image.nodes] == [0, 0, 0]


def test_a_bus_that_is_not_there_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A missing bus gives exit code 1 and one line on stderr."""
    with pytest.raises(SystemExit) as left:
        main(["bench", edited(tmp_path, ('channel = "vcan0"', 'channel = "can17"'))])
    said = capsys.readouterr()
    assert (left.value.code, said.out, said.err.count("\n")) == (1, "", 1)


@pytest.mark.parametrize(
    ("can_id", "data", "words"),
    [
        (0x701, b"\x05", "drive node 17 (active nodes: 1)"),
        (0x080, b"", "another master"),
        (0x605, bytes(8), "another master"),
    ],
)
def test_beside_others_nothing_stands_in_and_nothing_is_commanded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], can_id: int, data: bytes, words: str
) -> None:
    """With foreign nodes or another master on the bus, the command ends with a one-line error.

    It sends nothing next to another master, and otherwise only the SDO requests that look for the configured drive.
    """
    channel = tmp_path.name
    path = edited(tmp_path, VIRTUAL, ('"vcan0"', f'"{channel}"'), ("node_id = 1 ", "node_id = 17 "))
    heard = []
    with can.Bus(interface="virtual", channel=channel) as other:
        task = other.send_periodic(can.Message(arbitration_id=can_id, data=data, is_extended_id=False), 0.01)
        with pytest.raises(SystemExit) as left:
            main(["bench", path])
        task.stop()
        while (message := other.recv(0.0)) is not None:
            heard.append(message.arbitration_id)
    said = capsys.readouterr()
    assert (left.value.code, said.out, said.err.count("\n")) == (1, "", 1)
    assert words in said.err
    assert set(heard) <= ({0x611} if "drive node" in words else set())


@pytest.mark.hil
def test_real_nodes_are_measured_and_never_enabled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The nodes answer in real time, so nothing else may use the processors.

    The preparation of the loop takes longer than the heartbeat time of the drives, as on a slow machine.
    """
    monkeypatch.setattr(importlib.import_module("tsa_ctrl.bench.run"), "freeze_garbage", lambda: time.sleep(0.3))
    with served(tmp_path, "[[axis]]\nname = 'joint'\nmotion.kind = 'still'\n") as channel:
        run = bench(tmp_path, VIRTUAL, *SLOW, ('"vcan0"', f'"{channel}"'))
    assert run.exit_code == 0, run.output
    found = json.loads(run.stdout)
    assert (found["nodes"], len(found["measured"]), found["measured"][0]["enabled"]) == ("real", 1, 0)


def test_a_drive_that_is_not_the_configured_one_is_only_read(tmp_path: Path) -> None:
    """A drive with another serial number gets no SYNC, no RPDO, no NMT command and no SDO write."""
    drive = "[[axis]]\nname = 'joint'\ndrive.node_id = 1\ndrive.serial_number = 5\n"
    heard: list[can.Message] = []
    edits = VIRTUAL, ("node_id = 1 ", "serial_number = 6\nnode_id = 1 ")
    with (
        served(tmp_path, drive + STILL) as channel,
        can.Bus(interface="virtual", channel=channel) as other,
        can.Notifier(other, [heard.append]),
    ):
        run = bench(tmp_path, *edits, ('"vcan0"', f'"{channel}"'))
    assert "serial number is 0x00000005 but must be 0x00000006" in str(run.exception)
    sent = [message for message in heard if message.arbitration_id in (0x000, 0x080, 0x201, 0x601, 0x77F)]
    assert {message.arbitration_id for message in sent} == {0x601}
    assert {message.data[0] >> 5 for message in sent} <= {2, 3}  # SDO uploads


def test_a_drive_that_sends_sync_with_permission_is_no_other_master(tmp_path: Path) -> None:
    """With produces_sync in its profile, the bench and doctor reach the drive itself."""
    drive = "[[axis]]\nname = 'joint'\ndrive.node_id = 1\ndrive.serial_number = 5\ndrive.sync_producer = true\n"
    (tmp_path / "mine.toml").write_text("produces_sync = true\n", encoding="utf-8")
    edits = ('interface = "socketcan"', 'interface = "virtual"'), (
        "node_id = 1 ", 'serial_number = 6\nprofile = "mine.toml"\nnode_id = 1 '
    )  # fmt: skip
    with served(tmp_path, drive + STILL) as channel:
        run = bench(tmp_path, *edits, ('"vcan0"', f'"{channel}"'))
        numbers = CliRunner().invoke(cli, ["doctor", str(tmp_path / "controller.toml"), "--serial-numbers"])
    assert "serial number is 0x00000005 but must be 0x00000006" in str(run.exception)
    assert "serial_number = 5" in numbers.output, numbers.exception


def test_an_unconfirmed_shutdown_is_printed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A drive that does not confirm that it is off gives its line on stderr."""
    monkeypatch.setattr(importlib.import_module("tsa_ctrl.bench.run"), "shut_down", lambda *_: ["cut its power"])
    edits = (('interface = "socketcan"', 'interface = "virtual"'), ("rate = 1000.0", "rate = 50.0"))
    with served(tmp_path, "[[axis]]\nname = 'joint'\nmotion.kind = 'still'\n") as channel:
        run = bench(tmp_path, *edits, ("# rpdo_timeout = 0.02 ", "rpdo_timeout = 1.0 "), ('"vcan0"', f'"{channel}"'))
    assert "cut its power\n" in run.stderr, run.exception
