"""Reference values of the memoryless effects, alone and in combination, with an agreement of 1e-9 N*m."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.model.actuator import ACTUATOR
from tsa_ctrl.model.predict import predict
from tsa_ctrl.model.signals import Signals

# One row per state with these columns.
COLUMNS = ("tau_m", "omega_j", "q_j", "q_m", "acceleration_j", "temperature", "t")
STATES = (
    (1.0, 0.5, 0.3, 0.375, -1.0, 33.0, 6.0),
    (1.0, -0.5, 0.3, 0.375, -1.0, 33.0, 6.0),
    (-0.5, 0.5, 0.3, 0.375, -1.0, 33.0, 6.0),
    (-0.5, -0.5, 0.3, 0.375, -1.0, 33.0, 6.0),
    (2.4, 0.05, -0.7, -0.875, -1.0, 33.0, 6.0),
    (-2.4, 0.02, -0.7, -0.875, -1.0, 33.0, 6.0),
)

CASES: tuple[tuple[dict[str, dict[str, Any]], tuple[float, ...]], ...] = (
    ({}, (0.700875231823, 1.884101858763, -1.237857586117, -0.054630959177, 2.510359195234, -3.693585822174)),
    (
        {"viscous_friction": {"coefficient": 0.08}},
        (0.660875231823, 1.924101858763, -1.277857586117, -0.014630959177, 2.506359195234, -3.695185822174),
    ),
    (
        {"stribeck_friction": {"static_excess": 0.5, "stribeck_velocity": 0.5, "shape": 1.0}},
        (0.606096773278, 2.013286234042, -1.358440482212, 0.048748978552, 2.34645579416, -4.112555809268),
    ),
    (
        {"stribeck_friction": {"static_excess": 0.6, "stribeck_velocity": 0.3}},
        (0.681530109667, 1.909944653468, -1.262075962684, -0.033661418883, 2.305110115957, -4.223999864238),
    ),
    (
        {"tension_dependent_friction": {"exponent": 0.2, "reference_tension": 45.0}},
        (0.700497968788, 1.851990433318, -1.225669443393, -0.049917539818, 2.709734828106, -3.502815721515),
    ),
    (
        {"load_dependent_friction": {"coefficient": 0.1}},
        (0.637159301658, 2.093446509737, -1.375397317907, -0.049664508342, 2.28214472294, -4.10398424686),
    ),
    (
        {"sheath_asymmetry": {"relative_difference": 0.3}},
        (0.728749378771, 1.81203629877, -1.287087781007, -0.05254136373, 2.610197394564, -3.840481516725),
    ),
    (
        {"direction_asymmetric_friction": {"viscous_difference": 0.08}},
        (0.660875231823, 1.844101858763, -1.277857586117, -0.094630959177, 2.506359195234, -3.695185822174),
    ),
    (
        {"motor_side_friction": {"coulomb": 0.1}},
        (0.571626377294, 2.013350713293, -1.367106440646, 0.074617895353, 2.381110340705, -3.822834676703),
    ),
    (
        {"torque_constant_error": {"relative_error": 0.05}},
        (0.765499659088, 1.948726286028, -1.270169799749, -0.086943172809, 2.665457820669, -3.848684447609),
    ),
    (
        {"torque_saturation": {"limit": 0.8}},
        (0.442377522765, 1.625604149705, -1.237857586117, -0.054630959177, 0.442377522765, -1.625604149705),
    ),
    (
        {"torque_saturation": {"limit": 0.8}, "torque_constant_error": {"relative_error": 0.05}},
        (0.494077064576, 1.677303691516, -1.270169799749, -0.086943172809, 0.494077064576, -1.677303691516),
    ),
    (
        {"torque_offset": {"offset": 0.05}},
        (0.750875231823, 1.934101858763, -1.187857586117, -0.004630959177, 2.560359195234, -3.643585822174),
    ),
    (
        {"torque_ripple": {"amplitude": 0.06, "cycles_per_revolution": 12, "phase": 0.4}},
        (0.624686706937, 1.807913333877, -1.314046111003, -0.130819484063, 2.558832994456, -3.645112022952),
    ),
    (
        {"inertia": {"inertia": 0.02}},
        (0.720875231823, 1.904101858763, -1.217857586117, -0.034630959177, 2.530359195234, -3.673585822174),
    ),
    (
        {"gravity_load": {"amplitude": 0.4, "phase": 0.2}},
        (0.509105016382, 1.692331643322, -1.429627801558, -0.246401174618, 2.702129410676, -3.501815606732),
    ),
    (
        {"joint_stiffness": {"stiffness": 0.5, "rest_angle": 0.1}},
        (0.600875231823, 1.784101858763, -1.337857586117, -0.154630959177, 2.910359195234, -3.293585822174),
    ),
    (
        {"tendon_slack": {}},
        (0.700875231823, 1.884101858763, -1.237857586117, -0.054630959177, 2.313154757411, -3.890790259997),
    ),
    (
        {"pretension_relaxation": {"relaxed_fraction": 0.3, "time_constant": 12.0, "start_time": 0.0}},
        (0.77070974187, 1.814267348716, -1.16802307607, -0.124465469224, 2.580193705281, -3.623751312127),
    ),
    (
        {
            "pretension_relaxation": {
                "relaxed_fraction": 0.1,
                "time_constant": 2.0,
                "start_time": 0.0,
                "law": "logarithmic",
            }
        },
        (0.736493902461, 1.848483188126, -1.202238915479, -0.090249629814, 2.545977865872, -3.657967151536),
    ),
    (
        {"thermal_friction_drift": {"temperature_coefficient": 0.02}},
        (0.618349098519, 1.996218613581, -1.342576685556, 0.035292829506, 2.448546496988, -3.826416012051),
    ),
    (
        {"configuration_dependent_bending": {"bending_per_joint_angle": 0.6}},
        (0.576324012374, 2.020904761031, -1.37159756768, 0.072983180977, 2.738676582269, -3.404460945587),
    ),
    (
        {"pulley_eccentricity": {"relative_eccentricity": 0.2, "phase": 0.4}},
        (0.791178476, 2.126856207158, -1.397347536369, -0.061669805212, 2.3619868216, -3.475279973076),
    ),
    (
        {
            "load_dependent_friction": {"coefficient": 0.1},
            "pulley_eccentricity": {"relative_eccentricity": 0.2, "phase": 0.4},
            "gravity_load": {"amplitude": 0.4, "phase": 0.2},
        },
        (0.52748294456, 2.171403348067, -1.744378589184, -0.247833674724, 2.339030962351, -3.669651976865),
    ),
    ({"elongation_coupling": {"curvature_profile": "uniform"}}, (0.665, 1.835, -1.21, -0.04, 2.415, -3.585)),
    (
        {"elongation_coupling": {"curvature_profile": "motor_end"}},
        (0.636743250963, 1.781073147782, -1.176619048096, -0.032289151277, 2.329214730084, -3.473544626903),
    ),
    (
        {"stiffness_nonlinearity": {"quadratic": 100.0}},
        (0.656504233313, 1.928472857274, -1.282228584627, -0.010259960666, 2.465988196724, -3.737956820684),
    ),
    (
        {"velocity_lag": {"time_constant": 0.08}},
        (0.700875231823, 1.884101858763, -1.237857586117, -0.054630959177, 3.693585822174, -2.510359195234),
    ),
    (
        {
            "torque_constant_error": {"relative_error": 0.05},
            "torque_ripple": {"amplitude": 0.06, "cycles_per_revolution": 12, "phase": 0.4},
            "motor_side_friction": {"coulomb": 0.1},
        },
        (0.560062279672, 2.001786615671, -1.475607179165, -0.033882843166, 2.584682765361, -3.929459502917),
    ),
    (
        {
            "stribeck_friction": {"static_excess": 0.6, "stribeck_velocity": 0.3},
            "thermal_friction_drift": {"temperature_coefficient": 0.02},
            "tension_dependent_friction": {"exponent": 0.2, "reference_tension": 45.0},
            "sheath_asymmetry": {"relative_difference": -0.4},
        },
        (0.569907304564, 2.095191839178, -1.28005872436, 0.080224823697, 2.370015363816, -3.765177901213),
    ),
    (
        {
            "configuration_dependent_bending": {"bending_per_joint_angle": 0.6},
            "pretension_relaxation": {"relaxed_fraction": 0.3, "time_constant": 12.0, "start_time": 0.0},
            "load_dependent_friction": {"coefficient": 0.1},
            "viscous_friction": {"coefficient": 0.08},
            "torque_offset": {"offset": 0.05},
        },
        (0.611439770453, 2.240716695451, -1.419264258394, 0.07883949623, 2.571428584001, -3.690673428285),
    ),
    (
        {
            "tendon_slack": {},
            "sheath_asymmetry": {"relative_difference": 0.3},
            "joint_stiffness": {"stiffness": 0.5, "rest_angle": 0.1},
        },
        (0.628749378771, 1.71203629877, -1.387087781007, -0.15254136373, 2.805150040871, -3.645528870419),
    ),
)


def expected_torque(effects: dict[str, dict[str, Any]], state: tuple[float, ...]) -> float:
    log = {name: np.array([value]) for name, value in zip(COLUMNS, state, strict=True)}
    return float(predict(ACTUATOR.with_effects(effects), Signals(**log))[0])


@pytest.mark.parametrize(("effects", "expected"), CASES, ids=["+".join(effects) or "none" for effects, _ in CASES])
def test_joint_torque_equals_the_reference(effects: dict[str, dict[str, Any]], expected: tuple[float, ...]) -> None:
    """Each state of the reference table agrees within 1e-9 N*m in each case."""
    found = [expected_torque(effects, state) for state in STATES]
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-9)


def test_a_joint_that_moves_as_this_one_bends_the_sheath_as_this_one() -> None:
    """The references of configuration_dependent_bending hold for a hip with the same angle, with all or part of the
    gain.
    """
    gain = {"bending_per_joint_angle": 0.6}
    expected = next(values for effects, values in CASES if effects == {"configuration_dependent_bending": gain})
    for effects in (
        {"routing_by_joint": {"hip": 0.6}},
        {"routing_by_joint": {"hip": 0.4}, "configuration_dependent_bending": {"bending_per_joint_angle": 0.2}},
    ):
        for state, reference in zip(STATES, expected, strict=True):
            log = {name: np.array([value]) for name, value in zip(COLUMNS, state, strict=True)}
            found = predict(ACTUATOR.with_effects(effects), Signals(**log, joints={"hip": log["q_j"]}))[0]
            assert found == pytest.approx(reference, abs=1e-9)
