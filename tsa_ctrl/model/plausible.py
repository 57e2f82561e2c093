"""Check the physical consistency of a model: two numbers may contradict each other although each is possible.

A wrong unit is wrong by a factor of 10 to 1000. The limits below are limits of materials, so they need no tuning:

    E = EA / (pi d^2 / 4)       modulus of the tendon: soft polymer to carbon fibre
    sigma = T_p0 / (pi d^2 / 4) stress at the pretension: the strongest wire
    epsilon = T_p0 / EA         strain at the pretension: the most extensible strong fibre
    R = l_us / Theta            mean radius of the bends: more than the tendon's own diameter
    h < the motor's torque      otherwise the motor cannot move the tendons, and control is impossible
    tau / K                     twist of the motor against its tendons
    sqrt(K/J) / 2 pi            ringing of the motor on its tendons
    r_J / r_M                   ratio of two pulleys that share tendons
    2 T_p0 r_M                  torque at which a tendon goes slack: steps of the drive's torque, and the set-point
    h                           friction torque to compensate: a step of the drive's torque
    travel r_J                  length of tendon that the joint winds: no more than the whole tendon
    omega r                     speed of the tendons in their sheaths
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Protocol

from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.routing import TURNS

MODULUS = (0.3e9, 1000e9)  # Pa; a soft polymer has 0.5 GPa, the stiffest carbon fibre 900 GPa
STRENGTH = 3e9  # Pa, of the strongest steel wire; fibres are stronger, but fill only a part of a tendon's diameter
STRAIN = 0.04  # 1, breaking strain of the most extensible strong fibres (polyethylene, aramid)
SPRING_TRAVEL = 0.2  # 1, largest elongation of tendon and series spring by the pretension, over the tendon's length
MOST_FRICTION_ANGLE = 3.0  # 1; exp(3) = 20, so a twentieth of the tension reaches the joint
TWIST = 2.0 * math.pi  # rad of the motor pulley against its tendons at full torque
RINGING = (2.0, 5000.0)  # Hz, of the motor on its tendons; below 2 Hz, no torque loop could follow gait
RATIO = 10.0  # 1, r_J/r_M or r_M/r_J; one tendon runs over both pulleys, so a larger ratio needs a gear
STEPS = 10.0  # least steps of the drive's torque command before a tendon goes slack; fewer allow no torque control
LEAST_FRICTION = 0.01  # 1; a polymer liner with lubricant has 0.03, and only an oil film at speed has less than this
# Factor by which a file that no motor uses may exceed these limits. A log of a rig with a wrong unit can still be
# calibrated and diagnosed, and a table of random models needs no real material.
OFFLINE = 1e3
TENDON_SPEED = 5.0  # m/s in a sheath; polymer liners are rated for 2 m/s at most, and wear out within minutes above


class Tendons(Protocol):
    """Define the numbers of a `TendonSheath` that are compared, in SI units."""

    @property
    def source(self) -> str: ...
    @property
    def motor_pulley_radius(self) -> float: ...
    @property
    def joint_pulley_radius(self) -> float: ...
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


def check_consistent(model: Tendons, tolerance: float = 1.0) -> None:
    """Compare the numbers of one model file with each other.

    Args:
        model: the tendons and their sheaths.
        tolerance: factor by which a value may exceed its limit.

    Raises:
        UsageError: Two of them contradict each other. The message has both values, the range and the likely unit error.
    """
    where, tension = model.source or "model", model.pretension
    ratio = model.joint_pulley_radius / model.motor_pulley_radius
    if not 1.0 / RATIO / tolerance <= ratio <= RATIO * tolerance:
        raise UsageError(
            f"{where}: [actuator] joint_pulley_radius {model.joint_pulley_radius:g} m over motor_pulley_radius "
            f"{model.motor_pulley_radius:g} m is {ratio:.3g}; allowed is {1.0 / RATIO:g} to {RATIO:g}: give both radii "
            "in m, and a gear of the motor as [axis.drive] gear_ratio"
        )
    area = math.pi * model.diameter**2 / 4.0
    modulus, stress, strain = model.axial_stiffness / area, tension / area, tension / model.axial_stiffness
    given = f"[tendon] axial_stiffness {model.axial_stiffness:g} N and diameter {model.diameter:g} m"
    if not MODULUS[0] / tolerance <= modulus <= MODULUS[1] * tolerance:
        raise UsageError(
            f"{where}: {given} give a modulus of {1e-9 * modulus:.3g} GPa; allowed is {1e-9 * MODULUS[0]:g} to "
            f"{1e-9 * MODULUS[1]:g} GPa (soft polymer to carbon fibre): give E A in N, not in kN, and the diameter in m"
        )
    if strain > STRAIN * tolerance:
        raise UsageError(
            f"{where}: the pretension of {tension:g} N strains a tendon of axial_stiffness {model.axial_stiffness:g} N "
            f"by {100.0 * strain:.3g} %; allowed is {100.0 * STRAIN:g} %, where fibres break: give the pretension in N "
            "(gram-force times 0.00981) and E A in N"
        )
    if stress > STRENGTH * tolerance:
        raise UsageError(
            f"{where}: the pretension of {tension:g} N stresses a tendon of diameter {model.diameter:g} m by "
            f"{1e-9 * stress:.3g} GPa; allowed is {1e-9 * STRENGTH:g} GPa, the strongest wire: give the pretension in "
            "N (gram-force times 0.00981) and the diameter in m"
        )
    lengthened = tension / model.tendon_stiffness / model.unstrained_length
    if lengthened > SPRING_TRAVEL * tolerance:
        raise UsageError(
            f"{where}: the pretension of {tension:g} N lengthens tendon and series_stiffness "
            f"{model.series_stiffness or 0.0:g} N/m by {100.0 * lengthened:.3g} % of unstrained_length; allowed is "
            f"{100.0 * SPRING_TRAVEL:g} %: give series_stiffness in N/m, not in N/mm"
        )
    if model.friction_angle > MOST_FRICTION_ANGLE * tolerance:
        raise UsageError(
            f"{where}: [sheath] friction_coefficient {model.friction_coefficient:g} times bending_angle "
            f"{model.bending_angle:g} rad is {model.friction_angle:.3g}; allowed is {MOST_FRICTION_ANGLE:g}, where 5 % "
            "of the tension arrives: give the bending angle in rad, not in degrees"
        )
    if model.bending_angle * model.diameter > model.unstrained_length * tolerance:
        raise UsageError(
            f"{where}: [sheath] bending_angle {model.bending_angle:g} rad within unstrained_length "
            f"{model.unstrained_length:g} m bends to a radius below the tendon's diameter of {model.diameter:g} m: "
            "give lengths in m and the angle in rad"
        )


def check_against_motor(model: Tendons, half_loop: float, torque: float, inertia: float | None, where: str) -> None:
    """Compare a model with the motor that drives it.

    Args:
        model: the tendons and their sheaths.
        half_loop: N*m at the motor, friction torque of the model.
        torque: N*m at the motor, maximum of the drive.
        inertia: kg*m^2 at the motor pulley; None if it is not known.
        where: place of the configuration, for the message.

    Raises:
        UsageError: The motor could not move these tendons, or would oscillate on them at an implausible frequency.
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


def check_against_command(model: Tendons, half_loop: float, step: float, compensated: bool, where: str) -> None:
    """Compare a model with the resolution of the drive's torque command.

    Args:
        model: the tendons and their sheaths.
        half_loop: N*m at the motor, friction torque of the model.
        step: N*m at the motor, one step of the torque command.
        compensated: True if the law compensates the friction.
        where: place of the configuration, for the message.

    Raises:
        UsageError: pretension or friction is smaller than the drive can command.
    """
    slack = 2.0 * model.pretension * model.motor_pulley_radius
    if slack < STEPS * step:
        least = STEPS * step / (2.0 * model.motor_pulley_radius)
        raise UsageError(
            f"{where}: {model.source}: with the pretension of {model.pretension:g} N a tendon goes slack at "
            f"{slack:.3g} N*m of the motor; allowed is at least {STEPS:g} steps of the drive's torque command of "
            f"{step:.3g} N*m: give a pretension of {least:.3g} N or more, in N (kN times 1000), and rated_torque in N*m"
        )
    if not compensated:
        return
    if model.friction_coefficient < LEAST_FRICTION:
        raise UsageError(
            f"{where}: {model.source}: [sheath] friction_coefficient is {model.friction_coefficient:g}; allowed is "
            f"{LEAST_FRICTION:g} to 0.8 (lubricated polymer to dry steel) for compensated friction: measure "
            "it, or write [axis.law] compensation = 0"
        )
    if half_loop < step:
        raise UsageError(
            f"{where}: {model.source}: the friction torque by friction_coefficient, bending_angle and pretension is "
            f"{half_loop:.3g} N*m at the motor; allowed is at least one step of the drive's torque command of "
            f"{step:.3g} N*m: give the angle in rad and the pretension in N, or write [axis.law] compensation = 0"
        )


def check_set_point(model: Tendons, largest: float, torque: float, where: str) -> None:
    """Compare the set-point with the torque that motor and tendons can deliver without friction.

    Args:
        model: the tendons and their sheaths.
        largest: N*m at the joint, largest size of the set-point.
        torque: N*m at the motor, its limit.
        where: place of the configuration, for the message.

    Raises:
        UsageError: the set-point exceeds that torque.
    """
    most = torque * model.joint_pulley_radius / model.motor_pulley_radius
    if largest > most * (1.0 + 1e-9):
        raise UsageError(
            f"{where}: the set-point reaches {largest:.4g} N*m at the joint; limits.torque {torque:g} N*m times "
            f"r_J/r_M allows {most:.4g} N*m: lower the set-point (in N*m), or raise limits.torque"
        )
    slack = 2.0 * model.pretension * model.joint_pulley_radius
    if largest > slack * (1.0 + 1e-9):
        raise UsageError(
            f"{where}: the set-point reaches {largest:.4g} N*m at the joint; with the pretension of "
            f"{model.pretension:g} N ({model.source}) a tendon goes slack at {slack:.4g} N*m: lower the set-point, or "
            "give the pretension in N (kgf times 9.81)"
        )


def check_motion(
    model: Tendons, travel: tuple[float, float] | None, speeds: Mapping[str, tuple[float, float]], where: str
) -> None:
    """Compare the limits of the motion with the tendons.

    Args:
        model: the tendons and their sheaths.
        travel: rad of the joint; None without a limit.
        speeds: by key of [axis.limits], the speed (rad/s) and the radius (m) of the pulley with this speed.
        where: place of the configuration, for the message.

    Raises:
        UsageError: the travel winds more tendon than exists, or a tendon would run too fast for any sheath.
    """
    if travel is not None:
        most = model.unstrained_length / model.joint_pulley_radius
        if travel[1] - travel[0] > most or max(-travel[0], travel[1]) > TURNS:
            raise UsageError(
                f"{where}: limits.travel {list(travel)} rad; allowed are ends within {TURNS:.3g} rad (three turns) and "
                f"a width of at most {most:.3g} rad, which winds the whole tendon onto the joint's pulley: degrees "
                "times 0.01745"
            )
    for key, (speed, radius) in speeds.items():
        if speed * radius > TENDON_SPEED:
            raise UsageError(
                f"{where}: limits.{key} {speed:g} rad/s moves the tendons by {speed * radius:.3g} m/s; allowed is "
                f"{TENDON_SPEED:g} m/s, which is {TENDON_SPEED / radius:.3g} rad/s: degrees times 0.01745, rpm times "
                "0.1047"
            )
