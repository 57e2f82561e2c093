"""What passes between the nodes of an axis and its mechanics: the command to the motor, and what sensors see. SI."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class MotorCommand:
    """To the power stage; torque at the motor pulley."""

    torque: float = 0.0  # N*m
    enabled: bool = False
    max_speed: float = 1e9  # rad/s, beyond it no torque in the direction of motion


@dataclass(slots=True)
class Readings:
    """From the sensors, noise included, at the time of the last advance."""

    motor_torque: float = 0.0  # N*m, what the drive believes (from its current)
    motor_speed: float = 0.0  # rad/s
    motor_angle: float = 0.0  # rad
    joint_angle: float = 0.0  # rad
    joint_speed: float = 0.0  # rad/s
    joint_torque: float = 0.0  # N*m
    temperature: float = 25.0  # deg C
    speed_limited: bool = False
