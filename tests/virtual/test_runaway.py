"""The compensation causes no runaway if friction or pretension is lost on a joint that can move."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.virtual.joints import GAIT, play, sine
from tsa_ctrl.demo.rig import NOMINAL
from tsa_ctrl.model.parameters import save_model
from tsa_ctrl.virtual.result import Simulation
from tsa_ctrl.virtual.script import Fault

AT = 1.5  # s of the log, time of the change
NUDGE = Fault("push value=0.5 duration=0.05", AT)
STANDS: dict[str, Any] = {"kind": "constant", "offset": 0.0}


def told(result: Simulation) -> list[str]:
    return [e.text for e in result.summary.events if e.text.startswith(("passivity", "oscillation"))]


def added(result: Simulation, after: float = AT) -> float:
    """Return the largest work of any window after this time of the log, less the work of the set-point, J."""
    axis, truth = result.axes[0], result.truth
    t = truth["clock"] - axis.start
    on = (t >= after) & (t < axis.until)
    wanted = np.interp(t, axis.log["t"], axis.log["tau_j_des"])
    work = ((truth["tau_j"] - wanted) * truth["omega_j"])[on] * 1e-3
    total = np.concatenate(([0.0], np.cumsum(work)))
    return float((total - np.minimum.accumulate(total)).max())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("load", "setpoint", "fault", "most"),
    [
        ("weight", STANDS, "pretension value=0.3", 10e-3),  # without the guard it oscillates permanently
        pytest.param("spring", sine(0.5, 0.5), "friction value=0.5", 10e-3, marks=pytest.mark.soak),
        ("free", sine(0.5, 0.5), "friction value=0.75", 10e-3),
    ],
)
def test_lost_friction_moves_no_joint(
    tmp_path: Path, load: str, setpoint: dict[str, Any], fault: str, most: float
) -> None:
    """The joint gets at most J/2 (1 rad/s)^2, and at most 1 mJ after a second. The loss is reported.

    All of the friction was compensated. The term follows the measured friction, so the guard need not report a second
    time, at which it would latch.
    """
    faults = [Fault(fault, AT), *([NUDGE] if setpoint is STANDS else [])]
    result = play(tmp_path, load, setpoint, AT + 2.0, faults=faults)
    assert added(result) <= most
    assert added(result, AT + 1.0) <= 1e-3
    assert "of the model file's values" in told(result)[0]
    assert any("the measured friction torque is at most" in event.text for event in result.summary.events)
    reasons = result.axes[0].to_dict()["limit_reasons"]
    assert reasons.get("PASSIVITY", 0) + reasons.get("UNPROVEN", 0) > 500
    assert not result.axes[0].faults


@pytest.mark.slow
@pytest.mark.soak
def test_a_limb_whose_tendons_lose_nearly_all_pretension_is_stopped(tmp_path: Path) -> None:
    """At 4.5 N the slack tendon separates motor and joint, so a fault latches before the friction is measured.

    Every sudden loss of friction has the limit 30 mJ. The joint gets 10.3 mJ.
    """
    result = play(tmp_path, "limb", GAIT, AT + 2.0, faults=[Fault("pretension value=0.1", AT)])
    truth, axis = result.truth, result.axes[0]
    lost = truth["clock"] - axis.start > AT
    assert min(truth[name][lost].min() for name in ("t1", "t3")) < 0.5  # N
    assert added(result) <= 30e-3
    assert added(result, AT + 1.0) <= 1e-3
    assert "of the model file's values" in told(result)[0]
    assert any("a tendon is torn or loose" in event.text for event in result.summary.events if event.fault)


@pytest.mark.slow
@pytest.mark.parametrize("load", ["weight", "free", "limb"])
def test_another_joints_model_gives_a_nudged_joint_half_the_smaller_credit_at_most(tmp_path: Path, load: str) -> None:
    """The file has twice the friction. With the credit of a trusted file the joints would get 139 to 142 mJ."""
    other = replace(NOMINAL, friction_coefficient=2.0 * NOMINAL.friction_coefficient)
    save_model(other.with_effects({"elongation_coupling": {"curvature_profile": "uniform"}}), tmp_path / "other.toml")
    nudge = Fault("push value=0.4 duration=0.1", AT)
    axis = {"model": "other.toml", "torque_sensor": None}
    result = play(tmp_path, load, STANDS, AT + 2.5, compensation=0.95, axis=axis, faults=[nudge])
    assert added(result) <= 50e-3


@pytest.mark.slow
def test_a_heavy_motors_swing_on_tendons_bent_elsewhere_is_none(tmp_path: Path) -> None:
    """The bends are at the joint, but reversals are planned for even bends.

    After each reversal the motor swings and transfers this energy to the joint.
    """
    result = play(
        tmp_path,
        "imposed",
        GAIT,
        2.0,
        delay=3,
        inertia=6e-4,
        compensation=0.95,
        curvature="joint_end",
        axis={"model": "nominal.toml"},
        plant={"perturbation": {"axial_stiffness": 0.9}},
    )
    assert not told(result)
    assert not result.axes[0].faults


@pytest.mark.slow
def test_the_stretch_sees_it_without_a_torque_sensor(tmp_path: Path) -> None:
    """The elongation measures the remaining friction, and the term follows it."""
    blind = {"torque_sensor": {"present": False}}
    result = play(
        tmp_path,
        "spring",
        GAIT,
        6.0,
        axis={"torque_sensor": None},
        plant=blind,
        faults=[Fault("pretension value=0.2", 4.0)],
    )
    assert added(result, 4.0) <= 30e-3  # later than with a sensor, because the elongation is less certain
    assert any("the measured friction torque is at most" in event.text for event in result.summary.events)


@pytest.mark.slow
def test_what_bounds_the_compensation_is_said_at_the_start(tmp_path: Path) -> None:
    """The range of the wrap angle is reported. Keys of earlier versions are accepted and reported as without effect."""
    axis = {"bending": {"range": 0.1}, "oscillation": {"speed": 0.5}}
    result = play(tmp_path, "held", sine(0.5, 0.5), 2.0, axis=axis)
    texts = [event.text for event in result.summary.events]
    assert sum("that costs 28 % of the compensation" in text for text in texts) == 1
    assert sum("[axis.oscillation] no longer has an effect" in text for text in texts) == 1
    friction = np.abs(result.log["friction_term"]).max()
    assert friction == pytest.approx(0.718 * 2.0 * 45.0 * 0.020 * 0.26, rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("load", ["free", "limb"])
def test_a_reversed_torque_sensor_does_not_prove_friction(tmp_path: Path, load: str) -> None:
    """The plant has half of the file's friction. With the sensor's word alone, a free joint gets 5 J."""
    result = play(
        tmp_path,
        load,
        STANDS,
        4.0,
        compensation=0.95,
        axis={"torque_sensor": {"sign": -1}},
        plant={"perturbation": {"friction_coefficient": 0.5}},
        faults=[Fault(f"push value={2.0 if load == 'limb' else 0.4} duration=0.1", 1.0)],
    )
    truth, axis = result.truth, result.axes[0]
    last = truth["clock"] - axis.start > 3.5
    assert added(result) < 0.3
    assert np.sqrt(np.mean(truth["omega_j"][last] ** 2)) < 0.05


@pytest.mark.slow
def test_the_noise_of_a_setpoint_does_not_sustain_a_motion(tmp_path: Path) -> None:
    """No sensor at the joint, a third of the friction, and 2 mN·m of noise: 6.6 J while noise counted as a request."""
    t = np.arange(0.0, 10.0, 1e-3)
    noise = 2e-3 * np.random.default_rng(3).standard_normal(len(t))
    np.savetxt(tmp_path / "noise.csv", np.column_stack([t, noise]), delimiter=",", header="t,tau_j_des", comments="")
    result = play(
        tmp_path,
        "free",
        {"kind": "file", "file": "noise.csv"},
        6.0,
        compensation=0.95,
        axis={"torque_sensor": None, "encoder": None},
        plant={"perturbation": {"friction_coefficient": 0.3}},
        faults=[Fault("push value=0.4 duration=0.1", 1.0)],
    )
    assert added(result) < 0.1
