"""Joint torque from elongation and motor torque, compared with the capstan equation integrated along the tendons."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.control.sliding import actuator
from tests.model.capstan import Pair
from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.curvature import NAMED, Points
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.predict import predict, stretching
from tsa_ctrl.model.signals import Signals
from tsa_ctrl.model.stretch import compliance_centre, compliances, stretch_line, unsupported_reason

S_BENT: Points = ((0.0, 0.0), (0.2, 0.5), (0.7, 0.5), (1.0, 1.0))


def model_of(points: Points, x: float, **more: float) -> TendonSheath:
    model = actuator().recalibrated(x).with_effects({"elongation_coupling": {"curvature_profile": points}})
    return dataclasses.replace(model, axial_stiffness=60e3, **more)  # type: ignore[arg-type]


@pytest.mark.parametrize("points", [NAMED["uniform"], NAMED["motor_end"], S_BENT], ids=["uniform", "motor", "s"])
@pytest.mark.parametrize("sigma", [-1.0, 1.0])
@pytest.mark.parametrize(("x", "tension"), [(0.05, 20.0), (0.26, 45.0), (0.9, 70.0)])
def test_the_line_is_that_of_the_capstan(points: Points, sigma: float, x: float, tension: float) -> None:
    """The line is exact for any friction angle, pretension and torque, in both directions."""
    pair = Pair(points, x, tension)
    tau_m = 0.4
    t3 = pair.motor_tensions(tau_m, sigma)[1]
    path = tension * pair.along(0.0)[1]  # m, elongation of each tendon by the pretension alone
    stretch = t3 * pair.along(-sigma * x)[1] - path
    line = stretch_line(model_of(points, x, pretension=0.3 * tension))  # the pretension of the model has no influence
    assert line.torque(stretch, tau_m) == pytest.approx(pair.joint_torque(tau_m, sigma), abs=1e-6)


@pytest.mark.parametrize(("spring", "place"), [("motor_spring", False), ("joint_spring", True)])
def test_a_series_spring_moves_the_centre(spring: str, place: bool) -> None:
    """A spring at the motor moves it towards the joint, and vice versa. The line agrees with the capstan equation."""
    pair = dataclasses.replace(Pair(NAMED["uniform"], 0.26), **{spring: 1.0 / 1e5})
    t3 = pair.motor_tensions(0.4, 1.0)[1]
    stretch = t3 * pair.along(-0.26)[1] - 45.0 * pair.along(0.0)[1]
    model = dataclasses.replace(model_of(NAMED["uniform"], 0.26), series_stiffness=1e5, series_at_joint=place)
    assert stretch_line(model).torque(stretch, 0.4) == pytest.approx(pair.joint_torque(0.4, 1.0), abs=1e-6)
    assert compliance_centre(model) == pytest.approx((0.5 * 2e-5 + (0.0 if place else 1e-5)) / 3e-5)


def test_bends_at_the_joint_are_refused_with_the_reason() -> None:
    """Values at and near the singularity are rejected. A model without a profile has even curvature."""
    near: Points = ((0.0, 0.0), (0.5, 0.0), (1.0, 1.0))
    assert unsupported_reason(actuator()) == ""
    with pytest.raises(UsageError, match=r"all bends are at the joint .* use a joint torque sensor"):
        stretch_line(model_of(NAMED["joint_end"], 0.26))
    with pytest.raises(UsageError, match=r"centre of the bends is at 0\.75"):
        stretch_line(model_of(near, 0.26))


@pytest.mark.parametrize("points", [NAMED["joint_end"], NAMED["uniform"], NAMED["motor_end"], S_BENT])
@pytest.mark.parametrize("x", [1e-6, 0.26, 0.9])
@pytest.mark.parametrize("sigma", [-1.0, 1.0])
def test_the_ends_of_the_tendons_make_the_stretch(points: Points, x: float, sigma: float) -> None:
    """It holds for every profile, including all curvature at the joint, in both directions.

    The reference is the capstan equation.
    """
    pair = Pair(points, x)
    by_motor, by_joint = compliances(model_of(points, x))

    def stretch(tau_m: float) -> float:
        return pair.motor_tensions(tau_m, sigma)[1] * pair.along(-sigma * x)[1] - 45.0 * pair.along(0.0)[1]

    told = [by_motor * tau_m / 0.020 + by_joint * pair.joint_torque(tau_m, sigma) / 0.025 for tau_m in (0.4, -0.3)]
    assert told == pytest.approx([stretch(0.4), stretch(-0.3)], abs=1e-9)


def test_what_stretches_the_tendons_is_before_the_joint_and_counts_a_tendon_alone_twice() -> None:
    """The joint end excludes a torque offset, and the motor end includes motor friction.

    Beyond 2 T_p r_M = 1.8 N*m one tendon is slack.
    """
    still = np.zeros(4)
    signals = Signals(t=np.arange(4.0), tau_m=np.array([0.4, -0.4, 2.4, -2.4]), omega_j=still + 0.5, q_j=still)
    plain = actuator()
    motor, joint = stretching(plain, signals)
    assert motor == pytest.approx(signals.tau_m / 0.020)
    assert joint == pytest.approx(predict(plain, signals) / 0.025)
    loaded = plain.with_effects({"torque_offset": {"offset": 0.3}, "motor_side_friction": {"coulomb": 0.05}})
    assert stretching(loaded, signals)[0] == pytest.approx((signals.tau_m - 0.05) / 0.020)
    assert stretching(loaded, signals)[1] == pytest.approx((predict(loaded, signals) - 0.3) / 0.025)
    slack = stretching(plain.with_effects({"tendon_slack": {}}), signals)[0]
    assert slack == pytest.approx([20.0, -20.0, 2.0 * (120.0 - 45.0), -2.0 * (120.0 - 45.0)])
