"""Test model files with simulated numbers on hardware: rejected, or treated as files without a calibration."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.virtual.files import controller, write, write_provenance
from tests.virtual.test_joint_files import NODES
from tsa_ctrl.cli import main
from tsa_ctrl.config import load_configuration
from tsa_ctrl.control.compensation_limit import bound_of
from tsa_ctrl.daemon.joint_files import admitted

INTERVALS = {"half_loop_torque": [0.4, 0.5]}


def files(folder: Path, source: str, interface: str = "socketcan") -> Path:
    """Write a controller file for this interface and a model file with this source. Return the controller file."""
    bus = {"bus": {"interface": interface, "channel": "can0" if interface == "socketcan" else "239.255.74.1"}}
    path, _ = write(folder, controller(file=bus))
    write_provenance(folder / "actuator.toml", source=source, intervals=INTERVALS, **NODES)
    return path


def status(*arguments: str) -> object:
    with pytest.raises(SystemExit) as done:
        main(list(arguments))
    return done.value.code


@pytest.mark.parametrize("command", [("run", "--check"), ("tune", "--yes", "--out", "out")], ids=["run", "tune"])
def test_simulated_numbers_are_rejected_on_hardware(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], command: tuple[str, ...]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert status(*command, str(files(tmp_path, "simulated"))) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "actuator.toml" in line
    assert "the numbers are simulated" in line
    assert "--allow-simulated" in line
    assert not (tmp_path / "out").exists()


def test_allowed_simulated_numbers_are_no_calibration_of_hardware(tmp_path: Path) -> None:
    path = files(tmp_path, "simulated")
    assert status("run", "--check", str(path), "--allow-simulated") == 0
    configuration = load_configuration(path)
    for admission, words in ((configuration, "interval of the calibration"), (admitted(configuration, True), "never")):
        bound = bound_of(admission.models[0], bending_range=0.0, bending_known=False, sees=True, compensation=0.95)
        assert words in " ".join(bound.notes)


@pytest.mark.parametrize(
    ("source", "interface"), [("measured", "socketcan"), ("simulated", "udp_multicast"), ("logs", "socketcan")]
)
def test_other_files_are_admitted_as_they_are(tmp_path: Path, source: str, interface: str) -> None:
    configuration = load_configuration(files(tmp_path, source, interface))
    assert admitted(configuration, False) is configuration
