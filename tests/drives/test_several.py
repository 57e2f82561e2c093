"""Several axes in virtual time: one device, several makes on one bus, identical drives, one encoder for two axes."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import tomlkit
from click.testing import CliRunner

from tests.conftest import ROOT
from tests.drives.rig import STILL, refused, served
from tests.plant.bench import ACTUATOR
from tsa_ctrl import simulate_loop
from tsa_ctrl.cli import cli
from tsa_ctrl.config import load_configuration
from tsa_ctrl.errors import UsageError
from tsa_ctrl.virtual.script import Fault

Keys = dict[str, Any]
NONE = {"present": False}
QUIET: Keys = {"fade_in": 0.05, "compensation": 0.0}  # compensation would depend on the last direction


def files(folder: Path, *axes: tuple[Keys, Keys]) -> tuple[Path, Path]:
    """Write the files of a controller and a plant at 500 Hz, and return their paths.

    Each of `axes` holds the keys of [axis.drive] for the controller and for the plant.
    """
    (folder / "actuator.toml").write_text(ACTUATOR, encoding="utf-8")
    shutil.copytree(ROOT / "config" / "drives", folder / "drives", dirs_exist_ok=True)
    ours, theirs = [], []
    for number, (drive, simulated) in enumerate(axes):
        name = "abcdef"[number]
        wanted = {"kind": "constant", "offset": 0.2 + 0.1 * number}
        axis: Keys = {"name": name, "model": "actuator.toml", "drive": {"node_id": number + 1, **drive}}
        ours.append({**axis, "setpoint": wanted, "law": QUIET, "limits": {"torque": 0.9}})
        machine: Keys = {"name": name, "drive": {"node_id": number + 1, **simulated}, "motion": {"kind": "still"}}
        theirs.append({**machine, "encoder": NONE, "torque_sensor": NONE})
    tables = {"controller": {"rate": 500.0, "settle_cycles": 10}, "axis": ours}, {"axis": theirs}
    paths = folder / "controller.toml", folder / "plant.toml"
    for path, table in zip(paths, tables, strict=True):
        path.write_text(tomlkit.dumps(table), encoding="utf-8")
    return paths


def pulls(result: Any, axis: int) -> float:
    """Return the largest torque that the power stage of an axis was commanded (N*m)."""
    return float(abs(result.axes[axis].truth["command"]).max())


def test_three_axes_of_one_device_need_identifiers_for_the_third(tmp_path: Path) -> None:
    device: Keys = {"node_id": 5}
    axes = [({**device, "slot": slot}, {**device, "slot": slot}) for slot in (1, 2, 3)]
    with pytest.raises(UsageError, match="slot 3 without pdo_node_id: a node has PDO identifiers for only two axes"):
        load_configuration(files(tmp_path, *axes)[0])
    axes[2][0]["pdo_node_id"] = 9
    result = simulate_loop(*files(tmp_path, *axes), 1.2)
    assert not result.summary.failed, result.summary.cause
    assert min(pulls(result, axis) for axis in range(3)) > 0.1


def test_two_axes_of_one_device_pull_and_a_fault_of_one_stops_both(tmp_path: Path) -> None:
    """The objects of the second axis are 0x800 higher and its PDOs 64 higher.

    It uses PDO identifiers of the node that the first axis leaves free.
    """
    device: Keys = {"node_id": 5}
    paths = files(tmp_path, (device, device), ({**device, "slot": 2}, {**device, "slot": 2}))
    result = simulate_loop(*paths, 1.5, faults=[Fault("fault axis=b", 0.5)])
    assert 0.1 < pulls(result, 0) < pulls(result, 1)
    for axis in range(2):
        truth = result.axes[axis].truth
        late = truth["clock"] > result.axes[axis].start + 0.5 + 0.35
        assert abs(truth["command"][late]).max() == 0.0


def test_three_makes_on_one_bus(tmp_path: Path) -> None:
    kinds = ("generic", "epos4", "elmo_gold")
    result = simulate_loop(*files(tmp_path, *(({"profile": kind}, {"kind": kind}) for kind in kinds)), 1.2)
    assert not result.summary.failed, result.summary.cause
    assert min(pulls(result, axis) for axis in range(3)) > 0.1


def test_equal_drives_need_their_serial_numbers(tmp_path: Path) -> None:
    with refused("are drives of one model", "write serial_number = 41", "serial_number = 42", "tsa doctor"):
        simulate_loop(*files(tmp_path, ({}, {"serial_number": 41}), ({}, {"serial_number": 42})), 0.3)


def test_exchanged_equal_drives_are_found(tmp_path: Path) -> None:
    right = [({"serial_number": 41}, {"serial_number": 41}), ({"serial_number": 42}, {"serial_number": 42})]
    assert not simulate_loop(*files(tmp_path, *right), 0.3).summary.failed
    wrong = [({"serial_number": 41}, {"serial_number": 42}), ({"serial_number": 42}, {"serial_number": 41})]
    with refused("serial number is 0x0000002A but must be 0x00000029"):
        simulate_loop(*files(tmp_path, *wrong), 0.3)


def test_equal_drives_without_serial_numbers_run(tmp_path: Path) -> None:
    quirk: Keys = {"absent": ["0x1018:4"]}
    assert not simulate_loop(*files(tmp_path, ({}, quirk), ({}, quirk)), 0.3).summary.failed


def test_one_encoder_for_two_axes(tmp_path: Path) -> None:
    """Both read the angle of the first joint, each with its own sign."""
    kinds = [({"profile": kind}, {"kind": kind}) for kind in ("generic", "elmo_gold")]
    controller, plant = files(tmp_path, *kinds)
    tables, machine = (tomlkit.parse(path.read_text(encoding="utf-8")).unwrap() for path in (controller, plant))
    for axis, simulated, sign in zip(tables["axis"], machine["axis"], (1, -1), strict=True):
        axis["encoder"] = {"node_id": 32, "sign": sign}
        simulated["motion"] = {"kind": "sine", "amplitude": 0.3, "ramp": 0.0}
    machine["axis"][0]["encoder"] = {"present": True, "node_id": 32}
    for path, table in ((controller, tables), (plant, machine)):
        path.write_text(tomlkit.dumps(table), encoding="utf-8")
    result = simulate_loop(controller, plant, 0.5)
    angles = [result.axes[axis].log["q_j"][20:-20] for axis in range(2)]
    assert max(abs(angles[0])) > 0.01
    assert angles[0] == pytest.approx(-angles[1], abs=1e-5)


@pytest.fixture
def channel(tmp_path: Path) -> Iterator[str]:
    """Run a plant with two identical drives with serial numbers 41 and 42, and yield its channel."""
    (tmp_path / "plant").mkdir()
    axes = (("a", 41), ("b", 42))
    text = "".join(f"[[axis]]\nname = '{axis}'\ndrive.serial_number = {serial}\n{STILL}" for axis, serial in axes)
    with served(tmp_path / "plant", text) as name:
        yield name


def test_doctor_writes_the_serial_numbers_into_the_file(tmp_path: Path, channel: str) -> None:
    """The rest of the file stays, including comments. The previous file is kept."""
    controller, _ = files(tmp_path, ({}, {}), ({}, {}))
    text = controller.read_text(encoding="utf-8")
    controller.write_text(
        f'# mine\n[bus]\ninterface = "virtual"\nchannel = "{channel}"\n'
        + text.replace("node_id = 2", "node_id = 2 # left"),
        encoding="utf-8",
    )
    done = CliRunner().invoke(cli, ["doctor", str(controller), "--serial-numbers"])
    assert done.exit_code == 0, done.output
    assert "axis 'a': serial_number = 41" in done.output
    drives = [axis.drive for axis in load_configuration(controller).file.axes]
    assert [drive.serial_number for drive in drives] == [41, 42]
    after = controller.read_text(encoding="utf-8")
    assert after.startswith("# mine\n")
    assert "node_id = 2 # left" in after
    assert (tmp_path / "controller.toml.~1~").exists()
