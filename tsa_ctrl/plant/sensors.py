"""Simulate the sensor nodes: a joint encoder (CiA 406) and a joint torque sensor (CiA 404)."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import dataclass

from tsa_ctrl.plant.cia301 import Identity
from tsa_ctrl.plant.dictionary import Access, Entry, Type
from tsa_ctrl.plant.node import Node, Send
from tsa_ctrl.plant.pdo import INVALID, PdoDefault
from tsa_ctrl.plant.settings import EncoderSettings, TorqueSensorSettings


@dataclass(slots=True)
class MotorCommand:
    """Hold the command to the power stage, with the torque at the motor pulley, in SI units."""

    torque: float = 0.0  # N*m
    enabled: bool = False
    max_speed: float = 1e9  # rad/s, beyond it no torque in the direction of motion


@dataclass(slots=True)
class Readings:
    """Hold the measurements of the sensors at the last advance of the mechanics, in SI units, with noise."""

    motor_torque: float = 0.0  # N*m, estimated by the drive from its current
    motor_speed: float = 0.0  # rad/s
    motor_angle: float = 0.0  # rad
    joint_angle: float = 0.0  # rad
    joint_speed: float = 0.0  # rad/s
    joint_torque: float = 0.0  # N*m
    temperature: float = 25.0  # deg C
    speed_limited: bool = False


ENCODER_DEVICE_TYPE = 0x00080196  # absolute rotary encoder, CiA 406
TORQUE_SENSOR_DEVICE_TYPE = 0x00020194  # measuring device with analogue inputs, CiA 404
SPEED_DIVIDER = 256  # counts/s per digit of 0x6030:1, coarse because the object is an i16


@dataclass(slots=True)
class EncoderFaults:
    """Hold the active faults of an encoder."""

    offset: float = 0.0  # rad, a jump
    sign: int = 1
    noise: float = 0.0  # rad, standard deviation
    drift: float = 0.0  # rad/s, since `since`
    gain: float = 1.0  # share of the motion since `pivot` that reaches the encoder; not 1 if the coupling slips
    since: float = 0.0  # s
    pivot: float = 0.0  # rad
    distorted: Callable[[int], int] | None = None  # changes the position (counts) that is sent

    def seen(self, angle: float, now: float) -> float:
        """Return the angle (rad) of the encoder's disc without noise, for a joint angle in rad and a time in s."""
        return self.pivot + self.gain * (angle - self.pivot) + self.offset + self.drift * (now - self.since)


class Encoder(Node):
    """Simulate an encoder: 0x6004 position (u32, wraps), 0x6030:1 speed in counts/s / 256 (i16)."""

    def __init__(self, settings: EncoderSettings, readings: Readings, noise: random.Random, send: Send) -> None:
        self.settings = settings
        self.readings = readings
        self.faults = EncoderFaults()
        self._noise = noise
        assert settings.node_id is not None
        node = settings.node_id
        ro = Access.RO
        entries = (
            Entry(0x6000, 0, Type.U16),
            Entry(0x6001, 0, Type.U32, ro, settings.counts_per_revolution),
            Entry(0x6002, 0, Type.U32, ro, 0xFFFFFFFF),
            Entry(0x6004, 0, Type.U32, ro, mappable=True),
            Entry(0x6030, 0, Type.U8, Access.CONST, 1),
            Entry(0x6030, 1, Type.I16, ro, mappable=True),
            Entry(0x6031, 0, Type.U8, Access.CONST, 4),
            Entry(0x6031, 1, Type.U8, ro, 0),
            Entry(0x6031, 2, Type.U16, ro, 1),
            Entry(0x6031, 3, Type.U16, ro, 1),  # multiplier
            Entry(0x6031, 4, Type.U16, ro, SPEED_DIVIDER),
            Entry(0x6501, 0, Type.U32, ro, settings.counts_per_revolution),
        )
        tpdos = tuple(enumerate((PdoDefault(0x180, 1, ((0x6004, 0),)), PdoDefault(INVALID | 0x280, 1, ()))))
        serial = node if settings.serial_number is None else settings.serial_number
        identity = Identity(ENCODER_DEVICE_TYPE, settings.name, settings.vendor, settings.product, serial=serial)
        super().__init__(node, identity, entries, tpdos, (), send)

    def sample(self) -> None:
        settings, readings = self.settings, self.readings
        scale = settings.sign * self.faults.sign * settings.counts_per_revolution / (2.0 * math.pi)
        angle = self.faults.seen(readings.joint_angle, self.now)
        if self.faults.noise > 0.0:
            angle += self._noise.gauss(0.0, self.faults.noise)
        counts = math.floor(angle * scale) + settings.zero
        if self.faults.distorted is not None:
            counts = self.faults.distorted(counts)
        self.values[0x6004, 0] = counts & 0xFFFFFFFF
        speed = round(readings.joint_speed * scale / SPEED_DIVIDER)
        self.values[0x6030, 1] = max(-0x8000, min(0x7FFF, speed))


@dataclass(slots=True)
class TorqueSensorFaults:
    """Hold the active faults of a torque sensor."""

    stuck: bool = False
    gain: float = 1.0


class TorqueSensor(Node):
    """Simulate a torque sensor.

    0x9130:1 is the process value in digits of `resolution` N*m (i32), 0x9130:2 the temperature in mK above 0 deg C
    (i32).
    """

    def __init__(self, settings: TorqueSensorSettings, readings: Readings, noise: random.Random, send: Send) -> None:
        self.settings = settings
        self.readings = readings
        self.faults = TorqueSensorFaults()
        self._noise = noise
        assert settings.node_id is not None
        node = settings.node_id
        ro = Access.RO
        entries = (
            Entry(0x6131, 0, Type.U8, Access.CONST, 2),
            Entry(0x6131, 1, Type.U32, ro, 0xFA560100),  # 10^-6 N*m
            Entry(0x6131, 2, Type.U32, ro, 0xFD2D0000),  # 10^-3 deg C
            Entry(0x9130, 0, Type.U8, Access.CONST, 2),
            Entry(0x9130, 1, Type.I32, ro, mappable=True),
            Entry(0x9130, 2, Type.I32, ro, mappable=True),
        )
        tpdos = tuple(enumerate((PdoDefault(0x180, 1, ((0x9130, 1),)), PdoDefault(INVALID | 0x280, 1, ()))))
        serial = node if settings.serial_number is None else settings.serial_number
        identity = Identity(TORQUE_SENSOR_DEVICE_TYPE, settings.name, settings.vendor, settings.product, serial=serial)
        super().__init__(node, identity, entries, tpdos, (), send)

    def sample(self) -> None:
        if self.faults.stuck:
            return
        settings = self.settings
        torque = settings.sign * self.faults.gain * self.readings.joint_torque + settings.offset
        if settings.noise > 0.0:
            torque += self._noise.gauss(0.0, settings.noise)
        bound = 0x7FFFFFFF
        self.values[0x9130, 1] = max(-bound, min(bound, round(torque / settings.resolution)))
        self.values[0x9130, 2] = max(-bound, min(bound, round(self.readings.temperature * 1e3)))
