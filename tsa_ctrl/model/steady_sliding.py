"""Compute the transmission while the tendons slide in one direction, as a line over the motor torque.

    tau_J = a(sigma) tau_M - sigma b(sigma)                                                    (3.53), (3.55)
    a = r_J/r_M (alpha exp(-sigma x) + beta exp(sigma x)) / (alpha + beta)                     slope
    b = 4 r_J EA Delta l sinh(x) / (alpha + beta)                                         friction torque at the joint
    h = b/a = 2 T_p0 r_M f(x)                                                             friction torque at the motor
    K = 2 k_t r_M^2,  k_t = 1 / (l_us/EA + 1/k_s)                                              (3.31)-(3.41), (3.56)

x = mu Theta; alpha and beta by (3.36), (3.39); EA Delta l = T_p0 (l_us + EA/k_s). A series spring at the motor adds
EA/k_s to both. A series spring at the joint carries T2 and T4 and adds exp(+-sigma x) times EA/k_s. f depends on the
curvature profile: tanh x (all bends at the joint, and (3.55)), x (uniform) or sinh x (all bends at the motor). K is the
stiffness at the motor with a locked joint, without friction. A friction torque is half the width of the hysteresis.
Only the effects of the transmission are included. SI units.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple, Protocol

from tsa_ctrl.model.composition import Stack
from tsa_ctrl.model.effects.transmission import Elongating
from tsa_ctrl.model.functions import SCALARS
from tsa_ctrl.model.parameters import TendonSheath


class Sliding(NamedTuple):
    """Hold the line tau_J = slope tau_M - sigma half_loop."""

    slope: float  # a, 1
    half_loop: float  # b, friction torque, N*m at the joint

    @property
    def motor_half_loop(self) -> float:
        """Return h = b/a, N*m at the motor: the torque that keeps the tendons sliding, in addition to the load."""
        return self.half_loop / self.slope


def sliding(
    model: TendonSheath, sigma: float = 1.0, friction_angle: float | None = None, pretension: float | None = None
) -> Sliding:
    """Return the line in direction `sigma` (1 or -1), at the model's own x (1) and T_p0 (N) unless given.

    With `sheath_asymmetry`, slope and friction torque depend on the direction. With `tension_dependent_friction`, the
    result is the tangent at tau_M = 0. `tendon_slack` changes the line only beyond 2 T_p r_M.
    """
    x = model.friction_angle if friction_angle is None else friction_angle
    tension = model.pretension if pretension is None else pretension
    return sliding_by(model)(sigma, x, tension)


class SlidingBy(Protocol):
    """Define the type of `sliding` as a function of parameters that change while the loop runs."""

    def __call__(self, sigma: float, friction_angle: float, pretension: float, imbalance: float = 0.0) -> Sliding: ...


def sliding_by(model: TendonSheath) -> SlidingBy:
    """Return `sliding` as a function of sigma, x (1), T_p0 (N) and the tendons' imbalance (1)."""
    transmission = Stack.of(model.effects, model.source).transmission(model)

    def line(sigma: float, friction_angle: float, pretension: float, imbalance: float = 0.0) -> Sliding:
        slope, loss = transmission.tangent(sigma, friction_angle, pretension, imbalance)
        return Sliding(slope, sigma * loss)

    return line


def transmitted_by(model: TendonSheath) -> Callable[[float, float, float], tuple[float, float]]:
    """Return a function of tau_M (N*m), x (1) and T_p0 (N) that returns tau_J (N*m) for sigma = 1 and sigma = -1."""
    transmission = Stack.of(model.effects, model.source).transmission(model)
    if not transmission.linear:

        def transmitted(tau_m: float, friction_angle: float, pretension: float) -> tuple[float, float]:
            return (
                transmission.torque(SCALARS, tau_m, 1.0, friction_angle, pretension),
                transmission.torque(SCALARS, tau_m, -1.0, friction_angle, pretension),
            )

        return transmitted
    used = with_motion = against = (math.nan, math.nan)

    def on_lines(tau_m: float, friction_angle: float, pretension: float) -> tuple[float, float]:
        nonlocal used, with_motion, against
        if used != (friction_angle, pretension):
            used = friction_angle, pretension
            with_motion = transmission.tangent(1.0, friction_angle, pretension)
            against = transmission.tangent(-1.0, friction_angle, pretension)
        return with_motion[0] * tau_m - with_motion[1], against[0] * tau_m - against[1]

    return on_lines


def pretension_level(model: TendonSheath, friction_angle: float | None = None) -> float:
    """Return T_p / T_p0 while sliding without motor torque, (3.54).

    It is 1 for (3.55), and 2 (l_us + EA/k_s) / (alpha + beta) for the full model.
    """
    x = model.friction_angle if friction_angle is None else friction_angle
    transmission = Stack.of(model.effects, model.source).transmission(model)
    return transmission.line(SCALARS, x, 1.0).level if isinstance(transmission, Elongating) else 1.0


def motor_stiffness(model: TendonSheath) -> float:
    """Return K, N*m/rad."""
    return 2.0 * model.tendon_stiffness * model.motor_pulley_radius**2


def joint_compliance(model: TendonSheath) -> float:
    """Return the rotation of the joint per torque while the motor is locked, rad/(N*m), without friction."""
    return (model.motor_pulley_radius / model.joint_pulley_radius) ** 2 / motor_stiffness(model)


def least_stiffness(model: TendonSheath) -> float:
    """Return the least stiffness at the motor, N*m/rad.

    It is K, or half of it with `tendon_slack`, because one tendon may then pull alone.
    """
    return (0.5 if "tendon_slack" in model.effects else 1.0) * motor_stiffness(model)


def sliding_stiffness(model: TendonSheath) -> float:
    """Return the stiffness at the motor while both tendons slide, N*m/rad: K (1/alpha + 1/beta) (l_us + EA/k_s)/2.

    It is K with all bends at the joint, and K cosh x with all bends at the motor.
    """
    transmission = Stack.of(model.effects, model.source).transmission(model)
    if not isinstance(transmission, Elongating):
        return motor_stiffness(model)
    alpha, beta = transmission.lengths(SCALARS, model.friction_angle, model.friction_angle)
    return motor_stiffness(model) * 0.5 * (1.0 + transmission.series) * (1.0 / alpha + 1.0 / beta)


def wound_by_friction(model: TendonSheath) -> float:
    """Return the largest change of the motor angle (rad) by friction, from sliding in one direction to the other.

    It is 2 h/K, with h the friction torque at the joint converted to the motor by the radii. This is the value for all
    bends at the motor, where the whole tendon elongates.
    """
    half_loop = abs(sliding(model).half_loop) * model.motor_pulley_radius / model.joint_pulley_radius
    return 2.0 * half_loop / motor_stiffness(model)


def reversal_travel(model: TendonSheath) -> float:
    """Return the joint travel (rad) in which a reversal runs through a sheath whose bends are all at the motor."""
    return wound_by_friction(model) * model.motor_pulley_radius / model.joint_pulley_radius


def bending_centre(model: TendonSheath) -> float:
    """Return s_c, 1: the centre of the bending along the sheath, 0 at the motor and 1 at the joint.

    It is 1 for a model without curvature profile, because (3.55) has all bends at the joint.
    """
    transmission = Stack.of(model.effects, model.source).transmission(model)
    return transmission.profile.centre if isinstance(transmission, Elongating) else 1.0


def joint_side_compliance(model: TendonSheath) -> float:
    """Return the compliance (m/N) of one tendon between the centre of the bending and the joint.

    It is (1 - s_c) l_us/EA, plus 1/k_s of a series spring at the joint. It determines the elongation by tau_J.
    """
    spring = model.series_length if model.series_at_joint else 0.0
    return ((1.0 - bending_centre(model)) * model.unstrained_length + spring) / model.axial_stiffness
