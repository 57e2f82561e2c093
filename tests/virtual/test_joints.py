"""Test the delivered torque with true parameters for each kind of joint.

Healthy joints cause no fault in any of these runs.

Figures are RMS (and peak) of the delivered minus the desired joint torque. Without compensation they are 354 mN*m for a
sine of 0.5 N*m that moves or does not move a joint, 35 for one of 0.05, and 570 for the gait.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.model.capstan import Pair
from tests.virtual.files import write_provenance
from tests.virtual.joints import GAIT, error, play, play_case, rms, sine
from tsa_ctrl.demo.rig import NOMINAL
from tsa_ctrl.model.parameters import save_model
from tsa_ctrl.safety.limiter import Reason
from tsa_ctrl.virtual.result import Simulation
from tsa_ctrl.virtual.script import Change, Fault

CONSTANT = {"kind": "constant", "offset": 0.3}  # N*m
NODES = {"drive": {"serial_number": 1, "node_id": 1}, "encoder": {"serial_number": 32, "node_id": 32}}
QUIET_AFTER = 3.0  # s after the last change of the set-point
GAITS = 3.0  # s, nearly two cycles of the gait
SINES = 3.2  # s, one period after the first second


def reversals(result: Simulation) -> int:
    """Return the number of sign changes of the friction term."""
    axis = result.axes[0]
    sigma = axis.log["sigma"][axis.counted]
    return int(np.count_nonzero(np.diff(np.sign(sigma[sigma != 0.0]))))


def sound(result: Simulation) -> Simulation:
    assert not result.axes[0].faults
    return result


PARTIAL = {  # the torque varies around 0.4 N*m, which causes inner hysteresis loops of the friction
    "kind": "multi_sine",
    "offset": 0.4,
    "components": [{"amplitude": 0.1, "frequency": 1.0}, {"amplitude": 0.15, "frequency": 0.3}],
}
COARSE = {"encoder": {"counts_per_revolution": 1 << 12}}
MOVING = {"joint": {"load": "wearer", "hand": [[0.0, 40.0, 1.0, 0.3]], "hand_repeat": False}}
HEAVY: dict[str, Any] = {"delay": 3, "inertia": 6e-4}
DELIVERED: dict[str, tuple[str, dict[str, Any], float, dict[str, Any], float, float]] = {
    # load, set-point, s, files, and the largest RMS and peak of the error in mN*m
    "longest delay": ("imposed", GAIT, GAITS, {"delay": 3}, 10.0, 100.0),
    "heavy motor": ("imposed", GAIT, GAITS, HEAVY, 19.0, 167.0),
    "unknown motor": ("imposed", GAIT, GAITS, {"known": False}, 0.04 * 570.0, math.inf),
    "coarse encoder": ("imposed", GAIT, 5.0, {"axis": COARSE, "plant": COARSE}, 20.0, math.inf),
    "held, 2 Hz": ("held", sine(0.5, 2.0), 3.0, {}, 25.0, math.inf),
    "held, small": ("held", sine(0.05, 0.5), SINES, {}, 18.0, math.inf),
    "held, partial reversals": ("held", PARTIAL, 5.0, {}, 12.0, math.inf),
    # the joint torque sensor shows sticking tendons, which motor and encoders cannot show
    "wearer, bends at the joint": ("wearer", sine(0.5, 0.5), 8.0, {"curvature": "joint_end"}, 40.0, math.inf),
    # a hand still moves the limb at the enable; earlier versions lost 210 of 300 mN*m
    "moved at the enable": ("wearer", CONSTANT, 1.5, {"plant": MOVING}, math.inf, 25.0),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", DELIVERED)
def test_the_desired_torque_arrives(tmp_path: Path, name: str) -> None:
    load, setpoint, seconds, more, most_rms, most = DELIVERED[name]
    result = sound(play(tmp_path, load, setpoint, seconds, **more))
    assert rms(error(result)) <= most_rms
    assert np.abs(error(result)).max() <= most
    if load == "held":
        assert np.ptp(result.truth["q_j"]) == 0.0
    if name == "coarse encoder":
        assert reversals(result) <= 15  # the friction reverses with the joint
    assert any("law.motor_inertia is not given" in str(event) for event in result.summary.events) is ("known" in more)


def test_a_constant_starts_a_free_joint_at_an_enable_and_after_a_recovery(tmp_path: Path) -> None:
    """The joint starts only with the friction term. The 0.40 N*m at the motor without it do not move it."""
    constant = {"kind": "constant", "offset": 0.5}
    fault, again = Fault("interface_down duration=0.1", 0.05), Change("recover", 1.0, 0.4)
    result = play(tmp_path, "free", constant, 1.3, faults=[fault], changes=(again,))
    axis = result.axes[0]
    began, omega = axis.log["t"], np.interp(axis.log["t"], result.truth["clock"] - axis.start, result.truth["omega_j"])
    assert axis.faults
    assert np.abs(omega[began < 0.4]).max() < 0.05
    assert omega[-1] > 0.5
    assert axis.log["sigma"][-1] == 1.0


@pytest.mark.slow
@pytest.mark.parametrize("load", ["weight", "free"])
def test_a_joint_that_the_torque_moves(tmp_path: Path, load: str) -> None:
    """The joint starts and follows. The friction term does not reverse more often than the motion."""
    result = sound(play_case(tmp_path, load, SINES))
    assert rms(error(result)) <= 20.0
    assert np.ptp(result.truth["q_j"]) > 0.1
    assert reversals(result) <= 10


@pytest.mark.slow
def test_a_wearer(tmp_path: Path) -> None:
    """The error is at least 92 % smaller than without compensation, while the hand lifts the joint and lowers it."""
    without = rms(error(play_case(tmp_path, "wearer", 4.0, known=False, compensation=0.0)))
    assert rms(error(sound(play_case(tmp_path, "wearer", 4.0)))) <= 0.08 * without


@pytest.mark.slow
@pytest.mark.parametrize(
    ("load", "delay"),
    [
        ("free", 1),  # it has no damping
        ("limb", 3),  # a weight, a spring and the longest delay
    ],
)
def test_what_is_no_longer_driven_comes_to_rest(tmp_path: Path, load: str, delay: int) -> None:
    """With full compensation of the true friction there is no limit cycle after the set-point has gone to 0."""
    last = 1.75
    changes = (Change("setpoint_gain", 0.0, last - 1.0),)
    result = play(tmp_path, load, sine(0.5, 0.5), last + QUIET_AFTER + 1.8, delay=delay, changes=changes)
    t = result.truth["clock"] - result.axes[0].start
    late = (t > last + 1.0 + QUIET_AFTER) & (t < result.axes[0].until)
    assert np.count_nonzero(late) > 500
    assert rms(result.truth["omega_j"][late]) <= 0.02
    assert np.ptp(result.truth["tau_m"][late]) <= 0.02


@pytest.mark.slow
@pytest.mark.parametrize(
    ("setpoint", "trembles"),
    [(CONSTANT, 0.5e-3), (sine(0.4, 0.5), 10e-3)],
)
def test_a_hand_that_trembles(tmp_path: Path, trembles: float, setpoint: dict[str, Any]) -> None:
    """The hand trembles at 8 Hz. The friction reverses each time, and no chatter fault occurs.

    Without compensation the error is 90 to 600 mN*m.
    """
    script = [[0.02 * n, 40.0, 1.0, 0.3 + trembles * math.sin(16.0 * math.pi * 0.02 * n)] for n in range(110)]
    hand = {"joint": {"load": "wearer", "hand": script, "hand_repeat": False}}
    result = play(tmp_path, "wearer", setpoint, 2.2, plant=hand)
    assert not result.axes[0].faults
    assert not any("oscillation" in str(event) for event in result.summary.events)
    assert rms(error(result)) <= 30.0


def test_beyond_the_domain_is_told(tmp_path: Path) -> None:
    """A set-point of 2.2 N*m needs more than the possible 2.04 N*m at the motor. This is an event but no fault."""
    result = play(tmp_path, "held", {"kind": "constant", "offset": 2.2, "rate": 5.0}, 1.5)
    simulated = result.to_dict()["axes"][0]
    assert simulated["limit_reasons"]["DOMAIN"] > 300
    assert not simulated["faults"]
    assert sum("one tendon goes slack" in str(event) for event in result.summary.events) == 1
    pair = Pair(((1.0, 1.0),), 0.26)
    slack, unloaded = pair.motor_tensions(1.0, 1.0)[0], pair.motor_tensions(0.0, 1.0)[0]
    highest = unloaded / (unloaded - slack)  # N*m at the motor, for which T1 is 0 by the capstan equation
    assert result.log["tau_m_cmd"].max() <= highest + 0.05
    assert result.axes[0].delivered[result.axes[0].counted].max() > 1.9  # 1.66 with the bound of the other direction


@pytest.mark.slow
@pytest.mark.parametrize(("wearer_speed", "share"), [(3.41, 1.25), (3.79, 1.05)])
def test_a_wearer_who_is_faster_than_the_limit_backs_no_compensation_off(
    tmp_path: Path, wearer_speed: float, share: float
) -> None:
    """The torque fades while the joint is too fast. Its return causes no reaction of the guard."""
    limits = {"joint_speed": share * wearer_speed, "over_speed": 1.25 * share * wearer_speed}
    result = play(tmp_path, "imposed", GAIT, 1.8, axis={"limits": limits})
    log = result.axes[0].log
    assert (log["limit_reason"] == Reason.SPEED.value).any()
    assert not (log["limit_reason"] == Reason.PASSIVITY.value).any()
    assert np.abs(log["omega_m"]).max() < 1.1 * 1.25 * np.abs(log["omega_j"]).max()


@pytest.mark.parametrize("tuned", [True, False])
def test_the_ripple_of_a_tuned_file_is_not_taken_for_missing_friction(tmp_path: Path, tuned: bool) -> None:
    """The friction torque is 0.09 N*m at the motor. A ripple of 0.035 N*m opposes and supports it."""
    light = NOMINAL.recalibrated(0.05, NOMINAL.pretension)
    ripple = {"amplitude": 0.035, "cycles_per_revolution": 6, "phase": 2.9}
    save_model(light, tmp_path / "light.toml")
    effects = {"elongation_coupling": {"curvature_profile": "uniform"}, "torque_ripple": ripple}
    save_model(light.with_effects(effects), tmp_path / "known.toml")
    if tuned:
        write_provenance(tmp_path / "known.toml", source="simulated", **NODES)
    plant = {"actuator": "light.toml", "effects": {"torque_ripple": ripple}}
    found = sound(play(tmp_path, "imposed", GAIT, GAITS, axis={"model": "known.toml"}, plant=plant)).axes[0]
    assert bool(np.any(found.log["limit_reason"][found.counted] == Reason.UNPROVEN.value)) is not tuned
    assert (1e3 * rms(found.error) < 7.0) is tuned
