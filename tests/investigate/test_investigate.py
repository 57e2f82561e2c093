"""Test the design of experiments, and complete investigations of simulated rigs."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest

from tests.investigate.rigs import Rig, rigs, write
from tsa_ctrl.cli import main
from tsa_ctrl.demo.rig import NOMINAL
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.investigate.design import Designer, Experiment, Pair, variations
from tsa_ctrl.investigate.procedure import Answer, investigate
from tsa_ctrl.investigate.response import Joint
from tsa_ctrl.model.parameters import TendonSheath, load_model
from tsa_ctrl.model.predict import predict
from tsa_ctrl.tune.excitation import Bounds, Waveform, multi_sine

SEED = 2  # of the rigs
PLAIN = dataclasses.replace(NOMINAL, effects={})
VISCOUS = NOMINAL.with_effects({"viscous_friction": {"coefficient": 0.1}})
ASYMMETRIC = NOMINAL.with_effects({"direction_asymmetric_friction": {"viscous_difference": 0.1}})


def driven(seconds: float = 10.0, inertia: float = 0.02, spring: float = 0.6, damping: float = 0.15) -> Dataset:
    """Return a log of a joint with a spring. The torque moves the joint, and the sheaths have no friction."""
    period = 0.002
    t = np.arange(0.0, seconds, period)
    torque = 0.4 * np.sin(2.0 * np.pi * 0.5 * t) + 0.2 * np.sin(2.0 * np.pi * 1.3 * t)
    q, omega = np.zeros_like(t), np.zeros_like(t)
    for i in range(1, len(t)):
        rate = (torque[i - 1] - spring * q[i - 1] - damping * omega[i - 1]) / inertia
        omega[i] = omega[i - 1] + period * rate
        q[i] = q[i - 1] + period * omega[i]
    return Dataset.from_arrays({"t": t, "tau_m": 0.8 * torque, "tau_j": torque, "q_j": q, "omega_j": omega}, "driven")


def one_way(sign: float = 1.0) -> Dataset:
    """Return a log of a joint with a prescribed motion in one direction only."""
    t = np.arange(0.0, 8.0, 0.002)
    omega = sign * (0.8 + 0.5 * np.sin(2.0 * np.pi * 0.7 * t))
    torque = 0.3 * np.sin(2.0 * np.pi * 0.31 * t)
    columns = {"t": t, "tau_m": torque, "tau_j": 1.2 * torque, "omega_j": omega, "q_j": np.cumsum(omega) * 0.002}
    return Dataset.from_arrays(columns, "one way")


def best(
    by: list[Dataset], bounds: Bounds, logs: list[Dataset], models: tuple[TendonSheath, TendonSheath] | None
) -> Experiment:
    """Return the best motion of 8 s to separate two models after the given logs, for the joint of the logs `by`."""
    pairs = [Pair(("a", "b"), *models)] if models else []
    return Designer(Joint.of(by, NOMINAL), bounds, logs, 0.01, 1, 8.0).best(pairs)


def test_the_equation_of_motion_is_that_of_the_joint() -> None:
    """The coefficients are 1/J for the torque and -b/J for the velocity."""
    terms = Joint.of([driven()], NOMINAL).terms
    assert terms is not None
    assert terms[0] == pytest.approx(1.0 / 0.02, rel=0.05)
    assert terms[1] == pytest.approx(-0.15 / 0.02, rel=0.15)


def test_a_joint_that_others_move_repeats_its_motion() -> None:
    log = one_way()
    joint = Joint.of([log], NOMINAL)
    assert not joint.driven
    motion = joint.predict(multi_sine((0.3, 0.7), 0.5, 20.0))
    np.testing.assert_allclose(motion.omega_j[:100], log["omega_j"][:100], atol=0.01)


def test_more_torque_never_leaves_the_speed_and_travel_given() -> None:
    """The predicted motion stays within the limits. Full torque would deflect the spring four times as far."""
    bounds = Bounds(torque=1.0, speed=1.5, travel=(-0.4, 0.4))
    log = driven()
    found = best([log], bounds, [log], (VISCOUS, PLAIN))
    assert np.abs(found.motion.omega_j).max() < 1.5
    assert np.abs(found.motion.q_j).max() < 0.4
    assert 0.05 < found.waveform.peak <= 1.0
    assert found.waveform.tau_j_des[0] == found.waveform.tau_j_des[-1] == 0.0


def test_what_one_direction_hides_both_directions_show() -> None:
    """b omega and b abs(omega) are equal while omega > 0. A joint that the torque moves can reverse."""
    outside, pair = one_way(), (VISCOUS, ASYMMETRIC)
    stuck, free = (best([by], Bounds(1.0, 4.0), [outside], pair) for by in (outside, driven()))
    assert min(stuck.separation.values()) < 1.0
    assert min(free.separation.values()) > 10.0


def test_only_the_first_of_two_logs_has_the_angle_of_another_joint() -> None:
    longest = driven()
    columns = {name: longest[name][:2000] for name in longest.columns}
    first = Dataset.from_arrays({**columns, "q_j.hip": 0.1 * columns["q_j"]}, "first")
    assert best([first, longest], Bounds(1.0, 4.0), [first, longest], None).waveform.peak > 0.0


def test_a_rival_that_can_follow_by_its_own_numbers_is_not_separated() -> None:
    """The competing model differs only by a pretension that is 10 % higher, which other parameters can reproduce."""
    log = driven()
    rival = NOMINAL.recalibrated(pretension=1.1 * NOMINAL.pretension)
    found = best([log], Bounds(1.0, 4.0), [log], (PLAIN, rival))
    assert min(found.separation.values()) < 1.0


def test_each_number_of_a_model_is_varied() -> None:
    assert len(variations(VISCOUS)) == 3
    assert len(variations(NOMINAL.with_effects({"torque_ripple": {"amplitude": 0.1, "cycles_per_revolution": 5}}))) == 3


def relaxing(name: str, _: Waveform | None = None) -> tuple[list[Dataset], Path]:
    """Return the log of one motion, without a temperature, while the pretension relaxes; any set-point is ignored."""
    wave = multi_sine((0.3, 0.7), 0.8, 12.0)
    t = np.arange(0.0, wave.seconds, 0.005)
    columns = {"t": t, "tau_m": 0.8 * np.interp(t, wave.t, wave.tau_j_des)}
    columns["q_j"] = 0.6 * np.sin(2.0 * np.pi * 0.4 * t) + 0.3 * np.sin(2.0 * np.pi * 0.9 * t)
    columns["omega_j"] = np.gradient(columns["q_j"], 0.005)
    relaxation = {"pretension_relaxation": {"relaxed_fraction": 0.12, "time_constant": 6.0}}
    tau_j = predict(PLAIN.with_effects(relaxation), Dataset.from_arrays(columns).signals())
    noise = 5e-3 * np.random.default_rng(len(name)).standard_normal(t.size)
    return [Dataset.from_arrays({**columns, "tau_j": tau_j + noise}, name)], Path(name)


@pytest.mark.slow
def test_a_cause_that_only_a_temperature_excludes_is_an_answer() -> None:
    """The competing hypothesis has an invented temperature, so no motion can be predicted with it."""
    logs, _ = relaxing("given")
    found = investigate(relaxing, PLAIN, Bounds(1.0, 8.0), 1, logs=logs)
    assert found.answer is Answer.GROUP
    assert {"pretension_relaxation", "thermal_friction_drift"} <= set(found.statement.split(":")[0].split())
    assert "log the temperature" in found.statement
    assert [step.name for step in found.steps] == ["given logs", "motion-1"]


@pytest.mark.slow
def test_an_error_keeps_the_result_so_far(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The joint of the given log would exceed the permitted speed with the smallest torque."""
    log = driven(4.0)
    columns = [log[name] for name in log.columns]
    np.savetxt(tmp_path / "log.csv", np.column_stack(columns), "%.9g", ",", header=",".join(log.columns), comments="")
    controller, plant = write(tmp_path / "rig", rigs(SEED)[0], SEED)
    given = [str(controller), str(tmp_path / "log.csv"), "--virtual", str(plant), "--out", str(tmp_path / "out")]
    with pytest.raises(SystemExit) as ended:
        main(["investigate", *given, "--speed", "0.001", "--seconds", "8", "--json"])
    told = capsys.readouterr()
    assert (ended.value.code, told.out) == (2, "")
    assert "no set-point keeps the joint within its limits of speed and travel" in told.err
    found = json.loads((tmp_path / "out/investigation.json").read_text(encoding="utf-8"))
    assert found["answer"] == "stopped"
    assert found["statement"] == f"stopped by an error: {told.err.strip().removeprefix('tsa: ')}"
    assert [step["name"] for step in found["steps"]] == ["given logs"]
    assert (tmp_path / "out/report.html").is_file()


def investigated(folder: Path, hidden: Rig, capsys: pytest.CaptureFixture[str], *more: str) -> dict[str, object]:
    controller, plant = write(folder / "rig", hidden, SEED)
    call = ["investigate", str(controller), "--virtual", str(plant), "--out", str(folder / "out"), "--json", *more]
    with pytest.raises(SystemExit) as ended:
        main(call)
    found: dict[str, object] = json.loads(capsys.readouterr().out) | {"code": ended.value.code or 0}
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "healthy",
        "torque_sensor_lag, imposed",
        "torque_saturation, imposed",
        "outside: friction at one place",
        *(pytest.param(hidden.name, marks=pytest.mark.soak) for hidden in rigs(SEED)[2:14]),
    ],
)
def test_the_hidden_cause_is_the_answer(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The hidden cause is identified. Each motion has a folder with its log and its report."""
    hidden = next(each for each in rigs(SEED) if each.name == name)
    found = investigated(tmp_path, hidden, capsys)
    causes, steps = found["causes"], found["steps"]
    assert isinstance(causes, list)
    assert isinstance(steps, list)
    assert hidden.judged(str(found["answer"]), causes), found["statement"]
    assert found["code"] == 0
    assert len(steps) >= 2
    for step in steps:
        folder = tmp_path / "out" / step["folder"]
        assert {"report.html", "diagnosis.json", f"{step['name']}.mcap"} <= {path.name for path in folder.iterdir()}
    assert (tmp_path / "out/report.html").read_text(encoding="utf-8").count("<tr>") == 1 + len(steps)
    extended = load_model(tmp_path / "out/extended.toml")
    assert isinstance(extended, TendonSheath)
    assert extended.origin.source == "simulated"  # a run on hardware rejects such a file


@pytest.mark.slow
def test_a_question_that_is_open_after_the_most_motions_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hidden = next(each for each in rigs(SEED) if each.name == "outside: friction at one place")
    found = investigated(tmp_path, hidden, capsys, "--most", "1")
    steps = found["steps"]
    assert isinstance(steps, list)
    assert len(steps) == 1
    assert math.isfinite(float(str(found["seconds"])))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ([], "confirm with --yes"),
        (["--torque", "50"], "is more than limits.torque"),
        (["--axis", "elbow"], "--axis elbow"),
    ],
)
def test_nothing_moves_before_it_is_confirmed_and_within_the_limits(
    options: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    controller, _ = write(tmp_path / "rig", rigs(SEED)[0], SEED)
    with pytest.raises(SystemExit) as ended:
        main(["investigate", str(controller), "--out", str(tmp_path / "out"), *options])
    assert ended.value.code == 2
    error = capsys.readouterr().err
    assert words in error
    assert len(error.splitlines()) == 1
    assert not (tmp_path / "out").exists()
