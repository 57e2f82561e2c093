"""Requirements of class "worn", the record of verify-safety, and limits that are looser than shipped."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import tomlkit
from click.testing import CliRunner

from tests.plant.bench import ACTUATOR
from tests.virtual.files import controller, merged, write
from tsa_ctrl.cli import cli
from tsa_ctrl.config import Configuration, load_configuration
from tsa_ctrl.daemon.build import describe
from tsa_ctrl.daemon.run import run
from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.provenance import NodeIdentity
from tsa_ctrl.readiness import (
    RECORD,
    SignAndGain,
    add_to_record,
    fingerprint,
    loose_lines,
    missing,
    missing_on_bus,
    read_record,
)

WORN = {"class": "worn", "wearer_speed": 4.0, "travel": [-1.0, 2.0]}
TUNED = """
[provenance]
source = "measured"
drive = { serial_number = 7, node_id = 1 }
encoder = { serial_number = 8, node_id = 32 }
"""
NODES = {
    "knee": {"drive": NodeIdentity(serial_number=7, node_id=1), "encoder": NodeIdentity(serial_number=8, node_id=32)}
}
HELD = {"knee": SignAndGain(date="2026-11-24T10:00:00+00:00", gain=1.01, sensor="joint torque sensor")}


def load(folder: Path, tuned: str = TUNED, **changes: Any) -> Configuration:
    """Return the configuration of a rig in class "worn" that lacks only the record of verify-safety."""
    file = merged({"safety": WORN, "controller": {"settle_cycles": 100}}, changes.pop("file", {}))
    path, _ = write(folder, controller(file=file, **{"law": {"fade_in": 1.0}, **changes}))
    (folder / "actuator.toml").write_text(ACTUATOR + tuned, encoding="utf-8")
    return load_configuration(path)


def ready(folder: Path, **changes: Any) -> Configuration:
    """Return the same configuration with a complete record."""
    configuration = load(folder, **changes)
    add_to_record(configuration, NODES, watchdogs="2026-11-24T10:00:00+00:00", held=HELD)
    return configuration


CELLS = [{"quantity": name, "port": f"/dev/{name}"} for name in ("t1", "t3")]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, ""),
        ({"torque_sensor": None, "serial": CELLS}, ""),
        ({"file": {"safety": {"class": "bench"}}, "torque_sensor": None, "tuned": ""}, ""),
        ({"torque_sensor": None}, "a joint torque sensor or both load cells (add"),
        ({"torque_sensor": None, "serial": [{"quantity": "t1", "port": "/dev/a"}]}, "or both load cells (add"),
        ({"file": {"safety": {"travel": None}}}, "the travel (give"),
        ({"file": {"safety": {"wearer_speed": None}}}, "the wearer's speed (give [safety] wearer_speed)"),
        ({"tuned": ""}, "the serial number of its drive and encoder in actuator.toml (tsa tune"),
        ({"tuned": TUNED.replace("encoder", "# encoder")}, "the serial number of its encoder in actuator.toml"),
        (
            {"limits": {"over_speed": 7.0}},
            "limits.over_speed 7 rad/s is above 6.25 rad/s, which follows from wearer",
        ),
        ({"drive": {"host_timeout": 1.0}}, 'host_timeout 1 s (shipped is 0.1): class "worn" allows 0.2 s at most'),
        (
            {"drive": {"require_watchdog": False}},
            'require_watchdog = false: class "worn" allows only the shipped value',
        ),
        ({"limits": {"travel": [-1.0, 1.5]}, "file": {"safety": {"travel": [-90.0, 90.0]}}}, ""),
        ({"limits": {"travel": [-15.0, 15.0]}, "file": {"safety": {"travel": None}}}, "travel 15 rad"),
        ({"file": {"realtime": {"allow_without": True}}}, "allow_without = true"),
    ],
)
def test_each_thing_that_is_missing_is_named_with_its_remedy(
    tmp_path: Path, changes: dict[str, Any], words: str
) -> None:
    found = missing(ready(tmp_path, **changes))
    assert any(words in line for line in found) if words else not found


def test_several_axes_need_a_travel_each(tmp_path: Path) -> None:
    """[safety] travel does not belong to a particular joint if the file has several axes."""
    tables = controller(file={"safety": WORN})
    hip = merged(tables["axis"][0], {"name": "hip", "drive": {"node_id": 2}, "torque_sensor": {"node_id": 65}})
    tables["axis"].append(merged(hip, {"encoder": {"node_id": 33}, "limits": {"travel": WORN["travel"]}}))
    tables["controller"]["rate"] = 400.0
    found = missing(load_configuration(write(tmp_path, tables)[0]))
    assert [line for line in found if "its own travel" in line] == [
        "axis 'knee': its own travel, because the file has several axes (give [axis.limits] travel)"
    ]


def test_everything_that_is_missing_is_one_message_of_one_line(tmp_path: Path) -> None:
    """`tsa run` and `tsa run --check` report all six missing items in one line."""
    file = {"safety": {"class": "worn"}, "controller": {"settle_cycles": 100}}
    path, _ = write(tmp_path, controller(torque_sensor=None, law={"fade_in": 1.0}, file=file))
    (tmp_path / "actuator.toml").write_text(ACTUATOR, encoding="utf-8")
    words = ("lacks 6: ", "wearer_speed", "load cells", "travel", "serial number", "verify-safety", "--held")
    with pytest.raises(UsageError) as caught:
        run(load_configuration(path))
    result = CliRunner().invoke(cli, ["run", "--check", str(path)])
    assert isinstance(result.exception, UsageError)
    for message in (str(caught.value), str(result.exception)):
        assert "\n" not in message
        assert [word for word in words if word not in message] == []
    assert result.exception.exit_code == 2


@pytest.mark.parametrize(
    "changes",
    [
        {"limits": {"torque": 2.4}},
        {"limits": {"rate": 150.0}},
        {"drive": {"host_timeout": 0.15}},
        {"drive": {"torque_sign": -1}},
        {"encoder": {"sign": -1}},
        {"torque_sensor": {"resolution": 2e-6}},
        {"file": {"safety": {"wearer_speed": 3.0}}},
        {"file": {"safety": {"emergency_stop": 3}}},
        {"file": {"bus": {"host_heartbeat_period": 0.03}}},
        {"file": {"controller": {"rate": 500.0}}},
    ],
)
def test_a_change_that_matters_invalidates_the_record(tmp_path: Path, changes: Mapping[str, Any]) -> None:
    ready(tmp_path)
    (line,) = missing(load(tmp_path, **changes))
    assert "is for another one (tsa verify-safety, and with --held)" in line


def test_other_pulleys_invalidate_the_record(tmp_path: Path) -> None:
    before = fingerprint(ready(tmp_path))
    path = tmp_path / "actuator.toml"
    path.write_text(path.read_text().replace("motor_pulley_radius = 0.02", "motor_pulley_radius = 0.021"))
    assert fingerprint(load_configuration(tmp_path / "controller.toml")) != before


@pytest.mark.parametrize(
    "changes",
    [
        {"setpoint": {"amplitude": 0.7}},
        {"law": {"compensation": 0.5, "fade_in": 1.0}},
        {"file": {"log": {"folder": "elsewhere"}}},
        {"file": {"controller": {"after_fault": "exit"}}},
    ],
)
def test_a_change_that_does_not_matter_leaves_the_record_valid(tmp_path: Path, changes: Mapping[str, Any]) -> None:
    ready(tmp_path)
    assert missing(load(tmp_path, **changes)) == []


def test_results_are_added_to_a_record_of_the_same_rig_and_replace_that_of_another(tmp_path: Path) -> None:
    configuration = load(tmp_path)
    add_to_record(configuration, NODES, watchdogs="2026-11-24T10:00:00+00:00")
    add_to_record(configuration, NODES, held=HELD)
    record = read_record(configuration)
    assert record is not None
    assert (record.watchdogs, record.held) == ("2026-11-24T10:00:00+00:00", HELD)
    other = {"knee": {**NODES["knee"], "drive": NodeIdentity(serial_number=9, node_id=1)}}
    add_to_record(configuration, other, held=HELD)
    record = read_record(configuration)
    assert record is not None
    assert record.watchdogs == ""


def test_a_damaged_record_is_one_line(tmp_path: Path) -> None:
    configuration = ready(tmp_path)
    (tmp_path / RECORD).write_text("watchdogs = 5\n", encoding="utf-8")
    with pytest.raises(UsageError, match=r"verify-safety.toml: "):
        missing(configuration)


def test_the_nodes_of_the_record_are_there_and_their_inputs_have_an_emergency_stop(tmp_path: Path) -> None:
    """Another drive is named with both numbers. A stop that no drive can read is an error in every class."""
    stop = {"safety": {"emergency_stop": 3}}
    bench = load_configuration(write(tmp_path, controller(file=stop))[0])
    (line,) = missing_on_bus(bench, NODES, has_inputs=False)
    assert "no drive has 0x60FD:0 digital inputs" in line
    rig = ready(tmp_path)
    assert missing_on_bus(rig, NODES, has_inputs=False) == []
    other = {"knee": {**NODES["knee"], "drive": NodeIdentity(serial_number=9, node_id=1)}}
    (line,) = missing_on_bus(rig, other, has_inputs=False)
    assert "another drive: serial number 7, found serial number 9 (run tsa verify-safety again)" in line
    (line,) = missing_on_bus(rig, NODES, has_inputs=True)
    assert "the emergency stop: a drive has 0x60FD:0 digital inputs (give its bit as [safety] emergency_stop)" in line
    assert missing_on_bus(ready(tmp_path, file=stop), NODES, has_inputs=True) == []


def lines(folder: Path, **changes: Any) -> list[str]:
    return loose_lines(load_configuration(write(folder, controller(**changes))[0]))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"limits": {"joint_speed": 150.0, "over_speed": 180.0}}, "over_speed 180 rad/s (shipped is 12)"),
        ({"limits": {"travel": [-9.0, 4.5]}}, "travel 9 rad (shipped is 3.142)"),
        ({"limits": {"torque": 100.0}, "drive": {"max_torque": 100.0}}, "torque 100 N*m (shipped is 40)"),
        ({"drive": {"host_timeout": 10.0}}, "host_timeout 10 s (shipped is 0.1)"),
        ({"torque_sensor": {"heartbeat_timeout": 10.0}}, "[axis.torque_sensor] heartbeat_timeout 10 s"),
        ({"file": {"safety": {"zero_torque_within": 5.0}}}, "zero_torque_within 5 s (shipped is 0.25)"),
        ({"file": {"controller": {"settle_cycles": 5}}}, "[controller] settle_cycles 5 cycles (shipped is 100)"),
        ({"file": {"bus": {"send_queue": 64}}}, "[bus] send_queue 64 frames (shipped is 32)"),
        (
            {"estimator": {"kind": "sensor", "use": True, "residual": 9.0}},
            "[axis.estimator] residual 9 N*m (shipped is",
        ),
        ({"serial": [CELLS[0] | {"timeout": 1.0}]}, "[axis.serial] timeout 1 s (shipped is 0.1)"),
        ({"file": {"safety": {"wearer_speed": 9.0}}}, "joint_speed 11.25 rad/s (shipped is 10)"),
        ({"file": {"safety": WORN | {"wearer_speed": 9.0}}}, "joint_speed 11.25 rad/s (shipped is 8.75)"),
    ],
)
def test_a_bound_that_is_looser_than_shipped_is_listed(tmp_path: Path, changes: dict[str, Any], words: str) -> None:
    assert any(words in line for line in lines(tmp_path, **changes))


def test_check_and_status_list_the_loose_bounds_and_the_example_has_none(tmp_path: Path) -> None:
    path, _ = write(tmp_path, controller(drive={"host_timeout": 0.3}))
    result = CliRunner().invoke(cli, ["run", "--check", str(path)])
    assert "looser than shipped: axis 'knee': [axis.drive] host_timeout 0.3 s (shipped is 0.1)" in result.output
    configuration = load_configuration(path)
    assert describe(configuration, ()).loose_bounds == loose_lines(configuration) != []
    assert loose_lines(load_configuration(Path(__file__).parents[1] / "config/controller.toml")) == []


def test_a_drive_without_a_speed_clamp_is_reported(tmp_path: Path) -> None:
    (tmp_path / "drives").mkdir()
    (tmp_path / "drives/mine.toml").write_text(tomlkit.dumps({"absent": ["max motor speed"]}), encoding="utf-8")
    *_, line = lines(tmp_path, drive={"profile": "mine"})
    assert line == (
        "axis 'knee': the drive has no 0x6080:0 max motor speed (by its profile): the controller alone limits the "
        "speed of the motor"
    )
