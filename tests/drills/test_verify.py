"""Test `tsa verify-safety`: its requirements, and its result for a good and a bad drive."""

from __future__ import annotations

import dataclasses
import json
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import msgspec
import pytest
from click.testing import CliRunner

from tests.virtual.files import controller, merged, plant, write
from tsa_ctrl.cli import cli
from tsa_ctrl.cli.verify_safety import _show
from tsa_ctrl.config import Configuration, load_configuration
from tsa_ctrl.drills.listener import Pull, Timing, Watchdog
from tsa_ctrl.drills.loop import under_trial
from tsa_ctrl.drills.trials import (
    Outcome,
    Trial,
    Verification,
    leave_in_order,
    listening,
    run_trial,
    trial_torque,
    verify,
)
from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.system.process_supervisor import plant as plant_process

CONFIG = Path(__file__).resolve().parents[2] / "config"
# Time until the torque must be zero (s). A busy test machine may stall for the 50 ms that the default allows.
PATIENT = 1.5

# If the machine stalls for longer than the drive's time-out, the command reports the lost torque without a result.
TRIES = 3


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("controller.toml", "plant.toml", "actuator.toml"):
        shutil.copy(CONFIG / name, tmp_path)
    return tmp_path


def edit(folder: Path, name: str, *changes: tuple[str, str]) -> None:
    text = (folder / name).read_text(encoding="utf-8")
    for before, after in changes:
        assert before in text, before
        text = text.replace(before, after, 1)
    (folder / name).write_text(text, encoding="utf-8")


def test_torque_is_a_tenth_of_rated_unless_given(folder: Path) -> None:
    configuration = load_configuration(folder / "controller.toml")
    assert trial_torque(configuration, None) == pytest.approx(0.1)
    assert trial_torque(configuration, 0.3) == 0.3
    edit(folder, "controller.toml", ("# torque = 0.1  ", "torque = 0.2  "))
    assert trial_torque(load_configuration(folder / "controller.toml"), None) == 0.2


@pytest.mark.parametrize("torque", [0.01, 2.5])
def test_torque_that_cannot_be_told_from_none_or_is_above_the_limit_is_refused(folder: Path, torque: float) -> None:
    with pytest.raises(UsageError, match=r"allowed are 0\.06 N\*m .* to 2 N\*m"):
        trial_torque(load_configuration(folder / "controller.toml"), torque)


def test_the_trial_changes_set_point_compensation_log_and_socket_alone(folder: Path) -> None:
    before = load_configuration(folder / "controller.toml")
    after = under_trial(before, 0.1, "/x.sock")
    assert after.file.bus == before.file.bus
    assert after.file.safety == before.file.safety
    (axis,), (was,) = after.file.axes, before.file.axes
    assert (axis.drive, axis.encoder, axis.limits, axis.plausibility) == (
        was.drive, was.encoder, was.limits, was.plausibility,
    )  # fmt: skip
    assert (axis.setpoint.kind, axis.setpoint.offset) == ("constant", pytest.approx(0.125))
    assert axis.law.compensation == 0.0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["verify-safety"], "give --yes"),  # nobody can be asked
        (["verify-safety", "--yes", "--record", "file/x"], "file/x: no record can be kept there"),
        (["run", "--check"], "zero_torque_within 0.1 s is not above axis 'knee'"),
    ],
)
def test_what_is_lacking_is_one_line_before_anything_moves(
    folder: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], message: str
) -> None:
    monkeypatch.chdir(folder)
    (folder / "file").touch()
    if words[0] == "run":
        edit(folder, "controller.toml", ("# zero_torque_within = 0.25 ", "zero_torque_within = 0.1 "))
    done = CliRunner().invoke(cli, [*words, "controller.toml"])
    assert isinstance(done.exception, UsageError)
    assert message in str(done.exception)
    assert "\n" not in str(done.exception)


def test_a_limit_above_the_time_outs_is_accepted(folder: Path) -> None:
    edit(folder, "controller.toml", ("# zero_torque_within = 0.25 ", "zero_torque_within = 0.3 "))
    done = CliRunner().invoke(cli, ["run", "--check", str(folder / "controller.toml")])
    assert done.exit_code == 0, done.output


def test_the_result_of_a_trial_is_one_line_in_a_narrow_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    timing = Timing(torque_before=0.102, last_torque=0.09, zero_after=0.097, source="sdo")
    acted = Watchdog(acted="heartbeat", after=0.088, warning="")
    pull = Pull(stretch=None, sensor=None, gain=None, geared=1.25)
    ended: dict[str, Any] = {
        "axis": "ankle_left",
        "node": 1,
        "limit": 0.25,
        "watchdog": acted,
        "pull": pull,
        "samples": [],
    }
    late = Outcome(trial="hang", safe=False, timing=msgspec.structs.replace(timing, zero_after=None), **ended)
    outcomes = [Outcome(trial="withheld", safe=True, timing=timing, **ended), late]
    words = {"date": "", "version": "", "configuration": "", "sha256": "", "bus": ""}
    _show(Verification(**words, rate=100.0, limit=0.25, torque=0.1, outcomes=outcomes, nodes={}))
    facts = "0.102 N·m before, {} by SDO, allowed 250 ms; stopped by: heartbeat, 88 ms; motor pulls: not shown"
    assert capsys.readouterr().out.splitlines() == [
        f"heartbeat withheld, axis 'ankle_left': in time, {facts.format('zero after 97 ms')}",
        f"loop hung: SIGSTOP, axis 'ankle_left': NOT SAFE, {facts.format('never zero')}",
    ]


class Rig:
    """A plant on the vcan with time-outs for a busy machine, and the command."""

    def __init__(self, folder: Path, vcan: str) -> None:
        self.folder = folder
        edit(
            folder, "controller.toml",
            ('"vcan0"', f'"{vcan}"'), ("rate = 1000.0", "rate = 100.0"),
            ("# allow_without = false", "allow_without = true"),
            ("# [bus.supervision]", "[bus.supervision]"), ("# tolerated_misses = 2 ", "tolerated_misses = 30 "),
            ("# lost_share = 0.2 ", "lost_share = 1.0 "),
            ("# settle_cycles = 100 ", "settle_cycles = 20 "), ("# rpdo_timeout = 0.02 ", "rpdo_timeout = 0.3 "),
            ("# host_timeout = 0.1 ", "host_timeout = 0.6 "),
            ("# heartbeat_timeout = 0.2 ", "heartbeat_timeout = 0.9 "),
            ("# zero_torque_within = 0.25 ", f"zero_torque_within = {PATIENT} "),
        )  # fmt: skip
        edit(folder, "plant.toml", ('"vcan0"', f'"{vcan}"'), ('# load = "imposed" ', 'load = "held" '))
        self.plant = subprocess.Popen(["tsa", "plant", "plant.toml"], cwd=folder, stdout=subprocess.PIPE, text=True)
        assert self.plant.stdout is not None
        assert any("ready" in line for line in self.plant.stdout)

    def verify(self) -> tuple[dict[str, Any], int, str]:
        command = ["tsa", "verify-safety", "controller.toml", "--yes", "--json"]
        for _ in range(TRIES):
            done = subprocess.run(command, cwd=self.folder, capture_output=True, text=True)
            if "torque was lost before anything was done" not in done.stderr:
                break
        return (json.loads(done.stdout) if done.stdout else {}), done.returncode, done.stderr

    def end(self) -> None:
        self.plant.terminate()
        self.plant.communicate(timeout=30)


@pytest.fixture
def plants() -> Iterator[list[Rig]]:
    made: list[Rig] = []
    yield made
    for rig in made:
        rig.end()


@pytest.mark.vcan
@pytest.mark.hil
@pytest.mark.slow
def test_a_drive_that_stops_by_itself_is_in_time(folder: Path, vcan: str, plants: list[Rig]) -> None:
    """All three trials end within the limit, each by the expected watchdog. The record contains the torque samples."""
    plants.append(Rig(folder, vcan))
    found, code, error = plants[0].verify()
    assert code == 0, error
    assert [trial["trial"] for trial in found["trials"]] == ["withheld", "hang", "kill"]
    times = {trial["trial"]: trial["zero_after"] for trial in found["trials"]}
    assert all(0.0 < time <= found["limit"] for time in times.values())
    assert times["withheld"] > 0.4  # only the heartbeat time-out acts
    assert times["kill"] > 0.2  # the RPDO time-out acts
    acted = {trial["trial"]: trial["watchdog"] for trial in found["trials"]}
    assert acted == {"withheld": "heartbeat", "hang": "rpdo", "kill": "rpdo"}
    assert all(trial["pull"]["shown"].startswith("right") for trial in found["trials"])
    record = json.loads(Path(folder / found["record"]).read_text(encoding="utf-8"))
    assert record["safe"] is True
    assert len(record["trials"][0]["samples"]) > 10


def two_drives(folder: Path, vcan: str, **simulated: dict[str, Any]) -> Configuration:
    """Write files of two axes with identical drives and no sensors, except for the given changes of each drive."""
    times = {"rpdo_timeout": 0.3, "host_timeout": 0.6, "heartbeat_timeout": 0.9}
    none = {"present": False}
    ours = controller(
        drive=times,
        encoder=None,
        torque_sensor=None,
        file={
            "controller": {"rate": 100.0},
            "bus": {"channel": vcan, "supervision": {"tolerated_misses": 30, "lost_share": 1.0}},
            "realtime": {"allow_without": True},
            "safety": {"zero_torque_within": PATIENT},
        },
    )
    both = [
        {"name": name, "drive": {"node_id": number, "serial_number": number}}
        for number, name in enumerate(simulated, 1)
    ]
    (theirs,) = plant(motion={"kind": "still"}, encoder=none, torque_sensor=none)["axis"]
    machines = [
        merged(theirs, merged(each, {"drive": quirk})) for each, quirk in zip(both, simulated.values(), strict=True)
    ]
    ours["axis"] = [merged(ours["axis"][0], each) for each in both]
    return load_configuration(write(folder, ours, {"bus": {"channel": vcan}, "axis": machines})[0])


@pytest.mark.vcan
@pytest.mark.hil
@pytest.mark.slow
def test_watchdogs_that_do_not_act_are_found_and_the_torque_ends_all_the_same(tmp_path: Path, vcan: str) -> None:
    """Both drives accept all time-outs, but one ignores them and the other checks its RPDO timer only on SYNC.

    The first drive fails and is switched off. The second passes by its heartbeat time-out, with a warning.
    """
    configuration = two_drives(tmp_path, vcan, keeps={"watchdogs": False}, ends={"rpdo_timer_on_sync": True})
    left: list[str] = []
    with plant_process(tmp_path), listening(configuration) as listener:
        keeps, ends = run_trial(configuration, listener, Trial.KILL, trial_torque(configuration, None))
        leave_in_order(configuration, left.append)
        torques = listener.ask("torque").values()
    assert (keeps.safe, keeps.timing.zero_after) == (False, None)
    assert (ends.safe, ends.watchdog.acted) == (True, "heartbeat")
    assert "0x1400:5) is armed with 300 ms and did not act" in ends.watchdog.warning
    assert left == []
    assert max(abs(torque) for torque in torques) < 0.02


def test_a_bus_that_somebody_leads_is_left_alone(folder: Path) -> None:
    edit(folder, "controller.toml", ('interface = "socketcan"', 'interface = "virtual"'), ('"vcan0"', '"led"'))
    with can.Bus(interface="virtual", channel="led") as other:
        heard: list[can.Message] = []
        task = other.send_periodic(can.Message(arbitration_id=0x77F, data=b"\x05", is_extended_id=False), 0.01)
        try:
            with pytest.raises(BusError, match=r"another master is active \(heard 0x77F\); nothing was sent"):
                verify(load_configuration(folder / "controller.toml"), 0.1, lambda line: None)
            while (message := other.recv(0.0)) is not None:
                heard.append(message)
        finally:
            task.stop()
    assert heard == []


def test_a_limit_below_every_torque_of_the_trials_is_the_one_to_raise(folder: Path) -> None:
    configuration = load_configuration(folder / "controller.toml")
    axis = configuration.file.axes[0]
    weak = msgspec.structs.replace(axis, limits=msgspec.structs.replace(axis.limits, torque=0.05))
    file = msgspec.structs.replace(configuration.file, axes=(weak,))
    with pytest.raises(UsageError, match=r"allows 0\.05 N\*m, but the trials need at least 0\.06 N\*m .*raise limits"):
        trial_torque(dataclasses.replace(configuration, file=file), None)
