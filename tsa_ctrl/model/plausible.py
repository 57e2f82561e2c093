"""Physical consistency of a model: each number may be possible while two of them contradict each other.

A wrong unit is wrong by a factor of 10 to 1000. The limits below are limits of materials, so they need no tuning:

    E = EA / (pi d^2 / 4)       modulus of the tendon: soft polymer to carbon fibre
    sigma = T_p0 / (pi d^2 / 4) stress at the pretension: the strongest wire
    epsilon = T_p0 / EA         strain at the pretension: the fibre that bears most
    R = l_us / Theta            mean radius of the bends: more than the tendon's own diameter
    h < the motor's torque      else the motor cannot move the tendons, and nothing can be controlled
    tau / K                     twist of the motor against its tendons
    sqrt(K/J) / 2 pi            ringing of the motor on its tendons
"""

from __future__ import annotations

import math
from typing import Protocol

from tsa_ctrl.errors import UsageError

MODULUS = (0.3e9, 1000e9)  # Pa; a soft polymer has 0.5 GPa, the stiffest carbon fibre 900 GPa
STRENGTH = 3e9  # Pa, of the strongest steel wire; a tendon's fibres are stronger, and fill its diameter in part
STRAIN = 0.04  # 1, at which the fibres break that bear most (polyethylene, aramid)
SPRING_TRAVEL = 0.2  # 1, of the tendon's length, that pretension may lengthen tendon and series spring by
MOST_FRICTION_ANGLE = 3.0  # 1; exp(3) = 20: a twentieth of the tension arrives
TWIST = 2.0 * math.pi  # rad of the motor pulley against its tendons at full torque
RINGING = (2.0, 5000.0)  # Hz, of the motor on its tendons; slower than 2 Hz no torque loop could follow gait


class Tendons(Protocol):
    """The numbers of a `TendonSheath` that are compared; SI units."""

    @property
    def source(self) -> str: ...
    @property
    def motor_pulley_radius(self) -> float: ...
    @property
    def axial_stiffness(self) -> float: ...
    @property
    def series_stiffness(self) -> float | None: ...
    @property
    def unstrained_length(self) -> float: ...
    @property
    def diameter(self) -> float: ...
    @property
    def friction_coefficient(self) -> float: ...
    @property
    def bending_angle(self) -> float: ...
    @property
    def pretension(self) -> float: ...
    @property
    def friction_angle(self) -> float: ...
    @property
    def tendon_stiffness(self) -> float: ...


def check_consistent(model: Tendons) -> None:
    """Compare the numbers of one model file with each other.

    Raises:
        UsageError: two of them contradict each other, with both values, the range and the likely unit mistake.
    """
    where, tension = model.source or "model", model.pretension
    area = math.pi * model.diameter**2 / 4.0
    modulus, stress, strain = model.axial_stiffness / area, tension / area, tension / model.axial_stiffness
    given = f"[tendon] axial_stiffness {model.axial_stiffness:g} N and diameter {model.diameter:g} m"
    if not MODULUS[0] <= modulus <= MODULUS[1]:
        raise UsageError(
            f"{where}: {given} make a modulus of {1e-9 * modulus:.3g} GPa; allowed is {1e-9 * MODULUS[0]:g} to "
            f"{1e-9 * MODULUS[1]:g} GPa (soft polymer to carbon fibre): give E A in N, not in kN, and the diameter in m"
        )
    if strain > STRAIN:
        raise UsageError(
            f"{where}: the pretension of {tension:g} N strains a tendon of axial_stiffness {model.axial_stiffness:g} N "
            f"by {100.0 * strain:.3g} %; allowed is {100.0 * STRAIN:g} %, where fibres break: give the pretension in N "
            "(gram-force times 0.00981) and E A in N"
        )
    if stress > STRENGTH:
        raise UsageError(
            f"{where}: the pretension of {tension:g} N stresses a tendon of diameter {model.diameter:g} m by "
            f"{1e-9 * stress:.3g} GPa; allowed is {1e-9 * STRENGTH:g} GPa, the strongest wire: give the pretension in "
            "N (gram-force times 0.00981) and the diameter in m"
        )
    lengthened = tension / model.tendon_stiffness / model.unstrained_length
    if lengthened > SPRING_TRAVEL:
        raise UsageError(
            f"{where}: the pretension of {tension:g} N lengthens tendon and series_stiffness "
            f"{model.series_stiffness or 0.0:g} N/m by {100.0 * lengthened:.3g} % of unstrained_length; allowed is "
            f"{100.0 * SPRING_TRAVEL:g} %: give series_stiffness in N/m, not in N/mm"
        )
    if model.friction_angle > MOST_FRICTION_ANGLE:
        raise UsageError(
            f"{where}: [sheath] friction_coefficient {model.friction_coefficient:g} times bending_angle "
            f"{model.bending_angle:g} rad is {model.friction_angle:.3g}; allowed is {MOST_FRICTION_ANGLE:g}, where a "
            "twentieth of the tension arrives: give the bending angle in rad, not in degrees"
        )
    if model.bending_angle * model.diameter > model.unstrained_length:
        raise UsageError(
            f"{where}: [sheath] bending_angle {model.bending_angle:g} rad within unstrained_length "
            f"{model.unstrained_length:g} m bends tighter than the tendon's diameter of {model.diameter:g} m: give "
            "lengths in m and the angle in rad"
        )


def check_against_motor(model: Tendons, half_loop: float, torque: float, inertia: float | None, where: str) -> None:
    """Compare a model with the motor that drives it.

    Args:
        model: the tendons and their sheaths.
        half_loop: N*m at the motor, friction torque of the model.
        torque: N*m at the motor, most that the drive can give.
        inertia: kg*m^2 at the motor pulley; None where it is not known.
        where: place of the configuration, for the message.

    Raises:
        UsageError: the motor could not move these tendons, or would swing on them as no motor does.
    """
    stiffness = 2.0 * model.tendon_stiffness * model.motor_pulley_radius**2
    if half_loop > torque:
        raise UsageError(
            f"{where}: {model.source}: the friction torque by friction_coefficient, bending_angle and pretension is "
            f"{half_loop:.3g} N*m at the motor, more than the drive's {torque:g} N*m, so the motor could not move the "
            "tendons: give the pretension in N (gram-force times 0.00981), the angle in rad, the radii in m"
        )
    if torque / stiffness > TWIST:
        raise UsageError(
            f"{where}: {model.source}: the drive's {torque:g} N*m would turn the motor by {torque / stiffness:.3g} rad "
            f"against tendons of {stiffness:.3g} N*m/rad; allowed is {TWIST:.3g} rad: give axial_stiffness in N (not "
            "kN), series_stiffness in N/m (not N/mm), the radii in m"
        )
    if inertia is None or not inertia > 0.0:
        return
    ringing = math.sqrt(stiffness / inertia) / (2.0 * math.pi)
    if not RINGING[0] <= ringing <= RINGING[1]:
        raise UsageError(
            f"{where}: law.motor_inertia {inertia:g} kg*m^2 on the tendons of {model.source} ({stiffness:.3g} N*m/rad) "
            f"would ring at {ringing:.3g} Hz; allowed is {RINGING[0]:g} to {RINGING[1]:g} Hz: give the inertia in "
            "kg*m^2 (g*cm^2 times 1e-7) and axial_stiffness in N"
        )
