"""Calculate the transmission with hidden effects from its four tensions on a fine time grid.

No code is shared with the package under test. Each tendon is calculated from the motor through its sheath to the
joint, and the joint torque follows from the tensions at the joint. Effects have the same names and parameters as in
model files.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import memory
from .rig import Rig

Array = np.ndarray
Effects = Mapping[str, Mapping[str, Any]]

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)  # along the sheath: exact to 1e-15 for x up to 3


@dataclass
class Scene:
    """The true signals on one time grid: joint motion, motor angle and torque, wrap angle and temperature (°C)."""

    t: Array
    q: Array
    omega: Array
    acceleration: Array
    q_m: Array
    tau_m: Array
    theta: Array
    temperature: Array
    first: int = 0  # the log's first sample; earlier samples are history
    sigma: Array | None = None  # direction of sliding, if different from the sign of omega
    friction_scale: Array | None = None  # factors of mu and of the pretension for causes outside the catalogue
    pretension_scale: Array | None = None

    def direction(self) -> Array:
        return memory.direction(self.omega) if self.sigma is None else self.sigma


@dataclass
class Tensions:
    """Tensions at both ends of both tendons (N), and the resulting joint torque (N·m)."""

    t1: Array
    t2: Array
    t3: Array
    t4: Array
    joint_torque: Array


def joint_torque(rig: Rig, scene: Scene, effects: Effects, motor_log_angle: bool = True) -> Array:
    """Return the joint torque of a noise-free sensor (N·m), one value per sample of the scene."""
    return simulate(rig, scene, effects, motor_log_angle).joint_torque


def simulate(rig: Rig, scene: Scene, effects: Effects, motor_log_angle: bool = True) -> Tensions:
    """Return the tensions and the joint torque for the chain of motor, tendons, joint and sensor.

    If `motor_log_angle` is set, presliding depends on the motor angle by default, otherwise on the joint angle.
    """
    sigma = sliding_state(scene, effects, motor_log_angle)
    torque = _motor_torque(scene, effects, sigma)
    theta, pretension = _bending_and_pretension(rig, scene, effects)
    x = _friction_angle(rig, scene, effects, theta)
    if "elongation_coupling" in effects:
        tensions = _elongating(rig, torque, pretension, x * sigma, effects["elongation_coupling"]["curvature_profile"])
    else:
        tensions = _sliding(rig, torque, pretension, x, sigma, effects)
    tau = tensions.joint_torque
    if "load_dependent_friction" in effects:
        k = effects["load_dependent_friction"]["coefficient"]
        tau = tau / (1.0 + sigma * k * np.sign(tau))
    if "backlash" in effects:
        tau = tau * memory.engaged(scene.q, scene.direction(), effects["backlash"]["gap"], scene.first)
    if "pulley_eccentricity" in effects:
        off = effects["pulley_eccentricity"]
        tau = tau * (1.0 + off["relative_eccentricity"] * np.sin(scene.q + off.get("phase", 0.0)))
    tau = tau - joint_side(scene, effects)
    if "torque_sensor_lag" in effects:
        tau = memory.first_order_lag(tau, scene.t[1] - scene.t[0], effects["torque_sensor_lag"]["time_constant"])
    if "transport_delay" in effects:
        late = effects["transport_delay"]["delay"]
        tau = np.interp(scene.t - late, scene.t, tau)
    tensions.joint_torque = tau
    return tensions


def sliding_state(scene: Scene, effects: Effects, motor_log_angle: bool = True) -> Array:
    """Return sigma, or the presliding state z that replaces it, (n,)."""
    sigma = scene.direction()
    if "presliding_hysteresis" not in effects:
        return sigma
    effect = effects["presliding_hysteresis"]
    where = effect.get("displacement", "motor" if motor_log_angle else "joint")
    path = scene.q_m if where == "motor" else scene.q
    state = sigma.copy()  # before the log begins, the tendons slide
    start = float(sigma[scene.first]) if scene.omega[scene.first] != 0.0 else 0.0
    elements = int(effect.get("elements", 1))
    path = path[scene.first :]
    if elements == 1:
        state[scene.first :] = memory.bristle(path, effect["presliding_distance"], start)
    else:
        state[scene.first :] = memory.slip_elements(path, effect["presliding_distance"], elements, start)
    return state


def joint_side(scene: Scene, effects: Effects) -> Array:
    """Return the torque lost between the joint pulley and the sensor (N·m)."""
    lost = np.zeros_like(scene.t)
    for name, effect in effects.items():
        match name:
            case "viscous_friction":
                lost += effect["coefficient"] * scene.omega
            case "direction_asymmetric_friction":
                lost += effect["viscous_difference"] * np.abs(scene.omega)
            case "inertia":
                lost += effect["inertia"] * scene.acceleration
            case "gravity_load":
                lost += effect["amplitude"] * np.sin(scene.q + effect.get("phase", 0.0))
            case "joint_stiffness":
                lost += effect["stiffness"] * (scene.q - effect.get("rest_angle", 0.0))
            case "torque_offset":
                lost -= effect["offset"]
    return lost


def stribeck_factor(omega: Array, effect: Mapping[str, Any]) -> Array:
    """Return the ratio of the friction to the friction at high speed, (n,)."""
    ratio = np.abs(omega) / effect["stribeck_velocity"]
    return 1.0 + effect["static_excess"] * np.exp(-(ratio ** effect.get("shape", 2.0)))


def _motor_torque(scene: Scene, effects: Effects, sigma: Array) -> Array:
    torque = scene.tau_m
    if "torque_saturation" in effects:
        limit = effects["torque_saturation"]["limit"]
        torque = np.clip(torque, -limit, limit)
    if "torque_constant_error" in effects:
        torque = torque * (1.0 + effects["torque_constant_error"]["relative_error"])
    if "torque_ripple" in effects:
        r = effects["torque_ripple"]
        torque = torque + r["amplitude"] * np.sin(r["cycles_per_revolution"] * scene.q_m + r.get("phase", 0.0))
    if "motor_side_friction" in effects:
        torque = torque - effects["motor_side_friction"]["coulomb"] * sigma
    return torque


def _bending_and_pretension(rig: Rig, scene: Scene, effects: Effects) -> tuple[Array, Array]:
    theta = scene.theta
    if "configuration_dependent_bending" in effects:
        theta = theta + effects["configuration_dependent_bending"]["bending_per_joint_angle"] * scene.q
    pretension = np.maximum(rig.pretension + rig.tension_per_bending * (theta - rig.bending), 0.0)
    if "stiffness_nonlinearity" in effects:
        k = effects["stiffness_nonlinearity"]["quadratic"]
        pretension = pretension * (1.0 + k * pretension / rig.axial_stiffness)
    if "pretension_relaxation" in effects:
        pretension = pretension * remaining_pretension(
            scene.t, effects["pretension_relaxation"], float(scene.t[scene.first])
        )
    if scene.pretension_scale is not None:
        pretension = pretension * scene.pretension_scale
    return theta, np.maximum(pretension, 0.0)


def remaining_pretension(t: Array, effect: Mapping[str, Any], log_start: float) -> Array:
    """Return the remaining share of the pretension at time t (s), (n,)."""
    age = np.maximum(t - effect.get("start_time", log_start), 0.0) / effect["time_constant"]
    if effect.get("law", "exponential") == "logarithmic":
        return 1.0 - effect["relaxed_fraction"] * np.log10(1.0 + age)
    return 1.0 - effect["relaxed_fraction"] * -np.expm1(-age)


def _friction_angle(rig: Rig, scene: Scene, effects: Effects, theta: Array) -> Array:
    mu = np.full_like(scene.t, rig.mu)
    if "stribeck_friction" in effects:
        mu = mu * stribeck_factor(scene.omega, effects["stribeck_friction"])
    if "thermal_friction_drift" in effects:
        e = effects["thermal_friction_drift"]
        mu = mu * (1.0 + e["temperature_coefficient"] * (scene.temperature - e.get("reference_temperature", 25.0)))
    if scene.friction_scale is not None:
        mu = mu * scene.friction_scale
    return mu * theta


def _sliding(rig: Rig, torque: Array, pretension: Array, x: Array, sigma: Array, effects: Effects) -> Tensions:
    """Return the tensions with capstan friction along each sheath.

    The elongation does not change the tensions.
    """
    half = torque / (2.0 * rig.motor_radius)
    t1, t3 = pretension - half, pretension + half
    if "tendon_slack" in effects:
        t1, t3 = _pull_only(t1, t3)
    x_a = x_b = x
    if "tension_dependent_friction" in effects:
        e = effects["tension_dependent_friction"]
        reference = e.get("reference_tension", rig.pretension)
        x_a = x * (np.maximum(t1, 0.05 * reference) / reference) ** -e["exponent"]
        x_b = x * (np.maximum(t3, 0.05 * reference) / reference) ** -e["exponent"]
    if "sheath_asymmetry" in effects:
        k = effects["sheath_asymmetry"]["relative_difference"]
        x_a, x_b = x_a * (1.0 + 0.5 * k), x_b * (1.0 - 0.5 * k)
    t2, t4 = t1 * np.exp(sigma * x_a), t3 * np.exp(-sigma * x_b)
    return Tensions(t1, t2, t3, t4, rig.joint_radius * (t4 - t2))


def _pull_only(t1: Array, t3: Array) -> tuple[Array, Array]:
    """Return T1 and T3 of tendons that cannot push: a slack tendon has no tension, and the other takes the whole
    torque.
    """
    difference = t3 - t1
    slack_1, slack_3 = t1 < 0.0, t3 < 0.0
    return (
        np.where(slack_1, 0.0, np.where(slack_3, -difference, t1)),
        np.where(slack_3, 0.0, np.where(slack_1, difference, t3)),
    )


def _elongating(rig: Rig, torque: Array, pretension: Array, sigma_x: Array, profile: str) -> Tensions:
    """Return the tensions with elongation, in which tension and strain fall along the sheath.

    The pretension determines the sum of both elongations. The strain is integrated numerically along the tendon, and
    the series springs are at the motor.
    """
    s = 0.5 * (_NODES + 1.0)
    bent = np.ones_like(s) if profile == "motor_end" else s
    grown = np.zeros_like(sigma_x)
    shrunk = np.zeros_like(sigma_x)
    for share, weight in zip(bent, 0.5 * _WEIGHTS, strict=True):
        growth = np.exp(sigma_x * share)
        grown += weight * growth
        shrunk += weight / growth
    spring = 0.0 if not rig.series_stiffness else rig.axial_stiffness / rig.series_stiffness
    stretch_a = rig.length * grown + spring  # elongation of a: T1 * stretch_a / EA
    stretch_b = rig.length * shrunk + spring
    total = 2.0 * pretension * (rig.length + spring)  # EA * (elongation of a + elongation of b)
    difference = torque / rig.motor_radius  # T3 - T1
    t1 = (total - stretch_b * difference) / (stretch_a + stretch_b)
    t3 = t1 + difference
    t2, t4 = t1 * np.exp(sigma_x), t3 * np.exp(-sigma_x)
    return Tensions(t1, t2, t3, t4, rig.joint_radius * (t4 - t2))
