"""Check that a model is consistent with its motor, its drive and its motion, although each number is possible.

A wrong unit is wrong by a factor of 10 to 1000. The limits below are limits of materials, so they need no tuning:

    h < the motor's torque      otherwise the motor cannot move the tendons, and control is impossible
    tau / K                     twist of the motor against its tendons
    sqrt(K/J) / 2 pi            ringing of the motor on its tendons
    2 T_p0 r_M                  torque at which a tendon goes slack: steps of the drive's torque, and the set-point
    h                           friction torque to compensate: a step of the drive's torque
    travel r_J                  length of tendon that the joint winds: no more than the whole tendon
    omega r                     speed of the tendons in their sheaths
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.routing import TURNS

TWIST = 2.0 * math.pi  # rad of the motor pulley against its tendons at full torque
RINGING = (2.0, 5000.0)  # Hz, of the motor on its tendons; below 2 Hz, no torque loop could follow gait
STEPS = 10.0  # least steps of the drive's torque command before a tendon goes slack; fewer allow no torque control
LEAST_FRICTION = 0.01  # 1; a polymer liner with lubricant has 0.03, and only an oil film at speed has less than this
TENDON_SPEED = 5.0  # m/s in a sheath; polymer liners are rated for 2 m/s at most, and wear out within minutes above


def check_against_motor(
    model: TendonSheath, half_loop: float, torque: float, inertia: float | None, where: str
) -> None:
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


def check_against_command(model: TendonSheath, half_loop: float, step: float, compensated: bool, where: str) -> None:
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


def check_set_point(model: TendonSheath, largest: float, torque: float, where: str) -> None:
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
    model: TendonSheath, travel: tuple[float, float] | None, speeds: Mapping[str, tuple[float, float]], where: str
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
