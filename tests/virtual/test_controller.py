"""`Controller` in a user's loop gives the same torque as the daemon, and no torque for an invalid measurement."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from tsa_ctrl import Controller, simulate_loop
from tsa_ctrl.cli import cli
from tsa_ctrl.daemon.controller import Command
from tsa_ctrl.errors import UsageError

STILL = {"tau_m": 0.0, "q_m": 0.25, "omega_m": 0.0, "q_j": 0.2, "tau_j": 0.0}


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("controller") / "desk"
    assert CliRunner().invoke(cli, ["init", "--desk", str(folder)]).exit_code == 0
    return folder


class Held:
    """A drive that applies each command one period later, and a locked joint whose tendons are elastic."""

    stiffness = 40.0  # N*m/rad at the motor: two tendons of 60 kN over 1.2 m at 0.02 m

    def __init__(self, desk: Path) -> None:
        self.controller = Controller(desk / "controller.toml")
        self.command = Command(0.0, False, "", 0.0, 0.0, None)
        self.before = 0.25

    def step(self, set_point: float, operational: bool = True, skipped: int = 0, **changed: float) -> Command:
        torque = self.command.torque
        angle = 0.25 + torque / self.stiffness
        speed, self.before = (angle - self.before) / self.controller.period, angle
        measured = {"tau_m": torque, "q_m": angle, "omega_m": speed, "q_j": 0.2, "tau_j": 0.8 * torque, **changed}
        self.command = self.controller.step(set_point, operational=operational, skipped=skipped, **measured)
        return self.command

    def run(self, steps: int, set_point: float = 0.3, **changed: Any) -> list[Command]:
        return [self.step(set_point, **changed) for _ in range(steps)]

    def enable(self) -> Command:
        """Run from the enable until torque is permitted."""
        self.controller.enable()
        commands = self.run(20, 0.0)
        assert commands[-1].permitted, commands[-1]
        return commands[-1]


def test_the_same_measurements_give_the_torque_of_the_daemon(desk: Path) -> None:
    """The controller is enabled in the same cycle as the recorded run, a sine of 4 s that moves the joint."""
    run = simulate_loop(desk / "controller.toml", desk / "plant.toml", 4.0)
    assert repr(run).startswith("Simulation(seconds: 4 s, ended: 4 s are over, knee: error RMS / 99 % / peak: ")
    assert len(run.plot().axes) == 2
    log = run.log
    began = int(np.flatnonzero(log["tau_j_des"])[0]) - 1
    probe = Controller(desk / "controller.toml")
    probe.enable()
    walk = next(n for n in range(20) if probe.step(0.0, **STILL).permitted)

    controller = Controller(desk / "controller.toml", play=True)
    torques, rows = [], range(began + 900)
    for row in rows:
        if row == began - walk:
            controller.enable()
        measured = {name: float(log[name][row]) for name in ("tau_m", "q_m", "omega_m", "q_j", "tau_j")}
        torques.append(controller.step(**measured).torque)
    assert np.max(np.abs(log["tau_m_cmd"][began : rows.stop])) > 0.5
    np.testing.assert_allclose(torques, log["tau_m_cmd"][: rows.stop], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("name", ["tau_m", "q_m", "omega_m", "q_j"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_measurement_that_is_not_finite_latches_a_fault_and_never_a_torque(
    desk: Path, name: str, value: float
) -> None:
    held = Held(desk)
    held.enable()
    assert held.run(300)[-1].torque != 0.0
    commands = held.run(60, **{name: value})
    assert all(math.isfinite(command.torque) for command in commands)
    assert str(commands[-1].fault).startswith("stale PDO")
    assert {command.torque for command in held.run(60)} == {0.0}  # until it is reset and enabled again
    held.controller.reset()
    assert {command.torque for command in held.run(60)} == {0.0}
    assert held.enable().fault is None


@pytest.mark.parametrize("value", [math.nan, math.inf, 1e9])
def test_no_set_point_drives_the_motor_beyond_its_limit(desk: Path, value: float) -> None:
    """A value that is not finite is ignored; a value that is too large is clamped."""
    held = Held(desk)
    held.enable()
    torques = [command.torque for command in held.run(500, value)]
    assert max(map(abs, torques)) <= 2.0
    assert (set(torques) == {0.0}) is not math.isfinite(value)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (
            {"temperature": 20.0},
            "no argument 'temperature'; the arguments are tau_j_des, tau_m=, q_m=, omega_m=, q_j=, tau_j=, oper",
        ),
        ({"q_j": None}, "step: q_j: found None; give a number"),
        ({"tau_m": np.array([[1.0], [2.0]])}, "step: tau_m: found array([[1.], [2.]]); give a number"),
        ({"operational": "no"}, "step: operational: found 'no'; give True or False"),
        (
            {"operational": np.array([True, False])},
            "step: operational: found array([ True, False]); give True or False",
        ),
    ],
)
def test_a_wrong_argument_is_one_line(desk: Path, changed: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError) as error:
        Controller(desk / "controller.toml").step(0.1, **{**STILL, **changed})
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_a_missing_argument_lists_all_and_an_omitted_joint_angle_is_not_a_missing_answer(desk: Path) -> None:
    controller: Any = Controller(desk / "controller.toml")
    with pytest.raises(UsageError, match=r"Controller.step: missing a required argument: 'tau_m'; the arguments are"):
        controller.step(0.1)
    with pytest.raises(TypeError, match="too many positional arguments"):
        controller.step(0.1, 0.0, 0.0, 0.0)
    with pytest.raises(UsageError, match=r"step: q_j is missing, and the file has \[axis.encoder\]"):
        controller.step(0.1, tau_m=0.0, q_m=0.25, omega_m=0.0)
    assert controller.step(0.1, **{**STILL, "q_j": math.nan}).torque == 0.0


def test_a_disable_and_a_drive_that_lost_its_power_end_at_zero(desk: Path) -> None:
    held = Held(desk)
    held.enable()
    assert held.run(400)[-1].torque != 0.0
    held.controller.disable()
    ramp = held.run(200)
    assert ramp[0].torque != 0.0
    assert (ramp[-1].torque, ramp[-1].permitted, ramp[-1].fault) == (0.0, False, None)
    held.enable()
    assert str(held.step(0.3, operational=False).fault).startswith("drive left operation enabled")


def test_too_many_periods_without_a_call_are_a_fault(desk: Path) -> None:
    held = Held(desk)
    held.enable()
    command = held.run(300, skipped=1)[-1]
    assert command.torque == 0.0
    assert "skipped periods" in str(command.fault)


def test_a_live_parameter_keeps_its_bounds(desk: Path) -> None:
    controller = Controller(desk / "controller.toml")
    controller.set("compensation", 0.5)
    for name, value, words in (
        ("compensation", 9.0, "0 to 1.2"),
        ("nonsense", 1.0, "available: "),
        ("pretension", 40.0, "kind = .fixed."),
    ):
        with pytest.raises(UsageError, match=words):
            controller.set(name, value)


def test_no_repeated_request_restores_what_the_guard_took_back(desk: Path) -> None:
    held = Held(desk)
    held.controller.set("back_off", 0.3)
    held.step(0.0)
    for value in (0.5, 1.0):
        with pytest.raises(UsageError, match=r"above 0\.3"):
            held.controller.set("back_off", value)


def test_files_that_need_the_daemon_are_rejected_in_one_line(desk: Path, tmp_path: Path) -> None:
    text = (desk / "controller.toml").read_text(encoding="utf-8")
    (tmp_path / "actuator.toml").write_bytes((desk / "actuator.toml").read_bytes())
    worn = tmp_path / "worn.toml"
    worn.write_text(text.replace('class = "bench"', 'class = "worn"').replace("# class", "class"), encoding="utf-8")
    assert 'class = "worn"' in worn.read_text(encoding="utf-8")
    with pytest.raises(UsageError, match="worn"):
        Controller(worn)
    with pytest.raises(UsageError, match="play=True"):
        Controller(desk / "controller.toml").step(**STILL)
    with pytest.raises(UsageError, match="play=True"):
        Controller(desk / "controller.toml", play=True).step(0.1, **STILL)
