"""Effects with memory, compared with closed forms. The friction state is derived from the joint torque at tau_M = 0."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.model.actuator import ACTUATOR, LOSS, signals, with_effect
from tsa_ctrl.model.effects.memory import PreslidingHysteresis, PreslidingState, integrate, resolution
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.predict import predict

RATE = 1000.0
T = np.arange(4000) / RATE


def triangle(amplitude: float, period: float) -> Array:
    """Return a triangle wave that starts at 0 and rises, (n,)."""
    phase = (T / period + 0.25) % 1.0
    return amplitude * (1.0 - 4.0 * np.abs(phase - 0.5))


def friction_state(tau_j: Array) -> Array:
    """Return z from tau_J = -2 T_p r_J sinh(z x) at tau_M = 0, (n,)."""
    return np.arcsinh(-tau_j / (2.0 * 45.0 * 0.025)) / 0.26


class TestDahl:
    """The Dahl model is dz/ds = (1 - sign(ds) z)/q_p."""

    def test_starts_at_the_direction_when_the_log_starts_moving(self) -> None:
        """z(0) = sigma(0), and z stays there during the motion."""
        model = with_effect("presliding_hysteresis", presliding_distance=0.1)
        found = predict(model, signals(T, np.full_like(T, -0.5), q_j=-0.5 * T))
        np.testing.assert_allclose(found, LOSS, rtol=1e-12)

    @pytest.mark.parametrize(("column", "first_omega"), [("q_j", 0.0), ("q_m", -2.0)])
    def test_starts_at_zero_when_what_it_follows_rests(self, column: str, first_omega: float) -> None:
        """From rest, z = 1 - exp(-s/q_p). A motor that rests for a second may have a joint that moves at once."""
        side = {"q_j": "joint", "q_m": "motor"}[column]
        model = with_effect("presliding_hysteresis", presliding_distance=0.1, displacement=side)
        omega = np.where(T < 1.0, first_omega, 0.5)
        angle = np.where(T < 1.0, 0.0, 0.5 * (T - 1.0))
        z = friction_state(predict(model, signals(T, omega, **{column: angle})))
        np.testing.assert_allclose(z, -np.expm1(-angle / 0.1), atol=1e-12)

    def test_follows_the_motor_where_the_log_has_its_angle(self) -> None:
        """The default displacement is the motor angle, else the joint angle, else the integrated velocity."""
        effect = PreslidingHysteresis(0.1)
        log = signals(T, np.full_like(T, 0.5), q_j=0.5 * T, q_m=0.7 * T)
        np.testing.assert_array_equal(effect.path(log), 0.7 * T)
        np.testing.assert_array_equal(PreslidingHysteresis(0.1, displacement="joint").path(log), 0.5 * T)
        np.testing.assert_allclose(effect.path(signals(T, np.full_like(T, 0.5))), 0.5 * T, atol=1e-12)


def test_virgin_curve_of_maxwell_slip() -> None:
    """From rest each element is a ramp that saturates after q_p i/N: z = mean of min(1, s N/(q_p i))."""
    s = np.linspace(0.0, 0.3, 500)
    expected = np.mean([np.minimum(1.0, s * 4 / (0.2 * i)) for i in (1, 2, 3, 4)], axis=0)
    np.testing.assert_allclose(PreslidingHysteresis(0.2, elements=4).state(s, 0.0), expected, atol=1e-12)


@given(
    st.lists(st.floats(-1.0, 1.0), min_size=2, max_size=40),
    st.floats(0.01, 1.0),
    st.integers(1, 6),
    st.sampled_from([-1.0, 0.0, 1.0]),
)
def test_live_state_equals_the_log_state(path: list[float], distance: float, elements: int, start: float) -> None:
    """The friction state is the same sample by sample and over a whole log. It lies within [-1, 1]."""
    effect = PreslidingHysteresis(distance, elements)
    live = PreslidingState(effect)
    found = np.array([live.update(s, start) for s in path])
    np.testing.assert_allclose(found, effect.state(np.array(path), start), atol=1e-12)
    assert np.all(np.abs(found) <= 1.0 + 1e-12)


class TestBacklash:
    """The torque of the tendons is 0 while abs(q - q_r) < gap."""

    GAP = 0.1

    def tau_j(self, q: Array) -> Array:
        omega = np.gradient(q, T)
        return predict(with_effect("backlash", gap=self.GAP), signals(T, omega, q_j=q))

    def test_dead_interval_has_the_width_of_the_gap(self) -> None:
        """After each reversal of a triangle wave of 1.2 rad/s, no torque reaches the joint for gap/1.2 s."""
        q = triangle(0.3, 1.0)
        dead = self.tau_j(q) == 0.0
        starts = np.flatnonzero(dead[1:] & ~dead[:-1]) + 1
        ends = np.flatnonzero(~dead[1:] & dead[:-1]) + 1
        assert T[starts] == pytest.approx([0.25, 0.75, 1.25, 1.75, 2.25, 2.75, 3.25, 3.75], abs=0.0015)
        assert (ends - starts)[:7] / RATE == pytest.approx(np.full(7, self.GAP / 1.2), abs=0.0015)

    @pytest.mark.parametrize(("drop", "opens"), [(0, False), (2, False), (4, True)])
    def test_only_three_counts_or_more_are_a_reversal(self, drop: int, opens: bool) -> None:
        """A log that starts with motion starts with the backlash closed. An encoder may dither by two counts."""
        count = 1e-3
        q = count * np.round(0.2 * T / count)
        q[2000:2010] -= drop * count
        assert np.any(self.tau_j(q) == 0.0) == opens

    def test_joint_side_is_felt_inside_the_play(self) -> None:
        """Only the torque of the tendons vanishes."""
        q = triangle(0.3, 1.0)
        model = ACTUATOR.with_effects({"backlash": {"gap": self.GAP}, "torque_offset": {"offset": 0.3}})
        found = predict(model, signals(T, np.gradient(q, T), q_j=q))
        assert found[300] == pytest.approx(0.3)


def test_resolution_of_an_angle() -> None:
    """It is the step of a grid, two to five times the noise of angles that lie on no grid, and 0 at standstill."""
    count = 2.0 * np.pi / 8192
    assert resolution(count * np.round(triangle(0.3, 1.0) / count)) == pytest.approx(count, rel=1e-6)
    noise = np.random.default_rng(1).normal(scale=1e-4, size=T.size)
    assert 2e-4 < resolution(triangle(0.3, 1.0) + noise) < 5e-4
    assert resolution(np.full(100, 0.2)) == 0.0


class TestTransportDelay:
    """The measured tau_J is delayed."""

    @pytest.mark.parametrize("delay", [0.0, 0.004, 0.0043, 0.01237])
    def test_ramp_is_shifted_exactly(self, delay: float) -> None:
        """A straight line is shifted exactly by any fraction of a sample."""
        log = signals(T, np.ones_like(T), tau_m=0.2 * T)
        prompt, late = predict(ACTUATOR, log), predict(with_effect("transport_delay", delay=delay), log)
        slope = (prompt[1] - prompt[0]) * RATE
        later = delay < T
        np.testing.assert_allclose(late[later], prompt[later] - slope * delay, atol=1e-12)
        np.testing.assert_allclose(late[~later], prompt[0], atol=1e-12)


class TestVelocityLag:
    """The true omega is obtained from the logged output of 1/(1 + T s)."""

    LAG, W = 0.02, 2.0 * np.pi

    def logged(self) -> tuple[Array, Array, Array]:
        """Return the true velocity sin(w t), and the settled output of a first-order lag for it and its derivative."""
        gain, phase = 1.0 / np.hypot(1.0, self.W * self.LAG), np.arctan(self.W * self.LAG)
        return np.sin(self.W * T), gain * np.sin(self.W * T - phase), gain * self.W * np.cos(self.W * T - phase)

    def test_true_velocity_returns(self) -> None:
        """Viscous friction acts on the true velocity."""
        true, logged, derivative = self.logged()
        effects = {"velocity_lag": {"time_constant": self.LAG}, "viscous_friction": {"coefficient": 0.5}}
        found = predict(ACTUATOR.with_effects(effects), signals(T, logged, acceleration_j=derivative))
        moving = np.abs(true) > 1e-9
        np.testing.assert_allclose(found[moving], (-LOSS * np.sign(true) - 0.5 * true)[moving], atol=1e-9)

    def test_derivative_may_come_from_the_log(self) -> None:
        """Without an acceleration column the reversals are found within a few milliseconds."""
        true, logged, _ = self.logged()
        found = predict(with_effect("velocity_lag", time_constant=self.LAG), signals(T, logged))
        wrong = np.abs(found + LOSS * np.sign(true)) > 1e-9
        assert np.mean(wrong[100:-100]) < 0.005


class TestRelaxation:
    """T_p *= 1 - c (1 - exp(-(t - t_0)/T)), or T_p *= 1 - c log10(1 + (t - t_0)/T)."""

    def half_loop(self, **parameters: object) -> Array:
        t = T + 7.0
        model = with_effect("pretension_relaxation", relaxed_fraction=0.3, time_constant=2.0, **parameters)
        return -predict(model, signals(t, np.ones_like(t))) / LOSS

    def test_starts_with_the_log(self) -> None:
        """t_0 is the log's first sample unless it is given."""
        np.testing.assert_allclose(self.half_loop(), 1.0 - 0.3 * (1.0 - np.exp(-T / 2.0)), rtol=1e-12)

    def test_nothing_before_its_start(self) -> None:
        """A start inside the log does not change earlier samples."""
        found = self.half_loop(start_time=9.0)
        np.testing.assert_allclose(found[T < 2.0], 1.0, rtol=1e-12)
        np.testing.assert_allclose(found[T > 2.0], 1.0 - 0.3 * -np.expm1(-(T[T > 2.0] - 2.0) / 2.0), rtol=1e-12)


def test_integrated_angle_is_trapezoidal() -> None:
    """The integral is exact for a linear velocity on any grid."""
    t = np.array([0.0, 0.1, 0.35, 0.4])
    np.testing.assert_allclose(integrate(2.0 * t, t), t**2, atol=1e-15)
