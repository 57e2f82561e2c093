"""Files made from logs keep the joint of the nominal file and do not count as a tuning."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from tests.model.actuator import ACTUATOR
from tests.virtual.files import write
from tsa_ctrl import simulate_loop
from tsa_ctrl.identify.dataset import load_log
from tsa_ctrl.identify.provenance import provenance
from tsa_ctrl.model.parameters import load_tendon_sheath, save_model
from tsa_ctrl.model.provenance import NodeIdentity, Origin, with_origin

NODES = {
    "drive": NodeIdentity(serial_number=4711, node_id=1),
    "encoder": NodeIdentity(serial_number=815, node_id=32),
}


def test_a_calibration_from_logs_keeps_the_joint_and_is_no_tuning(tmp_path: Path) -> None:
    nominal, new = tmp_path / "nominal.toml", tmp_path / "new.toml"
    save_model(ACTUATOR, nominal)
    nominal.write_text(with_origin(nominal.read_text(), Origin("measured", NODES)))
    save_model(ACTUATOR, new, template=nominal, provenance=provenance("calibrate", {"a.csv": "1"}, nominal, {}))
    assert load_tendon_sheath(new).origin == Origin("logs", NODES)


def test_a_calibration_from_the_log_of_a_virtual_run_is_simulated(tmp_path: Path) -> None:
    """Regression test: the source was "logs", so the numbers counted as calibrated on hardware."""
    simulate_loop(*write(tmp_path), 1.5, out=tmp_path)
    log = load_log(tmp_path / "tsa.mcap")
    assert log.resampled(500.0).simulated
    assert provenance("calibrate", [log], tmp_path / "none.toml", {})["source"] == "simulated"
    measured = dataclasses.replace(log, simulated=False)
    assert provenance("calibrate", [measured], tmp_path / "none.toml", {})["source"] == "logs"


def test_a_tuning_writes_its_own_joint(tmp_path: Path) -> None:
    nominal, new = tmp_path / "nominal.toml", tmp_path / "new.toml"
    save_model(ACTUATOR, nominal)
    nominal.write_text(with_origin(nominal.read_text(), Origin("simulated", {})))
    source = provenance("tune", {"a.csv": "1"}, nominal, {}, Origin("measured", NODES), split=False)
    save_model(ACTUATOR, new, template=nominal, provenance=source)
    assert load_tendon_sheath(new).origin == Origin("measured", NODES)
    assert 'command = "tune"' in new.read_text()


def test_a_file_without_an_origin_gets_none(tmp_path: Path) -> None:
    nominal = tmp_path / "nominal.toml"
    save_model(ACTUATOR, nominal)
    text = nominal.read_text()
    assert "provenance" not in with_origin(with_origin(text, Origin("measured", NODES)), Origin())
