"""Simulate a CiA 402 drive in cyclic synchronous torque mode: limits, reactions, units. It is an axis of a `DriveNode`.

The power stage and the motor are not part of this module. The drive writes its command to a `MotorCommand` and reads
`Readings`. `before_change` advances the mechanics to the present before a command changes.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, MutableMapping
from dataclasses import dataclass, field
from enum import IntEnum

import msgspec

from tsa_ctrl.plant.cia301 import EmcyCode, NmtState
from tsa_ctrl.plant.cia402 import Command, PowerState, PowerStateMachine, command_of
from tsa_ctrl.plant.dictionary import AbortCode, Key, SdoAbort
from tsa_ctrl.plant.drive_emulation import AXIS_OFFSET, DRIVE_EMULATIONS, AxisValues, mode_numbers, shifted, unit_code
from tsa_ctrl.plant.node import Node
from tsa_ctrl.plant.sensors import MotorCommand, Readings
from tsa_ctrl.plant.settings import DriveSettings


@dataclass(slots=True)
class DriveFaults:
    """Hold the faults of a simulated drive that can be switched on."""

    ignore_command: bool = False  # bit 12 low, the target torque is not followed
    wrong_mode: int | None = None  # value of 0x6061
    torque_sign: int = 1  # -1: motor wired the wrong way round
    torque_gain: float = 1.0  # motor torque over the torque that the drive assumes
    clock_drift: float | None = None  # relative; the drive samples by its internal clock, not at the SYNC
    most_torque: float | None = None  # of rated torque, limit of an overheated drive, reported by bit 11
    dead_stage: bool = False  # the power stage has no voltage: no torque, bit 4 low, but the state machine continues
    torque_off: bool = False  # the safe torque off input is open
    turned: int = 1  # -1: position and velocity count in the opposite direction
    inputs: int = 0  # 0x60FD
    distortions: list[tuple[int, Callable[[int], int]]] = field(default_factory=list)  # of reported objects, by index


CST = 10  # cyclic synchronous torque mode
_PROFILE_TORQUE = 4  # profile torque mode
_RPM = 2.0 * math.pi / 60.0  # rad/s
_VOLTAGE_ENABLED, _WARNING, _REMOTE = 1 << 4, 1 << 7, 1 << 9
_INTERNAL_LIMIT, _FOLLOWS_COMMAND = 1 << 11, 1 << 12
_ERROR_REGISTER_PROFILE = 0x20
_POSITION_TURNED, _VELOCITY_TURNED, _TORQUE_TURNED = 0x80, 0x40, 0x20  # bits of 0x607E
_OWN_CYCLE = 1e-3  # s, cycle of a drive that does not follow the SYNC
_ENABLED = (PowerState.OPERATION_ENABLED, PowerState.QUICK_STOP_ACTIVE)
_FAULTED = (PowerState.FAULT, PowerState.FAULT_REACTION_ACTIVE)
_UPWARDS = (Command.SHUTDOWN, Command.SWITCH_ON, Command.ENABLE_OPERATION)
_NO_CLAMP, _NO_SPEED_CLAMP = 0x7FFF, 0x7FFFFFFF  # per mille, rpm: values of a drive without the object
_RESTING = 0.01  # of rated torque; a quick stop or a fault reaction is complete below it


class ConnectionLoss(IntEnum):
    """List the reactions of the drive to a lost connection (0x6007)."""

    NOTHING = 0
    FAULT = 1
    DISABLE_VOLTAGE = 2
    QUICK_STOP = 3


class Drive:
    """Simulate one drive. `readings` has the measurements of its sensors, `command` the command to its power stage.

    `attach` makes the drive an axis of a node. Its `values` have the object indices of the first axis of a device.
    """

    def __init__(
        self, settings: DriveSettings, readings: Readings, command: MotorCommand, noise: random.Random
    ) -> None:
        self.emulation = emulation = DRIVE_EMULATIONS[settings.kind]
        self.settings = settings = msgspec.structs.replace(settings, **emulation.settings)
        self._noise = noise
        self.readings = readings
        self.command = command
        self.machine = PowerStateMachine()
        self.faults = DriveFaults()
        self.error_cause = False  # True while the cause of the fault persists, so that a reset fails
        self.limited = False
        self._own_cycle = 0
        self._unit_code = unit_code(settings)  # used by a drive without 0x60A9
        self._modes = mode_numbers(settings)
        self._scale = settings.torque_sign * settings.rated_torque * settings.gear_ratio / emulation.torque_digits
        self._ramp, self._ramped_at = 0.0, 0.0  # profile torque mode: digits of 0x6071, s of the last update
        self._next_step = 0.0  # s, earliest time of a slow drive's next step
        self._waiting: int | None = None  # controlword that a slow drive has not processed yet
        self.before_change: Callable[[float], None] = lambda now: None
        self.values: MutableMapping[Key, int]

    def attach(self, node: Node) -> None:
        """Make this drive an axis of the node."""
        self.node = node
        offset = (self.settings.slot - 1) * AXIS_OFFSET
        self.values = AxisValues(node.values, offset) if offset else node.values
        hooks = node.dictionary.on_write
        hooks[shifted((0x6040, 0), offset)] = self._control
        hooks[shifted((0x6060, 0), offset)] = self._write_mode

    def power_on(self) -> None:
        self.machine.power_on()
        self.error_cause = False
        self._waiting = None
        self._obey()

    # from the master

    def _write_mode(self, value: int) -> None:
        if value not in self._modes or (value == CST and not self.values.get((0x6502, 0), -1) >> CST - 1 & 1):
            raise SdoAbort(AbortCode.INVALID_VALUE)

    def written(self, controlword: bool) -> None:
        """Apply received process data; `controlword` is True if they contain the controlword of this axis."""
        if controlword:
            self._take(self.values[0x6040, 0])
        self._obey()

    def _control(self, controlword: int) -> None:
        self._take(controlword)
        self._obey()

    def _take(self, controlword: int) -> None:
        if self.settings.safe_torque_off or self.faults.torque_off:
            return
        if self.settings.step_time > 0.0 and command_of(controlword) in _UPWARDS and self._must_wait(controlword):
            return
        before = self.machine.state
        self.machine.control(controlword, self.values.get((0x605A, 0), 0) >= 5, not self.error_cause)
        after = self.machine.state
        if before is PowerState.FAULT and after is not PowerState.FAULT:
            self.values[0x603F, 0] = 0
            self.node.emergency(EmcyCode.NO_ERROR, 0)
        if after is not before:
            self._next_step = self.node.now + self.settings.step_time
            if after is PowerState.OPERATION_ENABLED and self.settings.warns_when_enabled:
                self.node.emergency(self.settings.warns_when_enabled, _ERROR_REGISTER_PROFILE)

    def _must_wait(self, controlword: int) -> bool:
        self._waiting = controlword if self.node.now < self._next_step else None
        return self._waiting is not None

    # reactions

    def fault(self, code: int) -> None:
        """Raise a drive error: EMCY, 0x603F, fault reaction."""
        self.values[0x603F, 0] = code
        self.node.emergency(code, _ERROR_REGISTER_PROFILE)
        self.machine.fault()
        self._obey()

    def communication_error(self, code: EmcyCode) -> bool:
        """Raise a fault if the RPDOs of an enabled drive with watchdogs have timed out; return True if raised."""
        if code is not EmcyCode.RPDO_TIMEOUT or self.machine.state not in _ENABLED or not self.settings.watchdogs:
            return False
        self.fault(code)
        return True

    def connection_lost(self, overdue: bool) -> None:
        enabled = self.machine.state in _ENABLED
        literally = overdue and self.settings.watches_always and self.machine.state not in _FAULTED
        if not (enabled or literally) or not self.settings.watchdogs:
            return
        reaction = self.values.get((0x6007, 0), 0)
        if reaction == ConnectionLoss.FAULT:
            self.fault(EmcyCode.HEARTBEAT)
        elif reaction == ConnectionLoss.DISABLE_VOLTAGE:
            self.machine.voltage_off()
        elif reaction == ConnectionLoss.QUICK_STOP and enabled:
            self._quick_stop()
        self._obey()

    def _quick_stop(self) -> None:
        if self.values.get((0x605A, 0), 2) == 0:
            self.machine.voltage_off()
        else:
            self.machine.quick_stop()

    # power stage

    def tick(self) -> None:
        """Continue reactions and slow steps."""
        if self._waiting is not None and self.node.now >= self._next_step:
            waiting, self._waiting = self._waiting, None
            self._control(waiting)
        self._settle()
        self._obey()

    def _settle(self) -> None:
        """Complete a quick stop or a fault reaction as soon as the torque has decayed."""
        state = self.machine.state
        if state not in (PowerState.QUICK_STOP_ACTIVE, PowerState.FAULT_REACTION_ACTIVE):
            return
        resting = abs(self.readings.motor_torque) <= _RESTING * self.settings.rated_torque * self.settings.gear_ratio
        if state is PowerState.FAULT_REACTION_ACTIVE and (resting or self.values.get((0x605E, 0), 2) == 0):
            self.machine.reaction_done()
        elif state is PowerState.QUICK_STOP_ACTIVE and resting and self.values.get((0x605A, 0), 2) < 5:
            self.machine.voltage_off()

    def _obey(self) -> None:
        """Derive the power stage's command from state and objects. Outside operation enabled, the torque is zero."""
        values, settings, command = self.values, self.settings, self.command
        enabled = self.node.powered and self.machine.state is PowerState.OPERATION_ENABLED
        target = 0
        self.limited = False
        if not enabled:
            self._ramp = 0.0
        elif not (self.faults.ignore_command or self.faults.dead_stage):
            wanted = self._demand()
            backward, forward = self._limits()
            target = max(-backward, min(forward, wanted))
            self.limited = target != wanted
        values[0x6074, 0] = _bounded(target, 0x7FFF)
        scale = self._scale if not values.get((0x607E, 0), 0) & _TORQUE_TURNED else -self._scale
        wanted_command = (
            target * scale * self.faults.torque_sign * self.faults.torque_gain,
            enabled,
            values.get((0x6080, 0), _NO_SPEED_CLAMP) * _RPM / settings.gear_ratio,
        )
        if wanted_command != (command.torque, command.enabled, command.max_speed):
            self.before_change(self.node.now)
            command.torque, command.enabled, command.max_speed = wanted_command

    def _demand(self) -> int:
        """Return the torque before any limit, in digits of 0x6071: with the offset 0x60B2, or with the ramp 0x6087.

        Source: CiA 402-2, cyclic synchronous torque mode and profile torque mode.
        """
        values, now = self.values, self.node.now
        mode, target = self._mode(), values.get((0x6071, 0), 0)
        elapsed, self._ramped_at = now - self._ramped_at, now
        if mode == CST:
            return target + self._digits(values.get((0x60B2, 0), 0))
        if mode != _PROFILE_TORQUE:
            self._ramp = 0.0
            return 0
        step = elapsed * self._digits(values.get((0x6087, 0), 0))
        self._ramp += max(-step, min(step, target - self._ramp))
        return round(self._ramp)

    def _mode(self) -> int:
        """Return the mode of operation; 0 in a drive without 0x6060."""
        return self.values.get((0x6060, 0), 0)

    def _digits(self, per_mille: int) -> int:
        """Convert per mille of the rated torque to digits of 0x6071."""
        return round(per_mille * self.emulation.torque_digits / 1000.0)

    def _limits(self) -> tuple[int, int]:
        """Return the largest torque backward and forward, in digits of 0x6071."""
        most = min(self._clamp(), self._digits(self.values.get((0x6073, 0), _NO_CLAMP)))
        forward, backward = (self._digits(self.values.get((index, 0), _NO_CLAMP)) for index in (0x60E0, 0x60E1))
        return min(most, backward), min(most, forward)

    def _clamp(self) -> int:
        """Return the torque limit of the objects and of an overheated drive, in digits of 0x6071."""
        share = self.faults.most_torque
        most = self._written_clamp()
        return most if share is None else min(most, round(share * self.emulation.torque_digits))

    def _written_clamp(self) -> int:
        """Return the torque limit of the objects alone, in digits of 0x6071."""
        values = self.values
        clamp = self.emulation.clamp
        if clamp is not None and clamp.key in values:
            rated = values[clamp.rated] if isinstance(clamp.rated, tuple) else clamp.rated
            share = (values[clamp.key] - clamp.zero) / ((rated - clamp.zero) or 1)
            return math.floor(max(0.0, share) * self.emulation.torque_digits + 1e-9)
        return round(values.get((0x6072, 0), _NO_CLAMP) * self.emulation.torque_digits / 1000.0)

    def _velocity_digit(self) -> float:
        """Return the motor speed per digit of 0x606C, rad/s."""
        if self.emulation.velocity_digits is not None:
            return 2.0 * math.pi / self.settings.counts_per_revolution / self.emulation.velocity_digits
        exponent = self.values.get((0x60A9, 0), self._unit_code) >> 24
        return float(_RPM * 10.0 ** (exponent - 256 if exponent > 127 else exponent))

    def power_off(self) -> None:
        self.machine.voltage_off()
        self._obey()

    # to the master

    def statusword(self) -> int:
        settings = self.settings
        word = self.machine.state | _REMOTE | settings.statusword_bits
        if not (settings.safe_torque_off or self.faults.torque_off or self.faults.dead_stage):
            word |= _VOLTAGE_ENABLED
        if self.limited or self.readings.speed_limited:
            word |= _INTERNAL_LIMIT
        follows = self._mode() == CST and not self.faults.ignore_command
        if self.machine.state is PowerState.OPERATION_ENABLED and follows and settings.reports_following:
            word |= _FOLLOWS_COMMAND
        if self.values[0x1001, 0] and self.machine.state is not PowerState.FAULT:
            word |= _WARNING
        return word

    def sample(self) -> None:
        if self.faults.clock_drift is not None:
            cycle = math.floor(self.node.now * (1.0 + self.faults.clock_drift) / _OWN_CYCLE)
            if cycle == self._own_cycle:
                return
            self._own_cycle = cycle
        values, settings, readings = self.values, self.settings, self.readings
        gear, polarity = settings.gear_ratio, values.get((0x607E, 0), 0)
        digits = (
            self.emulation.torque_digits
            * settings.torque_sign
            * self.faults.torque_sign
            / (settings.rated_torque * gear)
        ) / self.faults.torque_gain
        digits *= _turned(polarity & _TORQUE_TURNED)
        sign = settings.position_sign * self.faults.turned
        turns = sign * _turned(polarity & _POSITION_TURNED) * gear / (2.0 * math.pi)
        velocity = sign * _turned(polarity & _VELOCITY_TURNED) * gear * readings.motor_speed / self._velocity_digit()
        torque = readings.motor_torque
        if settings.torque_noise > 0.0:
            torque += self._noise.gauss(0.0, settings.torque_noise)
        values[0x6041, 0] = self.statusword()
        mode = self.faults.wrong_mode
        values[0x6061, 0] = self._mode_shown() if mode is None else mode
        values[0x60FD, 0] = self.faults.inputs
        values[0x6077, 0] = _reported(0x6077, round(torque * digits))
        values[0x606C, 0] = _reported(0x606C, round(velocity))
        values[0x6064, 0] = _reported(0x6064, math.floor(readings.motor_angle * turns * settings.counts_per_revolution))
        for index, distorted in self.faults.distortions:
            values[index, 0] = _reported(index, distorted(values[index, 0]))

    def _mode_shown(self) -> int:
        when = self.settings.mode_shows
        operational = self.node.state is NmtState.OPERATIONAL
        enabled = self.machine.state is PowerState.OPERATION_ENABLED
        shown = enabled if when == "enabled" else operational or when == "written"
        return self._mode() if shown else 0


def _turned(bit: int) -> int:
    """Return the sign that this bit of 0x607E selects."""
    return -1 if bit else 1


def _bounded(value: int, bound: int) -> int:
    return max(-bound, min(bound, value))


def _reported(index: int, value: int) -> int:
    """Return a measured value as its object holds it: a position wraps at 32 bits, torque and velocity saturate."""
    if index == 0x6064:
        return (value + 0x80000000 & 0xFFFFFFFF) - 0x80000000
    return _bounded(value, 0x7FFF if index == 0x6077 else 0x7FFFFFFF)
