"""Prediction over a log: columns, standstill, bending, domain, and the plain drive."""

from __future__ import annotations

import dataclasses
import math
import subprocess
import sys

import numpy as np
import pytest

from tests.model.actuator import ACTUATOR, LOSS, SLOPE, signals, with_effect
from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.composition import Stack
from tsa_ctrl.model.parameters import GearedDrive, RigidDrive
from tsa_ctrl.model.predict import BLOCK, beyond_slack, predict
from tsa_ctrl.model.signals import Signals

T = np.arange(2000) / 1000.0


class TestStandstill:
    """The direction sigma at omega = 0."""

    def test_keeps_the_last_direction(self) -> None:
        """Before the first motion, the first direction is used."""
        omega = np.array([0.0, 0.0, -1.0, 0.0, 2.0, 0.0, 0.0])
        expected = -LOSS * np.array([-1.0, -1.0, -1.0, -1.0, 1.0, 1.0, 1.0])
        np.testing.assert_allclose(predict(ACTUATOR, signals(np.arange(7.0), omega)), expected, rtol=1e-12)

    def test_log_without_motion_is_in_the_middle_of_the_band(self) -> None:
        """Without any motion, the friction is 0."""
        found = predict(ACTUATOR, signals(np.arange(3.0), np.zeros(3), tau_m=np.ones(3)))
        np.testing.assert_allclose(found, 1.25, rtol=1e-12)


class TestBending:
    """The theta column, and bending that depends on the joint angle."""

    def test_theta_changes_friction_angle_and_pretension(self) -> None:
        """x = mu Theta, and T_p0 = value + 35 N/rad (Theta - bending_angle)."""
        theta = np.array([2.6, 2.8, 3.0])
        found = predict(ACTUATOR, signals(np.arange(3.0), np.ones(3), theta=theta))
        expected = -2.0 * (45.0 + 35.0 * (theta - 2.6)) * 0.025 * np.sinh(0.1 * theta)
        np.testing.assert_allclose(found, expected, rtol=1e-12)

    def test_series_element_holds_the_pretension(self) -> None:
        """k_t is halved by a series spring as stiff as the tendon."""
        soft = dataclasses.replace(ACTUATOR, series_stiffness=50e3)
        found = predict(soft, signals(np.arange(1.0), np.ones(1), theta=np.array([3.0])))
        np.testing.assert_allclose(found, -2.0 * (45.0 + 17.5 * 0.4) * 0.025 * np.sinh(0.3), rtol=1e-12)

    def test_straightened_sheath_is_slack(self) -> None:
        """A T_p0 below 0 is set to 0, so the joint torque is 0 without motor torque."""
        found = predict(ACTUATOR, signals(np.arange(1.0), np.ones(1), theta=np.array([1.0])))
        assert found == pytest.approx([0.0])

    def test_joint_angle_adds_to_the_column(self) -> None:
        """The effect gives Theta = theta + k q."""
        effect = with_effect("configuration_dependent_bending", bending_per_joint_angle=0.5)
        by_effect = predict(effect, signals(T, np.ones_like(T), q_j=0.4 * T, theta=np.full_like(T, 2.5)))
        by_column = predict(ACTUATOR, signals(T, np.ones_like(T), theta=2.5 + 0.2 * T))
        np.testing.assert_allclose(by_effect, by_column, rtol=1e-12)

    def test_friction_never_drives(self) -> None:
        """If an effect makes the bending angle negative, the sheath is straight."""
        effect = with_effect("configuration_dependent_bending", bending_per_joint_angle=-9.0)
        found = predict(effect, signals(np.arange(1.0), np.ones(1), q_j=np.array([1.0]), tau_m=np.ones(1)))
        assert found == pytest.approx([1.25])


class TestDomain:
    """The range in which one tendon is slack."""

    def test_slack_is_continuous_and_has_one_tendon_beyond(self) -> None:
        """Above 2 T_p r_M the slope in positive direction is r_J/r_M exp(-x)."""
        tau_m = np.array([1.8 - 1e-9, 1.8 + 1e-9, 2.0, 2.1])
        log = signals(np.arange(4.0), np.ones(4), tau_m=tau_m)
        found = predict(with_effect("tendon_slack"), log)
        assert found[1] == pytest.approx(found[0], abs=1e-8)
        assert (found[3] - found[2]) / 0.1 == pytest.approx(1.25 * math.exp(-0.26), rel=1e-9)

    def test_fraction_beyond(self) -> None:
        """The range is abs(tau_m) >= 2 T_p r_M = 1.8 N*m, including the bound."""
        log = signals(np.arange(5.0), np.ones(5), tau_m=np.array([0.0, 1.79, 1.8, -1.9, -1.0]))
        assert beyond_slack(ACTUATOR, log) == pytest.approx(0.4)


class TestColumns:
    """Effects name their required columns."""

    def test_missing_column_is_one_line(self) -> None:
        """The error states the effect and the column."""
        with pytest.raises(UsageError, match=r"\[effects.gravity_load\] needs column q_j, which the log does not have"):
            predict(with_effect("gravity_load", amplitude=1.0), signals(T, T))

    def test_motor_displacement_needs_the_motor_angle(self) -> None:
        """An explicit motor displacement is not replaced by the joint's."""
        model = with_effect("presliding_hysteresis", presliding_distance=0.1, displacement="motor")
        with pytest.raises(UsageError, match="needs column q_m"):
            predict(model, signals(T, T, q_j=T))


class TestComposition:
    """Effects are applied in the order of their stages."""

    def test_full_model_stands_alone(self) -> None:
        """It cannot be combined with slack, for example."""
        with pytest.raises(UsageError, match="cannot be combined"):
            Stack.of({"elongation_coupling": {"curvature_profile": "uniform"}, "tendon_slack": {}})

    def test_order_in_the_file_does_not_matter(self) -> None:
        """Composition follows the order of the catalogue."""
        a, b = {"torque_constant_error": {"relative_error": 0.1}}, {"motor_side_friction": {"coulomb": 0.05}}
        log = signals(T, np.ones_like(T), tau_m=T)
        forward, backward = (predict(ACTUATOR.with_effects(e), log) for e in ({**a, **b}, {**b, **a}))
        np.testing.assert_array_equal(forward, backward)
        np.testing.assert_allclose(forward, SLOPE * (1.1 * T - 0.05) - LOSS, rtol=1e-12)

    def test_no_prediction_loads_the_compiler(self) -> None:
        """The startup of commands that predict stays fast, even for effects with memory."""
        script = (
            "import sys, numpy as np\n"
            "from tests.model.actuator import ACTUATOR, signals\n"
            "from tsa_ctrl.model.predict import predict\n"
            "from tsa_ctrl.model.feedforward import Feedforward\n"
            "memory = {'presliding_hysteresis': {'presliding_distance': 0.1}, 'backlash': {'gap': 0.1}}\n"
            "for model in (ACTUATOR, ACTUATOR.with_effects(memory)):\n"
            "    predict(model, signals(np.arange(2.0), np.ones(2), q_j=np.arange(2.0)))\n"
            "sys.exit('numba' in sys.modules or 'scipy' in sys.modules)\n"
        )
        assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 0


def test_long_logs_are_predicted_as_short_ones() -> None:
    """The prediction of a long log in blocks has no discontinuity."""
    t = np.arange(3 * BLOCK + 17) * 1e-3
    omega, tau_m, theta = np.cos(3.0 * t), np.sin(2.0 * t), 2.6 + 0.1 * np.sin(t)
    model = ACTUATOR.with_effects(
        {
            "viscous_friction": {"coefficient": 0.1},
            "stribeck_friction": {"static_excess": 0.4, "stribeck_velocity": 0.3},
        }
    )
    whole = predict(model, signals(t, omega, tau_m=tau_m, theta=theta))
    pieces = [slice(start, start + 1000) for start in range(0, len(t), 1000)]
    parts = [predict(model, signals(t[p], omega[p], tau_m=tau_m[p], theta=theta[p])) for p in pieces]
    np.testing.assert_allclose(whole, np.concatenate(parts), atol=1e-14)


class TestRigidDrive:
    """tau_M = J domega/dt + tau_c sign(omega) + b omega + c; an effect tau_J -= f enters as tau_M += f."""

    W = 2.0 * np.pi
    OMEGA = np.sin(W * T)
    LOG = Signals(t=T, tau_m=np.zeros_like(T), omega_j=np.zeros_like(T), omega_m=OMEGA)

    def test_base_equation(self) -> None:
        """The terms are inertia, Coulomb, viscous and offset. The acceleration is derived with zero phase."""
        found = predict(RigidDrive(0.01, 0.2, 0.03, 0.05), self.LOG)
        expected = 0.01 * self.W * np.cos(self.W * T) + 0.2 * np.sign(self.OMEGA) + 0.03 * self.OMEGA + 0.05
        np.testing.assert_allclose(found[100:-100], expected[100:-100], atol=1e-4 * 0.01 * self.W + 1e-12)

    def test_joint_effects_are_added(self) -> None:
        """tau_J -= b omega becomes tau_M += b omega; tau_J += c becomes tau_M -= c."""
        effects = {"viscous_friction": {"coefficient": 0.4}, "torque_offset": {"offset": 0.1}}
        np.testing.assert_allclose(predict(RigidDrive(effects=effects), self.LOG), 0.4 * self.OMEGA - 0.1, atol=1e-15)

    def test_reported_torque_is_predicted(self) -> None:
        """A drive whose torque constant is 10 % too large reports a torque that is smaller by this factor."""
        effects = {"torque_constant_error": {"relative_error": 0.1}}
        found = predict(RigidDrive(viscous_friction=0.2, effects=effects), self.LOG)
        np.testing.assert_allclose(found * 1.1, 0.2 * self.OMEGA, atol=1e-15)

    def test_load_dependent_friction_satisfies_its_equation(self) -> None:
        """The torque satisfies tau_M = L + sigma k abs(tau_M), with the torque L without this effect."""
        effects = {"load_dependent_friction": {"coefficient": 0.2}, "gravity_load": {"amplitude": 1.0, "phase": 0.3}}
        log = dataclasses.replace(self.LOG, q_m=0.5 * np.sin(3.0 * T))
        found = predict(RigidDrive(effects=effects), log)
        load = np.sin(0.5 * np.sin(3.0 * T) + 0.3)
        residual = found - load - 0.2 * np.sign(self.OMEGA) * np.abs(found)
        np.testing.assert_allclose(residual[1:-1], 0.0, atol=1e-12)

    def test_velocity_may_come_from_the_angle(self) -> None:
        """q_m replaces omega_m."""
        log = signals(T, np.zeros_like(T), q_m=-np.cos(self.W * T) / self.W)
        found = predict(RigidDrive(viscous_friction=0.5), log)
        np.testing.assert_allclose(found[100:-100], 0.5 * self.OMEGA[100:-100], atol=1e-4)

    def test_presliding_follows_the_motor(self) -> None:
        """The Coulomb torque builds up over the motor's displacement."""
        effects = {"presliding_hysteresis": {"presliding_distance": 0.1, "elements": 1}}
        log = signals(T, np.zeros_like(T), omega_m=np.where(T > 0.0, 0.5, 0.0), q_m=0.5 * T)
        found = predict(RigidDrive(coulomb_friction=0.2, effects=effects), log)
        np.testing.assert_allclose(found, 0.2 * -np.expm1(-0.5 * T / 0.1), atol=1e-12)

    def test_needs_motor_motion(self) -> None:
        """The error lists the columns."""
        with pytest.raises(UsageError, match="omega_m or q_m"):
            predict(RigidDrive(), signals(T, T))


class TestGearedDrive:
    """tau_J = eta^s N tau_M - tau_c sigma - b omega_J, with the sign s of tau_M omega_J."""

    W = 2.0 * np.pi
    OMEGA = np.sin(W * T + 0.1)
    TAU_M = 0.3 * np.cos(3.0 * T + 0.2)
    LOG = Signals(t=T, tau_m=TAU_M, omega_j=OMEGA, q_j=-np.cos(W * T + 0.1) / W)

    def test_base_equation(self) -> None:
        """The efficiency divides the torque if the joint drives the motor."""
        found = predict(GearedDrive(50.0, 0.8, 0.5, 0.2), self.LOG)
        gain = np.where(self.TAU_M * self.OMEGA > 0.0, 0.8, 1.25)
        expected = gain * 50.0 * self.TAU_M - 0.5 * np.sign(self.OMEGA) - 0.2 * self.OMEGA
        np.testing.assert_allclose(found, expected, atol=1e-12)

    def test_effects_of_the_catalogue_apply(self) -> None:
        """Effects apply at the motor before the gear, or at the joint behind it."""
        effects = {"torque_saturation": {"limit": 0.2}, "viscous_friction": {"coefficient": 0.4}}
        found = predict(GearedDrive(9.0, effects=effects), self.LOG)
        np.testing.assert_allclose(found, 9.0 * np.clip(self.TAU_M, -0.2, 0.2) - 0.4 * self.OMEGA, atol=1e-12)

    def test_a_formula_reads_the_torque_behind_the_gear(self) -> None:
        """The formula has the stage "joint"."""
        effects = {"custom": {"expression": "0.1*tau", "stage": "joint"}}
        np.testing.assert_allclose(predict(GearedDrive(9.0, effects=effects), self.LOG), 0.9 * 9.0 * self.TAU_M)


class TestTorqueSensorLag:
    """The reported torque is the true one through 1/(1 + T s)."""

    def test_a_step_rises_to_63_percent_in_one_time_constant(self) -> None:
        """The drive rests at the first sample. The step lies between two samples of a fine grid."""
        t = np.arange(4000) * 1e-4
        log = signals(t, np.ones_like(t), tau_m=np.where(t < 0.1, 0.0, 1.0))
        effects = {"torque_sensor_lag": {"time_constant": 0.05}}
        found = predict(GearedDrive(1.0, effects=effects), log)
        after = t >= 0.1
        np.testing.assert_allclose(found[~after], 0.0, atol=1e-12)
        np.testing.assert_allclose(found[after], -np.expm1(-(t[after] - 0.1) / 0.05), atol=2e-3)

    def test_none_is_none(self) -> None:
        """A time constant of 0 has no effect."""
        log = signals(T, T, tau_m=np.sin(T))
        effects = {"torque_sensor_lag": {"time_constant": 0.0}}
        np.testing.assert_array_equal(predict(GearedDrive(1.0, effects=effects), log), np.sin(T))
