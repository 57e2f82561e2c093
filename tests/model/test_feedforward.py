"""The live inverse: with its command, the model delivers the desired torque."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.model.actuator import ACTUATOR, with_effect
from tests.model.test_curvature import S_BENT
from tsa_ctrl.model.catalogue import CATALOGUE
from tsa_ctrl.model.curvature import NAMED
from tsa_ctrl.model.feedforward import Feedforward
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.predict import predict
from tsa_ctrl.model.signals import Signals

NAN = math.nan
PERIOD = 1e-3


def numbers(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_subnormal=False)


PROFILES = st.sampled_from([*NAMED, S_BENT])
FORMULAS = st.sampled_from(
    [
        "k*sin(3*q_j)",
        "k*tanh(tau) + k*abs(omega_j)",
        "k*sign(tau)*0 + k*tau",
        "k*(tau - lag(tau, 0.2)) + 0.1*ring(q_j, 3, 0.2)",
        "k*(ring(tau, 6, 0.1) - tau)*cos(q_j) + 0.2*k*dahl(tau + k, 0.3)",
    ]
)
PARAMETERS: dict[str, dict[str, st.SearchStrategy[Any]]] = {
    "torque_constant_error": {"relative_error": numbers(-0.5, 0.5)},
    "torque_ripple": {
        "amplitude": numbers(0.0, 0.1),
        "cycles_per_revolution": st.integers(1, 24),
        "phase": numbers(-3.1, 3.1),
    },
    "motor_side_friction": {"coulomb": numbers(0.0, 0.2)},
    "configuration_dependent_bending": {"bending_per_joint_angle": numbers(-1.0, 1.0)},
    "stiffness_nonlinearity": {"quadratic": numbers(-200.0, 200.0)},
    "pretension_relaxation": {
        "relaxed_fraction": numbers(0.0, 0.5),
        "time_constant": numbers(0.1, 100.0),
        "law": st.sampled_from(["exponential", "logarithmic"]),
    },
    "stribeck_friction": {
        "static_excess": numbers(0.0, 1.0),
        "stribeck_velocity": numbers(0.01, 2.0),
        "shape": numbers(0.5, 2.0),
    },
    "thermal_friction_drift": {"temperature_coefficient": numbers(-0.02, 0.02)},
    "tension_dependent_friction": {"exponent": numbers(0.0, 0.5)},
    "presliding_hysteresis": {"presliding_distance": numbers(0.005, 0.5), "elements": st.integers(1, 6)},
    "sheath_asymmetry": {"relative_difference": numbers(-0.8, 0.8)},
    "tendon_slack": {},
    "elongation_coupling": {"curvature_profile": PROFILES},
    "load_dependent_friction": {"coefficient": numbers(0.0, 0.5)},
    "pulley_eccentricity": {"relative_eccentricity": numbers(0.0, 0.5), "phase": numbers(-3.0, 3.0)},
    "viscous_friction": {"coefficient": numbers(0.0, 0.3)},
    "direction_asymmetric_friction": {"viscous_difference": numbers(-0.2, 0.2)},
    "inertia": {"inertia": numbers(0.0, 0.05)},
    "gravity_load": {"amplitude": numbers(0.0, 1.0), "phase": numbers(-3.0, 3.0)},
    "joint_stiffness": {"stiffness": numbers(0.0, 1.0), "rest_angle": numbers(-0.5, 0.5)},
    "torque_offset": {"offset": numbers(-0.3, 0.3)},
    "custom": {"expression": FORMULAS, "stage": st.sampled_from(["joint", "motor"]), "k": numbers(-0.4, 0.4)},
    # effects that do not change the torque
    "series_spring": {"stiffness": numbers(1e3, 1e5), "end": st.just("joint")},
    "tendon_creep": {"length": numbers(-1e-3, 1e-3), "time_constant": numbers(0.1, 100.0)},
    "pulley_slip": {"length": numbers(-1e-3, 1e-3), "time": numbers(0.0, 1.0)},
    "joint_play": {"gap": numbers(1e-4, 0.1)},
}
INVERTIBLE = {name: st.fixed_dictionaries(parameters) for name, parameters in PARAMETERS.items()}
NOT_INVERTIBLE = {
    "transport_delay",
    "torque_sensor_lag",
    "torque_saturation",
    "backlash",
    "velocity_lag",
    "routing_by_joint",  # is handled as [routing]
    "pretension_per_joint_angle",  # the loop has no angles of other joints
}


class Motion:
    """One second of joint motion with several reversals, and a desired torque."""

    t = np.arange(200) * 5e-3
    q_j = 0.4 * np.sin(2.0 * np.pi * 1.3 * t + 0.2) + 0.1 * np.sin(2.0 * np.pi * 4.1 * t)
    omega_j = 0.4 * 8.168 * np.cos(2.0 * np.pi * 1.3 * t + 0.2) + 0.1 * 25.761 * np.cos(2.0 * np.pi * 4.1 * t)
    acceleration_j = np.gradient(omega_j, t)
    q_m = 1.3 * q_j
    temperature = 25.0 + 10.0 * t
    theta = 2.6 + 0.1 * np.sin(3.0 * t)
    tau_j_des = 0.7 * np.sin(2.0 * np.pi * 0.9 * t)


def command(model: TendonSheath, scale: float = 1.0) -> tuple[Array, Array]:
    """Return tau_M (n,) and the two bounds of the domain (n, 2), for each sample of the motion."""
    feedforward = Feedforward(model, 5e-3)
    columns = (
        scale * Motion.tau_j_des,
        np.sign(Motion.omega_j),
        Motion.omega_j,
        Motion.q_j,
        Motion.q_m,
        Motion.temperature,
        Motion.theta,
        Motion.t,
        Motion.acceleration_j,
    )
    rows = zip(*(c.tolist() for c in columns), strict=True)
    pairs = [(feedforward.update(*row), *feedforward.domain()) for row in rows]
    found = np.array(pairs)
    return found[:, 0], found[:, 1:]


def delivered(model: TendonSheath, tau_m: Array) -> Array:
    names = ("t", "omega_j", "q_j", "q_m", "temperature", "theta", "acceleration_j")
    return predict(model, Signals(tau_m=tau_m, **{name: getattr(Motion, name) for name in names}))


def assert_round_trip(effects: dict[str, dict[str, Any]], scale: float = 1.0) -> None:
    """Require that the desired torque is delivered wherever the inverse is inside the model's domain."""
    if "elongation_coupling" in effects:
        for name in CATALOGUE["elongation_coupling"].excludes:
            effects.pop(name, None)
    model = ACTUATOR.with_effects(effects)
    tau_m, limit = command(model, scale)
    assert np.all(np.isfinite(tau_m))
    inside = (0.999 * limit[:, 0] < tau_m) & (tau_m < 0.999 * limit[:, 1])
    assert scale > 0.2 or inside.any()
    error = (delivered(model, tau_m) - scale * Motion.tau_j_des)[inside]
    np.testing.assert_allclose(error, 0.0, atol=1e-9)


def test_effects_are_inverted_or_declared() -> None:
    """Each effect of the catalogue is in one of the two lists."""
    assert set(INVERTIBLE) | NOT_INVERTIBLE == set(CATALOGUE)


@pytest.mark.parametrize("name", list(INVERTIBLE))
@settings(max_examples=15, deadline=None)
@given(data=st.data())
def test_each_effect_is_inverted(name: str, data: st.DataObject) -> None:
    """The model delivers the desired torque for any parameters."""
    assert_round_trip({name: data.draw(INVERTIBLE[name])})


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(st.data())
def test_any_stack_is_inverted(data: st.DataObject) -> None:
    """Any combination of invertible effects is inverted, at any scale of the desired torque."""
    names = data.draw(st.sets(st.sampled_from(sorted(INVERTIBLE)), min_size=2))
    assert_round_trip({name: data.draw(INVERTIBLE[name]) for name in sorted(names)}, data.draw(st.floats(0.0, 4.0)))


SIGNALS = st.one_of(st.floats(allow_nan=True, allow_infinity=True), st.sampled_from([0.0, 1e308, -1e308, 5e-324]))


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(
    st.sets(st.sampled_from(sorted(CATALOGUE))),
    st.lists(st.tuples(st.floats(allow_nan=False, allow_infinity=False), *[SIGNALS] * 8), min_size=1, max_size=5),
    st.data(),
)
def test_command_is_finite(names: set[str], rows: list[tuple[float, ...]], data: st.DataObject) -> None:
    """For any measurements, even huge, infinite or nan, a finite desired torque gives a finite command."""
    if "elongation_coupling" in names:
        names -= set(CATALOGUE["elongation_coupling"].excludes)
    others = {
        "torque_saturation": {"limit": 0.5},
        "torque_sensor_lag": {"time_constant": 0.05},
        "transport_delay": {"delay": 0.01},
        "backlash": {"gap": 0.1},
        "velocity_lag": {"time_constant": 0.01},
    }
    effects = {name: others.get(name) or data.draw(INVERTIBLE.get(name, st.just({}))) for name in sorted(names)}
    feedforward = Feedforward(ACTUATOR.with_effects(effects), PERIOD)
    assert all(math.isfinite(feedforward.update(*row)) for row in rows)


class TestDomain:
    """The domain is abs(tau_M) <= 2 T_p r_M unless the model includes slack."""

    def test_command_ends_at_the_domain(self) -> None:
        """The bound is 1.8 N*m in both directions."""
        feedforward = Feedforward(ACTUATOR, PERIOD)
        assert feedforward.domain() == pytest.approx((-1.8, 1.8))
        assert feedforward.update(50.0, 1.0, 0.5) == pytest.approx(1.8)
        assert feedforward.update(-50.0, 1.0, 0.5) == pytest.approx(-1.8)

    def test_slack_has_none(self) -> None:
        """Beyond slack, one tendon carries the whole torque."""
        feedforward = Feedforward(with_effect("tendon_slack"), PERIOD)
        assert feedforward.domain() == (-math.inf, math.inf)
        assert feedforward.update(5.0, 1.0, 0.5) == pytest.approx(5.0 * 0.8 * math.exp(0.26))

    def test_motor_side_effects_come_on_top(self) -> None:
        """The bound at the pulley is 1.8 N*m.

        Motor friction of 0.1 N*m raises the bound in the direction of motion and lowers it in the other direction.
        """
        feedforward = Feedforward(with_effect("motor_side_friction", coulomb=0.1), PERIOD)
        assert feedforward.update(50.0, 1.0, 0.5) == pytest.approx(1.9)
        assert feedforward.update(-50.0, 1.0, 0.5) == pytest.approx(-1.7)
        assert feedforward.domain() == pytest.approx((-1.7, 1.9))


class TestMeasurements:
    """A value that is not measured is nan."""

    def test_missing_value_keeps_the_last(self) -> None:
        """One lost encoder frame does not cause a torque step."""
        feedforward = Feedforward(with_effect("joint_stiffness", stiffness=0.5), PERIOD)
        before = feedforward.update(0.1, 1.0, 0.5, 0.3)
        assert feedforward.update(0.1, 1.0, 0.5, NAN) == before

    def test_effect_without_its_measurement_is_left_out(self) -> None:
        """It is omitted until the first value arrives."""
        feedforward = Feedforward(with_effect("gravity_load", amplitude=0.5), PERIOD)
        plain = Feedforward(ACTUATOR, PERIOD)
        assert feedforward.update(0.1, 1.0, 0.5) == pytest.approx(plain.update(0.1, 1.0, 0.5), rel=1e-14)
        assert feedforward.left_out == ("gravity_load",)
        assert feedforward.update(0.1, 1.0, 0.5, 0.3) != plain.update(0.1, 1.0, 0.5, 0.3)
        assert feedforward.left_out == ()

    def test_friction_state_survives_a_late_measurement(self) -> None:
        """A later temperature does not reset the presliding state."""
        model = ACTUATOR.with_effects(
            {
                "presliding_hysteresis": {"presliding_distance": 0.1},
                "thermal_friction_drift": {"temperature_coefficient": 0.0},
            }
        )
        feedforward = Feedforward(model, PERIOD)
        feedforward.update(0.0, 0.0, 0.0, q_m=0.0)
        moved = feedforward.update(0.0, 1.0, 0.5, q_m=0.05)
        assert moved > 0.0
        assert feedforward.update(0.0, 1.0, 0.5, q_m=0.05, temperature=25.0) == pytest.approx(moved, rel=1e-12)

    def test_nan_wish_is_passed_on(self) -> None:
        """A NaN desired torque gives a NaN command, which the limiter rejects."""
        assert math.isnan(Feedforward(ACTUATOR, PERIOD).update(NAN, 1.0, 0.5))

    @pytest.mark.parametrize(("every", "timed"), [(1, False), (3, True)])
    def test_acceleration_is_derived_when_absent(self, every: int, timed: bool) -> None:
        """A steady 2 rad/s^2 is determined, also where only every third period has an update, with its time."""
        feedforward = Feedforward(with_effect("inertia", inertia=0.1), PERIOD)
        for i in range(0, 300, every):
            found = feedforward.update(0.0, 1.0, 2.0 * i * PERIOD, t=i * PERIOD if timed else NAN)
        assert found == pytest.approx(Feedforward(ACTUATOR, PERIOD).update(0.2, 1.0, 0.4), rel=1e-6)


class TestSettings:
    """Changes while running, and reset."""

    def test_new_values_count_from_the_next_update(self) -> None:
        """Both friction angle and pretension take effect."""
        feedforward = Feedforward(ACTUATOR, PERIOD)
        feedforward.set(friction_angle=0.3, pretension=50.0)
        assert feedforward.update(0.0, 1.0, 0.5) == pytest.approx(0.020 * 2.0 * 50.0 * math.tanh(0.3))
        assert (feedforward.friction_angle, feedforward.pretension) == pytest.approx((0.3, 50.0))

    def test_direction_is_continuous(self) -> None:
        """Half a direction gives tanh of half the angle in the motor torque, and standstill gives no friction term."""
        feedforward = Feedforward(ACTUATOR, PERIOD)
        assert feedforward.update(0.0, 0.5, 0.1) == pytest.approx(0.020 * 2.0 * 45.0 * math.tanh(0.13))
        assert feedforward.update(0.0, 0.0, 0.0) == 0.0

    def test_reset_forgets(self) -> None:
        """The friction state and the start of the relaxation are reset."""
        model = ACTUATOR.with_effects(
            {
                "presliding_hysteresis": {"presliding_distance": 0.1},
                "pretension_relaxation": {"relaxed_fraction": 0.4, "time_constant": 1.0},
            }
        )
        feedforward = Feedforward(model, PERIOD)
        first = [feedforward.update(0.2, 1.0, 0.5, q_m=0.02 * i, t=3.0 + i) for i in range(5)]
        feedforward.reset()
        again = [feedforward.update(0.2, 1.0, 0.5, q_m=0.02 * i, t=9.0 + i) for i in range(5)]
        assert again == pytest.approx(first, rel=1e-12)


class TestNotes:
    """Notes at startup."""

    @pytest.mark.parametrize(
        ("name", "parameters", "word"),
        [
            ("transport_delay", {"delay": 0.005}, "0.005 s"),
            ("torque_sensor_lag", {"time_constant": 0.05}, "0.05 s"),
            ("torque_saturation", {"limit": 1.5}, "1.5 N*m"),
            ("backlash", {"gap": 0.02}, "0.02 rad"),
            ("velocity_lag", {"time_constant": 0.01}, "direction"),
            ("inertia", {"inertia": 0.01}, "lags by"),
        ],
    )
    def test_what_cannot_be_compensated(self, name: str, parameters: dict[str, float], word: str) -> None:
        """A note states the effect and the reason."""
        (note,) = Feedforward(with_effect(name, **parameters), PERIOD).notes
        assert note.startswith(f"{name}: ")
        assert word in note

    def test_only_a_missing_measurement_needs_words(self) -> None:
        """The gravity load of an axis without a joint angle is unknown. A compensated effect gives no note."""
        (note,) = Feedforward(with_effect("gravity_load", amplitude=0.5), PERIOD, signals=("q_m",)).notes
        assert note == "gravity_load: not compensated, this axis does not measure q_j"
        assert Feedforward(with_effect("viscous_friction", coefficient=0.1), PERIOD).notes == ()
