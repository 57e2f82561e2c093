"""`tsa tune` on a simulated rig in virtual time: the whole procedure."""

from __future__ import annotations

import dataclasses
import json
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
import tomlkit

from tests.tune import rig
from tests.virtual.rigs import draw
from tsa_ctrl.cli import main
from tsa_ctrl.config import load_configuration
from tsa_ctrl.demo.rig import VIRTUAL
from tsa_ctrl.model.parameters import TendonSheath, load_tendon_sheath, save_model
from tsa_ctrl.tune import procedure
from tsa_ctrl.tune.estimate import Estimate
from tsa_ctrl.virtual import simulation
from tsa_ctrl.virtual.script import Fault

RATE = 500.0  # Hz
TORQUE_LOOP = 0.5e-3  # s, of the plant's drive
SHORT = ("--seconds", "12", "--verify-seconds", "6")
BRIEF = ("--seconds", "8", "--verify-seconds", "4")


def status_of(*arguments: str) -> int:
    """Return the exit status of a command."""
    with pytest.raises(SystemExit) as done:
        main(list(arguments))
    assert isinstance(done.value.code, int)
    return done.value.code


def tune(folder: Path, *options: str) -> int:
    """Return the exit status of `tsa tune --virtual` in a folder with a rig's files."""
    return status_of("tune", str(folder / rig.CONTROLLER), "--virtual", str(folder / "plant.toml"), *options)


@pytest.mark.slow
def test_the_whole_procedure_finds_the_half_loop_and_writes_it_without_what_the_diagnosis_adds_in_vain(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The extension contains a weight that does not exist, so the file without it performs better on the rig."""

    def in_vain(logs: object, model: object, plain: Estimate) -> Estimate:
        weight = {"gravity_load": {"amplitude": 0.3, "phase": 0.0}}
        more = plain.model.with_effects({**plain.model.effects, **weight})
        return dataclasses.replace(plain, model=more, effects=("gravity_load",), plain=plain)

    monkeypatch.setattr(procedure, "extended", in_vain)
    rig.write(tmp_path, VIRTUAL, RATE)
    truth = load_tendon_sheath(tmp_path / rig.MODEL)
    half_loop = rig.true_half_loop(truth)
    assert tune(tmp_path, "--yes", "--json", "--extended", "--out", str(tmp_path / "out"), *BRIEF) == 0
    data = json.loads(capsys.readouterr().out)
    assert [note for note in data["notes"] if note.startswith("not used: gravity_load, which the diagnosis identified")]
    found = data["calibration"]["combinations"]["half_loop_torque"]
    assert found["value"] == pytest.approx(half_loop, rel=0.05)
    reduction = data["verification"]["reduction_percent"]
    assert reduction["after"] > 85.0
    assert data["written"] == str(tmp_path / "out" / rig.MODEL)
    assert load_tendon_sheath(tmp_path / rig.MODEL) == truth  # the rig's own file is never changed
    new = load_tendon_sheath(tmp_path / "out" / rig.MODEL)
    assert new != truth
    assert new.origin.source == "simulated"
    assert {name: node.serial_number for name, node in new.origin.nodes.items()} == {"drive": 1, "encoder": 32}
    assert (tmp_path / "out" / "report.html").stat().st_size > 50_000
    assert not list(tmp_path.glob(".tune-*"))


@pytest.mark.slow
def test_a_file_that_a_fault_stops_is_not_better_and_the_tuning_goes_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The given file and the first new file cause a fault. The second new file is written."""
    loop = simulation.simulate_loop

    def tripping(controller: Path, *given: Any, **more: Any) -> Any:
        faults = [Fault("emcy", 2.0)] if controller.stem in ("controller-before", "controller-after") else []
        return loop(controller, *given, **more, faults=faults)

    def same(logs: object, model: object, plain: Estimate) -> Estimate:
        return dataclasses.replace(plain, effects=("gravity_load",), plain=plain)

    monkeypatch.setattr(simulation, "simulate_loop", tripping)
    monkeypatch.setattr(procedure, "extended", same)
    rig.write(tmp_path, VIRTUAL, RATE)
    assert tune(tmp_path, "--yes", "--json", "--extended", "--out", str(tmp_path / "out"), *BRIEF) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["verification"]["rms"]["before"] is None
    assert data["verification"]["reduction_percent"]["after"] > 85.0
    assert any("0x2310" in note for note in data["notes"])
    assert (tmp_path / "out" / rig.MODEL).exists()


@pytest.mark.slow
def test_the_routing_of_a_leg_is_found_by_moving_its_joints(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The file of the knee does not contain the hip, whose gain is 0.8 rad/rad.

    The runs that one fit uses have different noise. The fit uses the interval of the measured stiffness.
    """
    seeds, shares = {}, []
    loop, learn = simulation.simulate_loop, procedure.learn

    def noted(controller: Path, *given: Any, seed: int | None = None, **more: Any) -> Any:
        seeds[controller.stem.removeprefix("controller-")] = seed
        return loop(controller, *given, seed=seed, **more)

    def learned(logs: Any, model: TendonSheath, settings: procedure.Settings) -> Estimate:
        shares.append(model.axial_stiffness_uncertainty)
        return learn(logs, model, settings)

    monkeypatch.setattr(simulation, "simulate_loop", noted)
    monkeypatch.setattr(procedure, "learn", learned)
    assert status_of("init", "--leg", str(tmp_path / "leg")) == 0
    files = [str(tmp_path / "leg" / name) for name in ("controller.toml", "plant.toml")]
    knee = tmp_path / "leg" / "knee.toml"
    save_model(load_tendon_sheath(knee), tmp_path / "leg" / "true.toml", template=knee)
    save_model(dataclasses.replace(load_tendon_sheath(knee), routing=None), knee, template=knee)
    plant = tomllib.loads(Path(files[1]).read_text())
    plant["axis"][1]["actuator"] = "true.toml"
    Path(files[1]).write_text(tomlkit.dumps(plant))
    capsys.readouterr()
    short = ("--seconds", "10", "--verify-seconds", "4", "--yes", "--json", "--out", str(tmp_path / "out"))
    assert status_of("tune", files[0], "--axis", "knee", "--joint", "hip", "--virtual", files[1], *short) == 0
    data = json.loads(capsys.readouterr().out)
    gain = data["calibration"]["routing"]["gain.hip"]
    assert gain["low"] < 0.8 < gain["high"]
    assert gain["value"] == pytest.approx(0.8, rel=0.1)
    assert seeds["excitation"] != seeds["routing-hip"]
    given, measured = shares
    assert measured < 0.5 * given
    assert load_tendon_sheath(tmp_path / "out" / "knee.toml").axial_stiffness_uncertainty == given
    assert data["verification"]["reduction_percent"]["after"] > 90.0


@pytest.mark.slow
def test_a_rig_of_which_the_files_know_little_is_tuned_and_its_files_stay(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The curvature is S-shaped, and the file has no data of the motor.

    Friction, pretension and stiffness differ by up to 20 %.
    """
    drawn = draw(1, 5)
    law = {"compensation": rig.COMPENSATION, "fade_in": 1.0}
    controller = rig.write(tmp_path, VIRTUAL, RATE, "distributed", drawn.axis(), {"law": law})
    # the plant's own file: tune writes the controller's model file
    save_model(drawn.nominal, tmp_path / "actuator.toml")
    plant = (tmp_path / "plant.toml").read_text().replace("nominal.toml", "actuator.toml")
    (tmp_path / "plant.toml").write_text(plant)
    save_model(drawn.nominal, tmp_path / rig.MODEL)
    before = {path: path.read_bytes() for path in (controller, tmp_path / rig.MODEL)}
    assert tune(tmp_path, "--yes", "--json", "--out", str(tmp_path / "out"), *BRIEF) == 0
    data = json.loads(capsys.readouterr().out)
    quantities = data["law"]["quantities"]
    true = {"motor_inertia": drawn.inertia, "delay": (drawn.delay + 0.5) / RATE + TORQUE_LOOP}
    for name, value in true.items():
        assert quantities[name]["low"] <= value <= quantities[name]["high"], name
    stiffness = data["parameters"]["axial_stiffness"]
    assert stiffness["low"] <= drawn.truth.axial_stiffness <= stiffness["high"]
    assert data["form"] == "uniform"
    assert data["law"]["gain_margin"] >= 2.0
    reduction = data["verification"]["reduction_percent"]
    assert reduction["after"] > max(92.0, reduction["before"])
    assert {path: path.read_bytes() for path in before} == before  # a simulated tuning writes only under --out
    tuned = load_configuration(tmp_path / "out" / controller.name)
    axis = tuned.file.axes[0]
    assert tuned.models[0].origin.source == "simulated"
    assert axis.law.motor_inertia == pytest.approx(drawn.inertia, rel=0.03)
    assert axis.law.damping == data["law"]["keys"]["damping"] > 0.0
    assert "# tsa tune: gain margin" in (tmp_path / "out" / controller.name).read_text()
    assert status_of("tune", str(controller), "--undo") == 2


@pytest.mark.slow
def test_a_new_rig_is_verified_with_compensation_although_its_file_has_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig.write(tmp_path, VIRTUAL, RATE, controller_axis={"law": {"compensation": 0.0}})
    assert tune(tmp_path, "--yes", "--out", str(tmp_path / "out"), *BRIEF) == 0
    said = " ".join(capsys.readouterr().out.split())
    reduction = re.search(r"by ([\d.]+) % with the new one", said)
    assert reduction is not None
    assert float(reduction[1]) > 85.0
    assert "compensation is still 0; the verification used 0.95" in said
    written = load_configuration(tmp_path / "out" / rig.CONTROLLER)
    assert written.file.axes[0].law.compensation == 0.0
    logs = sorted((tmp_path / "out").glob("*.mcap"))
    assert len(logs) >= 5
    assert [json.loads(log.with_suffix(".json").read_text())["log"] for log in logs] == [log.name for log in logs]
    assert not any(path.is_dir() for path in (tmp_path / "out").iterdir())


@pytest.mark.slow
def test_a_joint_of_a_leg_is_tuned_while_the_hip_bends_its_sheath(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The PDOs are lean, so the motor velocity is derived."""
    assert status_of("init", "--leg", str(tmp_path / "leg")) == 0
    files = [str(tmp_path / "leg" / name) for name in ("controller.toml", "plant.toml")]
    capsys.readouterr()
    short = ("--seconds", "8", "--verify-seconds", "4", "--yes", "--json", "--out", str(tmp_path / "out"))
    assert status_of("tune", files[0], "--axis", "knee", "--virtual", files[1], *short) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["verification"]["reduction_percent"]["after"] > 92.0
    given = load_tendon_sheath(tmp_path / "leg" / "knee.toml")
    factors = tomllib.loads((tmp_path / "leg" / "plant.toml").read_text())["axis"][1]["perturbation"]
    stiffness = data["parameters"]["axial_stiffness"]
    assert stiffness["low"] <= factors["axial_stiffness"] * given.axial_stiffness <= stiffness["high"]
    # The hip's motion separates friction angle and pretension by the change of the pretension with the wrap angle.
    for name, true in (
        ("friction_angle", factors["friction_coefficient"] * given.friction_angle),
        ("pretension", factors["pretension"] * given.pretension),
    ):
        found = data["calibration"]["parameters"][name]
        assert found["low"] <= true <= found["high"]
        assert found["value"] == pytest.approx(true, rel=0.03)
        assert found["high"] < 1.15 * found["value"]


@pytest.mark.soak
@pytest.mark.slow
def test_without_torque_sensors_the_friction_of_a_leg_is_that_of_the_mean_wrap_angle(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The torque from the elongation contains the model's friction, so it cannot separate x and T_p."""
    leg = tmp_path / "leg"
    assert status_of("init", "--leg", str(leg)) == 0
    controller = tomlkit.parse((leg / "controller.toml").read_text())
    for axis in controller["axis"]:  # type: ignore[union-attr]
        del axis["torque_sensor"]
    (leg / "controller.toml").write_text(tomlkit.dumps(controller))
    capsys.readouterr()
    short = ("--seconds", "12", "--verify-seconds", "6", "--json", "--out", str(tmp_path / "out"))
    files = [str(leg / name) for name in ("controller.toml", "plant.toml")]
    assert status_of("tune", files[0], "--axis", "knee", "--virtual", files[1], *short) == 0
    data = json.loads(capsys.readouterr().out)
    factors = tomllib.loads((leg / "plant.toml").read_text())["axis"][1]["perturbation"]
    given = load_tendon_sheath(leg / "knee.toml")
    x = factors["friction_coefficient"] * given.friction_angle
    half_loop = 2.0 * given.joint_pulley_radius * factors["pretension"] * given.pretension * x  # even curvature
    found = data["calibration"]["combinations"]["half_loop_torque"]
    assert found["low"] <= half_loop <= found["high"]
    assert found["value"] == pytest.approx(half_loop, rel=0.05)


def test_a_plant_or_a_joint_that_is_not_there_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    controller = rig.write(tmp_path, VIRTUAL, RATE)
    out = tmp_path / "out"
    assert status_of("tune", str(controller), "--virtual", str(tmp_path / "nowhere.toml"), "--out", str(out)) == 2
    assert "nowhere.toml: no such file" in capsys.readouterr().err
    assert not out.exists()
    assert tune(tmp_path, "--joint", "hip", "--dry-run") == 2
    assert "--joint hip is not the name of another axis; the other axes are none" in capsys.readouterr().err
