"""Test joints that bend each other's sheaths, and joints of one limb, against closed forms and a single axis."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomlkit
from numpy.typing import NDArray

from tests.plant.bench import ACTUATOR, R_J, R_M, T_P0, Bench
from tsa_ctrl.errors import UsageError
from tsa_ctrl.plant.axis import Axis
from tsa_ctrl.plant.machine import Machine
from tsa_ctrl.plant.process import check

THETA, MU = 2.6, 0.1  # of the actuator of the bench
SLOPE = 35.0  # N/rad: 60 kN / 1.2 m times 0.7 mm
HIP = {"kind": "sine", "amplitude": 0.5, "frequency": 1.0, "ramp": 0.001}
STILL = {"kind": "still", "offset": 0.5}
APART = "[routing]\njoints = { hip = 0.8 }\ntendon_b.table.hip = [[-1.0, 0.4], [0.0, 0.0], [1.0, -0.6]]\n"


def files(folder: Path, axes: list[dict[str, Any]], mechanism: dict[str, Any] | None = None, routing: str = "") -> Path:
    """Write a plant whose axis "knee" has a sheath bent by `routing`. The motors have no inertia and no lag."""
    (folder / "actuator.toml").write_text(ACTUATOR)
    (folder / "routed.toml").write_text(f"{ACTUATOR}{routing}")
    plain: dict[str, Any] = {"motor": {"inertia": 0.0, "damping": 1e-12}, "drive": {"torque_time_constant": 0.0}}
    knee = {"actuator": "routed.toml"} if routing else {}
    tables = [plain | (knee if axis["name"] == "knee" else {}) | axis for axis in axes]
    text = tomlkit.dumps({"axis": tables} | ({"mechanism": mechanism} if mechanism else {}))
    (folder / "plant.toml").write_text(text)
    return folder / "plant.toml"


def machine(path: Path) -> tuple[Machine, dict[str, Axis]]:
    made = Bench(path.parent, plant=check(path)).machine
    return made, {unit.axis.name: unit.axis for unit in made.axes}


def run(made: Machine, seconds: float, period: float = 1e-3) -> dict[str, dict[str, NDArray[np.float64]]]:
    """Advance the time, and return the values of each axis at the end of each period."""
    units = [unit.axis for unit in made.axes]
    start = units[0].time
    rows: dict[str, list[dict[str, float]]] = {axis.name: [] for axis in units}
    for i in range(1, round(seconds / period) + 1):
        made.mechanism.advance(start + i * period)
        for axis in units:
            rows[axis.name].append(axis.values())
    return {name: {key: np.array([row[key] for row in of]) for key in of[0]} for name, of in rows.items()}


def two(tendon: str, hip: dict[str, Any], knee: dict[str, Any]) -> list[dict[str, Any]]:
    kind = {"kind": tendon}
    return [{"name": "knee", "tendon": kind, "motion": knee}, {"name": "hip", "motion": hip}]


@pytest.mark.parametrize("tendon", ["full", "distributed"])
def test_a_sheath_is_bent_by_the_angle_of_a_joint_that_it_crosses(tmp_path: Path, tendon: str) -> None:
    """The knee's sheath has 2.6 + 0.8 * 0.5 = 3 rad and 45 + 35 * 0.4 = 59 N. The hip's sheath is unchanged."""
    made, _ = machine(
        files(tmp_path, two(tendon, STILL, {"kind": "still"}), routing="[routing]\njoints = { hip = 0.8 }\n")
    )
    after = run(made, 0.01)
    assert after["knee"]["theta"][-1] == pytest.approx(3.0)
    assert after["knee"]["pretension"][-1] == pytest.approx(59.0)
    assert after["hip"]["theta"][-1] == pytest.approx(THETA)
    assert after["knee"]["t1"][-1] == pytest.approx(59.0, rel=1e-3)


def test_the_bending_follows_a_joint_that_moves(tmp_path: Path) -> None:
    """The wrap angle follows the hip. The exchange once per millisecond causes an error of a t^2 / 2 = 10 urad."""
    made, _ = machine(
        files(tmp_path, two("full", HIP, {"kind": "still"}), routing="[routing]\njoints = { hip = 0.8, knee = -0.3 }\n")
    )
    after = run(made, 1.5, 2.5e-3)
    exact = THETA + 0.8 * 0.5 * np.sin(2.0 * math.pi * after["knee"]["t"])
    error = np.abs(after["knee"]["theta"] - exact)[after["knee"]["t"] > 0.01]
    assert error.max() < 0.8 * 0.5 * (2.0 * math.pi) ** 2 * 0.5e-6 * 1.05


def test_a_joint_may_bend_its_own_sheath(tmp_path: Path) -> None:
    made, _ = machine(
        files(tmp_path, two("full", {"kind": "still"}, HIP), routing="[routing]\njoints = { knee = -0.3 }\n")
    )
    after = run(made, 0.7)["knee"]
    assert after["theta"] == pytest.approx(THETA - 0.3 * after["q_j"])


@pytest.mark.parametrize("tendon", ["full", "distributed"])
def test_two_tendons_that_are_routed_differently_have_their_own_friction_and_length(
    tmp_path: Path, tendon: str
) -> None:
    """At a hip angle of 0.5 rad, tendon a has 3.0 rad and tendon b 2.3 rad. Sliding friction is exp(mu Theta).

    Without torque the motor turns by half the difference of the path lengths, so that both tendons have the same
    tension.
    """
    knee = {"kind": "sine", "amplitude": 0.5, "frequency": 0.2, "ramp": 0.001}
    made, axes = machine(files(tmp_path, two(tendon, STILL, knee), routing=APART))
    after = {name: values[-1] for name, values in run(made, 1.0)["knee"].items()}
    assert (after["theta_a"], after["theta_b"]) == pytest.approx((3.0, 2.3))
    assert math.log(after["t2"] / after["t1"]) == pytest.approx(MU * 3.0, rel=1e-3)
    assert math.log(after["t3"] / after["t4"]) == pytest.approx(MU * 2.3, rel=1e-3)
    assert after["t1"] == pytest.approx(after["t3"], rel=1e-6)
    smooth = ACTUATOR.replace("friction_coefficient = 0.10", "friction_coefficient = 0.0")
    (tmp_path / "routed.toml").write_text(smooth + APART)
    made, axes = machine(tmp_path / "plant.toml")
    after = {name: values[-1] for name, values in run(made, 1.0)["knee"].items()}
    assert after["t1"] == pytest.approx(T_P0 + SLOPE * 0.5 * (0.4 - 0.3))
    assert R_M * after["q_m"] - R_J * after["q_j"] == pytest.approx(0.7e-3 * 0.5 * (0.4 + 0.3))
    assert axes["knee"].values()["tau_j"] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("routing", "words"),
    [
        (
            "[routing]\njoints = { hipp = 0.8 }\n",
            r"axis 'knee': \[routing\] names joint 'hipp'; the axes are knee, hip; ",
        ),
        ("[routing]\njoints = { hip = 8.0 }\n", r"wrap angle of -1.4 rad over the travel \(hip from -0.5 to 0.5 rad\)"),
    ],
)
def test_a_routing_that_does_not_fit_the_plant_is_refused(tmp_path: Path, routing: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        check(files(tmp_path, two("full", HIP, {"kind": "still"}), routing=routing))


# A limb in MuJoCo

PENDULUM = """\
<mujoco><option gravity="0 0 -9.81"/><worldbody><body>
<joint name="knee" type="hinge" axis="0 -1 0" damping="{damping}"/>
<inertial pos="0 0 -{arm}" mass="{mass}" diaginertia="{inertia} {inertia} {inertia}"/>
</body></worldbody></mujoco>
"""
LEG = [{"name": name, "tendon": {"kind": "distributed"}} for name in ("hip", "knee", "ankle")]


def pendulum(folder: Path, inertia: float, damping: float, weight: float) -> dict[str, str]:
    """Write the MJCF of a pendulum: `inertia` (kg*m^2) about its joint, `weight` m g l (N*m), `damping` (N*m*s/rad)."""
    mass = 2.0 * weight**2 / 9.81**2 / inertia  # the mass at its arm has half of the inertia
    arm = weight / 9.81 / mass
    text = PENDULUM.format(damping=damping, arm=arm, mass=mass, inertia=0.5 * inertia)
    (folder / "pendulum.xml").write_text(text)
    return {"kind": "mujoco", "model": "pendulum.xml"}


def swing(made: Machine, axes: dict[str, Axis], torques: dict[str, float], seconds: float) -> dict[str, Any]:
    """Drive each motor with a sine of 0.8 Hz, and return the result of `run`."""
    logs = []
    for i in range(round(seconds / 5e-3)):
        for place, (name, torque) in enumerate(torques.items()):
            command = axes[name].command
            command.enabled, command.torque = True, torque * math.sin(2.0 * math.pi * 0.8 * 5e-3 * i + place)
        logs.append(run(made, 5e-3))
    return {name: {key: np.concatenate([log[name][key] for log in logs]) for key in logs[0][name]} for name in logs[0]}


@pytest.mark.slow
@pytest.mark.parametrize("load", [(0.02, 0.05, 1.0), (0.05, 0.1, 4.0)], ids=["weight", "limb"])
def test_one_joint_of_a_limb_moves_as_the_joint_of_one_axis(tmp_path: Path, load: tuple[float, float, float]) -> None:
    """The pendulum swings by 0.9 to 5 rad. Angle and speed agree within 1 % of their range, and the torque by RMS.

    At a reversal of the joint the torque jumps, possibly one sample earlier or later.
    """
    pytest.importorskip("mujoco", reason="the extra 'limb' is not installed")
    inertia, damping, weight = load
    tendon = {"kind": "distributed"}
    by_axis = {"load": "weight", "inertia": inertia, "damping": damping, "weight_torque": weight, "initial_angle": 0.3}
    alone = machine(files(tmp_path, [{"name": "knee", "tendon": tendon, "joint": by_axis}]))
    own = swing(*alone, {"knee": 1.2}, 3.0)["knee"]
    start = {"initial_angle": 0.3}
    limb = machine(files(tmp_path, [{"name": "knee", "tendon": tendon, "joint": start}], pendulum(tmp_path, *load)))
    found = swing(*limb, {"knee": 1.2}, 3.0)["knee"]
    assert np.ptp(own["q_j"]) > 0.5
    for name in ("q_j", "omega_j"):
        assert np.abs(found[name] - own[name]).max() < 0.01 * np.ptp(own[name]), name
    assert np.sqrt(np.mean((found["tau_j"] - own["tau_j"]) ** 2)) < 0.01 * np.ptp(own["tau_j"])


@pytest.mark.slow
def test_a_leg_swings_and_stands_and_does_so_again_bit_by_bit(tmp_path: Path) -> None:
    """Its joints stay within their limits, and no equation remains unsolved.

    A stop is a spring with critical damping and a time constant of 50 ms. A joint that reaches it at the speed v
    exceeds it by at most v 50 ms / e.
    """
    pytest.importorskip("mujoco", reason="the extra 'limb' is not installed")
    path = files(tmp_path, LEG, {"kind": "mujoco"}, "[routing]\njoints = { hip = 0.8 }\n")
    torques = {"hip": 1.2, "knee": 1.0, "ankle": 0.5}
    made, axes = machine(path)
    first = swing(made, axes, torques, 3.0)
    for name, (low, high) in {"hip": (-0.6, 1.2), "knee": (0.0, 1.6), "ankle": (-0.6, 0.5)}.items():
        angle = first[name]["q_j"]
        assert np.isfinite(angle).all()
        give = np.abs(first[name]["omega_j"]).max() * 0.05 / math.e
        assert low - give < angle.min() < angle.max() < high + give
        assert first[name]["unsolved"][-1] == 0
    assert np.ptp(first["hip"]["q_j"]) > 0.3
    assert first["knee"]["theta"] == pytest.approx(THETA + 0.8 * first["hip"]["q_j"], abs=1e-4)
    again = swing(*machine(path), torques, 3.0)
    for name, values in first.items():
        for key, column in values.items():
            assert np.array_equal(column, again[name][key]), (name, key)


def test_a_hand_on_the_limb_moves_it(tmp_path: Path) -> None:
    """A hand of 40 N*m/rad at 0.5 rad holds 4 N*m sin q at 0.46 rad. The motor is free."""
    pytest.importorskip("mujoco", reason="the extra 'limb' is not installed")
    hand = {"hand": [[0.0, 40.0, 2.0, 0.5], [10.0, 40.0, 2.0, 0.5]]}
    mechanism = pendulum(tmp_path, 0.05, 0.1, 4.0)
    made, _ = machine(files(tmp_path, [{"name": "knee", "joint": hand}], mechanism))
    after = {name: values[-1] for name, values in run(made, 2.0)["knee"].items()}
    assert 40.0 * (0.5 - after["q_j"]) + after["tau_j"] == pytest.approx(4.0 * math.sin(after["q_j"]), rel=1e-3)


@pytest.mark.parametrize(
    ("mechanism", "axis", "words"),
    [
        ({"kind": "joints", "model": "leg.xml"}, {}, r'\[mechanism\] kind "joints" has no model; remove model'),
        ({"kind": "mujoco"}, {"joint": {"load": "free"}}, r"\[axis.joint\] describes a separate joint.*the rest"),
        (
            {"kind": "mujoco"},
            {"name": "elbow"},
            r"no joint 'elbow'.* with names are cart, rail, hip, knee, ankle",
        ),
        ({"kind": "mujoco"}, {"name": "rail"}, r"joint 'rail' is not a hinge; an axis drives a hinge"),
        (
            {"kind": "mujoco", "model": "actuator.toml"},
            {},
            r"actuator.toml: cannot be loaded as a model of a limb \(.*\); give an MJCF",
        ),
    ],
)
def test_what_is_no_limb_is_refused_in_one_line(
    tmp_path: Path, mechanism: dict[str, Any], axis: dict[str, Any], words: str
) -> None:
    pytest.importorskip("mujoco", reason="the extra 'limb' is not installed")
    with pytest.raises(UsageError, match=words) as caught:
        check(files(tmp_path, [{"name": "knee"} | axis], mechanism))
    assert "\n" not in str(caught.value)


def test_without_the_package_one_line_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    path = files(tmp_path, [{"name": "knee"}], {"kind": "mujoco"})
    with pytest.raises(UsageError, match=r"needs the package mujoco-core.*pip install '.\[limb\]'.*\"joints\"$"):
        check(path)
