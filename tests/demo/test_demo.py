"""Test the demo: its motion, its choice of the bus, its messages, and the whole system on a vcan."""

from __future__ import annotations

import errno
import json
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tsa_ctrl.bus.wire.link import Interface
from tsa_ctrl.cli import main
from tsa_ctrl.cli.demo import LOADS
from tsa_ctrl.config import load_configuration
from tsa_ctrl.demo import rig, run
from tsa_ctrl.demo.rig import PERIOD, VIRTUAL, BusChoice, choose, from_file, gait, play_for
from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.log.table import read_table
from tsa_ctrl.plant.process import check as check_plant


def test_the_gait_ends_where_it_begins_and_stays_within_the_tendons_domain() -> None:
    play = gait()
    assert play.t[-1] == pytest.approx(PERIOD)
    assert play.q_j[0] == pytest.approx(play.q_j[-1])
    assert play.tau_j_des[0] == pytest.approx(play.tau_j_des[-1])
    assert np.abs(play.tau_j_des).max() < rig.MOST_TORQUE


def test_a_file_is_played_from_time_zero(tmp_path: Path) -> None:
    path = tmp_path / "motion.csv"
    path.write_text("t,tau_j_des,q_j\n" + "".join(f"{5 + i},{0.1 * i},{0.2 * i}\n" for i in range(5)))
    play = from_file(path, 1.0)
    np.testing.assert_allclose(play.t, np.arange(5.0))
    np.testing.assert_allclose(play.q_j, 0.2 * np.arange(5))


BAD = [
    ("t,q_j\n0,0\n1,0\n2,0\n3,0\n", "column 'tau_j_des' is missing"),
    ("t,tau_j_des\n0,0\n1,nan\n2,0\n3,0\n", "column 'tau_j_des', row 2 (line 3): not a finite"),
    ("t,tau_j_des\n0,0\n1,0\n1,0\n3,0\n", "row 3 (line 4): time does not increase"),
    ("t,tau_j_des\n0,0\n1,0\n2,9\n3,0\n", "row 3 (line 4): 9 N*m exceeds"),
    ("t,tau_j_des\n0,0\n", "give at least 2"),
]


def test_a_bad_file_is_one_line_with_its_place(tmp_path: Path) -> None:
    path = tmp_path / "motion.csv"
    for text, words in BAD:
        path.write_text(text)
        with pytest.raises(UsageError, match=re.escape(words)):
            from_file(path, 1.0)


def test_without_a_vcan_the_bus_needs_no_rights(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rig, "can_interfaces", dict)
    monkeypatch.setattr(rig, "make_vcan", denied)
    assert choose().interface == "datagram"


def denied(*arguments: object) -> None:
    raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))


def there(monkeypatch: pytest.MonkeyPatch, *links: Interface) -> None:
    monkeypatch.setattr(rig, "can_interfaces", lambda: {link.name: link for link in links})


def test_a_vcan_that_is_down_is_brought_up_or_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """A vcan that is up comes before one that is named and down."""
    switched: list[tuple[str, bool]] = []
    there(monkeypatch, Interface(False, "vcan", name="vcan3"))
    monkeypatch.setattr(rig, "set_up", lambda name, up: switched.append((name, up)))
    assert choose() == BusChoice("socketcan", "vcan3")
    assert switched == [("vcan3", True)]
    told: list[str] = []
    monkeypatch.setattr(rig, "set_up", denied)
    assert choose(say=told.append).interface == "datagram"
    assert told == [
        "demo: vcan3 is down and cannot be brought up (Operation not permitted); run ip link set vcan3 up; "
        "the demo continues without it"
    ]
    there(monkeypatch, Interface(False, "vcan", name="vcan0"), Interface(True, "vcan", name="vcan1"))
    monkeypatch.setenv("TSA_VCAN", "vcan0")
    assert choose() == BusChoice("socketcan", "vcan1")


def test_an_interface_may_be_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    assert choose("slcan:/dev/ttyACM0") == BusChoice("slcan", "/dev/ttyACM0")
    there(monkeypatch, Interface(False, "can", name="can0"))
    with pytest.raises(UsageError, match="can0 is down; bring it up"):
        choose("can0")
    with pytest.raises(UsageError, match="no CAN interface can97; interfaces that are up: "):
        choose("can97")


@pytest.mark.parametrize("load", LOADS)
def test_every_load_has_files_that_are_valid(tmp_path: Path, load: str) -> None:
    """The plant differs from the controller's model, because identical parameters would make the demo meaningless."""
    tables = rig.plant(VIRTUAL, "full", load=load)
    controller = rig.controller(VIRTUAL, "with", 1e3, "nominal.toml", 0.95)
    rig.write(tmp_path, play_for(load), tables, {"with": controller})
    assert load_configuration(tmp_path / "controller-with.toml").models[0].pretension == 45.0
    assert tables["axis"][0]["perturbation"]["friction_coefficient"] == 1.08
    assert tables["axis"][0]["tendon"]["curvature"] == "uniform"
    (axis,) = check_plant(tmp_path / "plant.toml").axis
    assert axis.joint.load == load
    assert np.abs(play_for(load).tau_j_des).max() < rig.MOST_TORQUE


@pytest.mark.slow
@pytest.mark.parametrize("load", ["imposed", "wearer"])
def test_virtual_time_shows_what_compensation_gains(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], load: str
) -> None:
    """A wearer's joint moves by more than 0.3 rad, and its motion with compensation differs from the one without."""
    with pytest.raises(SystemExit) as stop:
        main(["demo", "--virtual", "--out", str(tmp_path), "--json", "--load", load, "--seconds", "5"])
    assert stop.value.code == 0
    data = json.loads(capsys.readouterr().out)
    assert set(data) == {"schema", "bus", "load", "rate", "rms", "reduction_percent", "picture", "log", "cycles"}
    assert (data["bus"], data["load"]) == ("virtual time", load)
    assert data["cycles"]["late"] == data["cycles"]["missed_pdo"] == 0
    assert data["cycles"]["planned"] == data["cycles"]["sent"] > 10_000
    assert Path(data["picture"]).read_bytes().startswith(b"\x89PNG")
    assert Path(data["log"]).stat().st_size > 100_000
    if load == "imposed":
        assert data["reduction_percent"] >= 80.0
    else:
        found, without = (read_table(path, ("t", "q_j")).columns["q_j"] for path in (
            Path(data["log"]), tmp_path / "without" / "tsa.mcap"
        ))  # fmt: skip
        assert np.ptp(found) > 0.3
        assert not np.array_equal(found, without)


@pytest.mark.slow
@pytest.mark.parametrize("asked", [False, True])
@pytest.mark.parametrize("slow", [False, True])
def test_where_real_time_fails_the_demo_goes_on_in_virtual_time_unless_a_bus_was_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, asked: bool, slow: bool
) -> None:
    """The nodes do not start, or the loop skips every second cycle."""
    on = run.runs_on

    def busy(bus: BusChoice) -> Any:
        def play(folder: Path, name: str, *how: Any) -> dict[str, Any]:
            if slow:
                summary = on(VIRTUAL)(folder, name, *how)
                summary["cycles"]["sent"] //= 2
                return summary
            (folder / name).mkdir()
            (folder / name / "tsa.mcap").write_bytes(b"half a log")
            raise BusError("the plant was not ready within 120 s; the machine is too busy")

        return on(bus) if bus.virtual else play

    monkeypatch.setattr(run, "runs_on", busy)
    monkeypatch.setattr(rig, "choose", lambda *_: BusChoice("udp_multicast", "239.0.0.1"))
    options = ["--bus", "udp_multicast:239.0.0.1"] if asked else []
    with pytest.raises(SystemExit) as stop:
        main(["demo", "--out", str(tmp_path), "--seconds", "3", "--json", *options])
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    assert ("the loop skipped 50% of its cycles" if slow else "the machine is too busy") in captured.err
    assert "in virtual time, without a bus" in captured.err or "tsa demo --virtual" in captured.err
    assert stop.value.code == (1 if asked else 0)
    if not asked:
        data = json.loads(captured.out)
        assert data["bus"] == "virtual time"
        assert data["reduction_percent"] > 50.0


@pytest.mark.parametrize(
    "options", [["--bus", "vcan0"], ["--load", "limp"], ["--full", "--load", "limb"], ["--setpoint", "nowhere.csv"]]
)
def test_what_virtual_time_and_loads_do_not_go_with_is_one_line(
    options: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["demo", "--virtual", *options])
    assert stop.value.code == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
