"""Compute the joint torque from tendon elongation and motor torque while the tendons slide.

The pretension is not required, and friction has only an effect of second order.

With s = r_M q_M - r_J q_J, tendon b is longer by s and tendon a shorter by s, so that their mean tensions differ by
2 k_t s. While both slide in the direction sigma, (3.31)-(3.41) give (rho = sigma x; lengths over that of tendon and
spring):

    T3 beta = T_p0 + k_t s,    T1 alpha = T_p0 - k_t s,    tau_M = r_M (T3 - T1),    tau_J = r_J (T3 e^-rho - T1 e^rho)

T_p0 cancels, and both directions have the same line:

    tau_J = P s - Q tau_M
    Q = r_J/r_M (e^rho/alpha - e^-rho/beta) / (1/beta - 1/alpha)
    P = r_J k_t (e^-rho/beta + e^rho/alpha + Q r_M/r_J (1/beta + 1/alpha))

To first order in x, Q = r_J/r_M s_c/(1 - s_c) and P = 2 k_t r_J/(1 - s_c), with s_c the share of the compliance between
the motor and the centre of the bending. The line therefore depends on stiffness and shape, not on friction, pretension
and direction. For an even bend P = 4 (EA/l) r_J (x/2)/tanh(x/2) exactly. With all bends at the joint s_c = 1, and the
elongation does not determine tau_J.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.catalogue import of_the_stretch
from tsa_ctrl.model.composition import Stack
from tsa_ctrl.model.curvature import Profile, centred
from tsa_ctrl.model.effects.transmission import Elongating
from tsa_ctrl.model.functions import SCALARS
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.steady_sliding import joint_side_compliance

MOST_CENTRE = 0.7  # 1, largest s_c; there, 0.05 of error in s_c is a sixth of tau_J, and this grows with 1/(1 - s_c)
_SMALL = 1e-4  # 1; the effect of a smaller friction angle on P and Q is below 1e-8


@dataclass(frozen=True)
class StretchLine:
    """Hold the line tau_J = per_stretch (s - zero) - per_torque tau_M; s in m, torques in N*m.

    The caller must determine the zero.
    """

    per_stretch: float  # P, N
    per_torque: float  # Q, 1
    motor_radius: float  # m
    joint_radius: float  # m
    centre: float  # s_c, 1

    def stretch(self, q_m: float, q_j: float) -> float:
        """Return s (m) from the angles of motor and joint (rad)."""
        return self.motor_radius * q_m - self.joint_radius * q_j

    def torque(self, stretch: float, tau_m: float) -> float:
        """Return tau_J (N*m) from s minus its zero (m) and the motor torque minus J_M alpha_M (N*m)."""
        return self.per_stretch * stretch - self.per_torque * tau_m


def stretch_line(model: TendonSheath) -> StretchLine:
    """Return the line of a model; raises UsageError if the elongation does not determine its joint torque."""
    reason = unsupported_reason(model)
    if reason:
        raise UsageError(f"{model.source or 'model'}: {reason}")
    r_m, r_j = model.motor_pulley_radius, model.joint_pulley_radius
    at_motor, at_joint = compliances(model)
    return StretchLine(r_j / at_joint, at_motor / at_joint * r_j / r_m, r_m, r_j, compliance_centre(model))


def compliances(model: TendonSheath) -> tuple[float, float]:
    """Return the compliances c_M and c_J (m/N) of s = c_M (T3 - T1) + c_J (T4 - T2) while both tendons slide.

    This is the equation of `stretch_line`, solved for s, and valid for any shape: c_M = Q r_M/P, c_J = r_J/P. Their sum
    is 1/(2 k_t), except for terms in x^2. With all bends at the joint c_J = 0.
    """
    x, softness = model.friction_angle, 1.0 / model.tendon_stiffness
    if x < _SMALL:
        centre = compliance_centre(model)
        return 0.5 * softness * centre, 0.5 * softness * (1.0 - centre)
    alpha, beta = elongations(model, x)
    grown, decayed = math.exp(x) / alpha, math.exp(-x) / beta
    motor, joint = grown - decayed, 1.0 / beta - 1.0 / alpha
    whole = (grown + decayed) * joint + motor * (1.0 / alpha + 1.0 / beta)
    return softness * motor / whole, softness * joint / whole


def unsupported_reason(model: TendonSheath) -> str:
    """Return the reason why the elongation does not determine the joint torque of this model; empty if it does."""
    beside, _ = of_the_stretch(model.effects)
    if beside:
        cure = (
            "give it as [tendon] series_stiffness"
            if beside[0] == "series_spring"
            else "remove its cause on the rig, and remove it here"
        )
        return f"[effects.{beside[0]}] changes the tendon elongation, which then does not show the joint torque; {cure}"
    if "pulley_eccentricity" in model.effects:
        return (
            "[effects.pulley_eccentricity] winds other lengths than r_J q_J, so the tendon elongation does not show "
            "the joint torque"
        )
    centre = compliance_centre(model)
    if centre <= MOST_CENTRE:
        return ""
    found = "all bends are at the joint" if centre > 0.99 else f"the centre of the bends is at {centre:.2f}"
    return (
        f"{found} (0 motor, 1 joint), so the tendon elongation does not show the joint torque; at most "
        f"{MOST_CENTRE:g} is allowed: use a joint torque sensor, or state where the sheath bends "
        "([effects.elongation_coupling])"
    )


def profile_of(model: TendonSheath) -> Profile:
    """Return the curvature profile of a model's sheath.

    The effect elongation_coupling has priority. Without it, the profile is the file's bending_course, or an even bend
    if there is none, shifted to the file's bending_centre if there is one.
    """
    transmission = Stack.of(model.effects, model.source).transmission(model)
    if isinstance(transmission, Elongating):
        return transmission.profile
    course = Profile.of("uniform" if model.bending_course is None else model.bending_course)
    return course if model.bending_centre is None else centred(course, model.bending_centre)


def compliance_centre(model: TendonSheath) -> float:
    """Return s_c, 1: the share of a tendon's compliance between the motor and the centre of the bending.

    The compliance includes a series spring.
    """
    profile = profile_of(model)
    if "elongation_coupling" not in model.effects:
        model = model.with_effects({"elongation_coupling": {"curvature_profile": profile.points}})
    return 1.0 - joint_side_compliance(model) * model.tendon_stiffness


def elongations(model: TendonSheath, x: float) -> tuple[float, float]:
    """Return alpha and beta at the signed angle x, with the series spring, over the length of tendon and spring."""
    series = model.series_length / model.unstrained_length
    radii = (model.motor_pulley_radius, model.joint_pulley_radius)
    alpha, beta = Elongating(radii, profile_of(model), series, model.series_at_joint).lengths(SCALARS, x, x)
    return alpha / (1.0 + series), beta / (1.0 + series)
