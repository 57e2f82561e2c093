"""A CiA 402 drive in cyclic synchronous torque mode, as a node: objects, limits, reactions, units of the wire.

The power stage and the motor are elsewhere: the drive writes its command to a `MotorCommand` and reads `Readings`;
`before_change` brings the mechanics up to now before a command changes.
"""

from __future__ import annotations

import dataclasses
import math
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import msgspec

from tsa_ctrl.errors import UsageError
from tsa_ctrl.plant.cia402 import PowerState, PowerStateMachine
from tsa_ctrl.plant.dictionary import AbortCode, Access, Entry, Key, SdoAbort, Type
from tsa_ctrl.plant.node import EmcyCode, Identity, Node, Send
from tsa_ctrl.plant.pdo import INVALID, PdoDefault
from tsa_ctrl.plant.persona import CURRENT, LIMIT, PERSONAS, RPM, Persona
from tsa_ctrl.plant.readings import MotorCommand, Readings
from tsa_ctrl.plant.settings import DriveSettings

DEVICE_TYPE = 0x00020192  # servo drive, CiA 402
CST = 10  # cyclic synchronous torque mode
_CST_SUPPORTED = 1 << 9  # 0x6502
_RPM = 2.0 * math.pi / 60.0  # rad/s
_VOLTAGE_ENABLED, _WARNING, _REMOTE = 1 << 4, 1 << 7, 1 << 9
_INTERNAL_LIMIT, _FOLLOWS_COMMAND = 1 << 11, 1 << 12
_ERROR_REGISTER_PROFILE = 0x20
_OWN_CYCLE = 1e-3  # s, of a drive that does not follow the SYNC
_POWERED = (PowerState.SWITCHED_ON, PowerState.OPERATION_ENABLED, PowerState.QUICK_STOP_ACTIVE)
_RESTING = 0.01  # of rated torque: below it a quick stop or a fault reaction is complete


class ConnectionLoss(int):
    """0x6007: what the drive does when the connection is lost."""

    NOTHING = 0
    FAULT = 1
    DISABLE_VOLTAGE = 2
    QUICK_STOP = 3


@dataclass(slots=True)
class DriveFaults:
    """Misbehaviour of the drive itself that can be switched on."""

    ignore_command: bool = False  # bit 12 low, the target torque is not followed
    wrong_mode: int | None = None  # what 0x6061 says
    torque_sign: int = 1  # -1: motor wired the wrong way round
    clock_drift: float | None = None  # relative; the drive samples by a clock of its own, not at the SYNC


class Drive(Node):
    """See the module; `readings` is what its own sensors measure, `command` what its power stage does."""

    def __init__(
        self, settings: DriveSettings, readings: Readings, command: MotorCommand, noise: random.Random, send: Send
    ) -> None:
        self.persona = persona = PERSONAS[settings.kind]
        if persona.vendor is not None and persona.product is not None:
            settings = msgspec.structs.replace(
                settings, name=persona.name, vendor=persona.vendor, product=persona.product
            )
        if persona.rated_torque_unit is not None:
            settings = msgspec.structs.replace(settings, rated_torque_unit=persona.rated_torque_unit)
        self.settings = settings
        self._noise = noise
        self.readings = readings
        self.command = command
        self.machine = PowerStateMachine()
        self.faults = DriveFaults()
        self.error_cause = False  # the cause of the fault is still there
        self.limited = False
        self._own_cycle = 0
        self._unit_code = _unit_code(settings)  # of a drive that does not have 0x60A9
        self.before_change: Callable[[float], None] = lambda now: None
        assert settings.node_id is not None
        node = settings.node_id
        off = PdoDefault(INVALID)
        identity = Identity(DEVICE_TYPE, settings.name, settings.vendor, settings.product)
        tpdos = (
            PdoDefault(0x180 + node, 255, ((0x6041, 0),)),
            PdoDefault(INVALID | 0x280 + node, 1, ()),
            PdoDefault(INVALID | 0x380 + node, 1, ()),
            PdoDefault(INVALID | 0x480 + node, 1, ()),
        )
        rpdos = (PdoDefault(0x200 + node, 255, ((0x6040, 0),)), off, off, off)
        super().__init__(node, identity, _objects(settings), tpdos, rpdos, send)
        hooks = self.dictionary.on_write
        hooks[0x6040, 0] = self._write_controlword
        hooks[0x6060, 0] = self._write_mode
        self._impersonate(persona)
        for absent in settings.absent:
            if isinstance(absent, int):
                self.dictionary.remove(absent)
            else:
                self.dictionary.remove(*_key(absent))
        for name, value in settings.objects.items():
            self._override(name, value)

    def _impersonate(self, persona: Persona) -> None:
        """Objects of the maker, and what the standard's objects do otherwise."""
        dictionary = self.dictionary
        for entry in persona.added:
            dictionary.add(entry)
        for key, value in persona.defaults.items():
            dictionary.add(dataclasses.replace(dictionary.entries[key], default=value))
        for key in persona.read_only:
            dictionary.add(dataclasses.replace(dictionary.entries[key], access=Access.RO))
        for key in {*persona.fixed, *persona.off_only}:
            dictionary.on_write[key] = self._guard(key, persona)
        for index, sub in persona.absent:
            dictionary.remove(index, sub)

    def _guard(self, key: Key, persona: Persona) -> Callable[[int], None]:
        allowed, off_only = persona.fixed.get(key), key in persona.off_only

        def check(value: int) -> None:
            if allowed is not None and value not in allowed:
                raise SdoAbort(AbortCode.INVALID_VALUE)
            if off_only and self.machine.state in _POWERED:
                raise SdoAbort(AbortCode.DEVICE_STATE)

        return check

    def _override(self, name: str, value: int) -> None:
        """`"0x6076:0" = 1000`: another power-on value, to imitate a drive."""
        entry = self.dictionary.entries.get(_key(name))
        if entry is None:
            raise UsageError(f"[axis.drive] objects: there is no {name} in this drive; correct index and sub-index")
        self.dictionary.add(
            Entry(entry.index, entry.sub, entry.type, entry.access, value, entry.mappable, entry.low, entry.high)
        )

    def power_on(self) -> None:
        self.machine.power_on()
        self.error_cause = False
        self._obey()

    # from the master

    def _write_controlword(self, value: int) -> None:
        self._control(value)

    def _write_mode(self, value: int) -> None:
        if value not in (0, CST) or (value == CST and not self.values[0x6502, 0] & _CST_SUPPORTED):
            raise SdoAbort(AbortCode.INVALID_VALUE)

    def written(self, keys: Sequence[Key]) -> None:
        if (0x6040, 0) in keys:
            self._control(self.values[0x6040, 0])
        self._obey()

    def _control(self, controlword: int) -> None:
        before = self.machine.state
        self.machine.control(controlword, self.values[0x605A, 0] >= 5, not self.error_cause)
        if before is PowerState.FAULT and self.machine.state is not PowerState.FAULT:
            self.values[0x603F, 0] = 0
            self.emergency(EmcyCode.NO_ERROR, 0)
        self._obey()

    # reactions

    def fault(self, code: int, vendor: bytes = bytes(5), stays: bool = False) -> None:
        """An error of the drive: EMCY, 0x603F, fault reaction. `stays`: reset does not help until it is cleared."""
        self.values[0x603F, 0] = code
        self.error_cause = stays
        self.emergency(code, _ERROR_REGISTER_PROFILE, vendor)
        self.machine.fault()
        self._obey()

    def communication_error(self, code: EmcyCode) -> None:
        enabled = self.machine.state in (PowerState.OPERATION_ENABLED, PowerState.QUICK_STOP_ACTIVE)
        if code is EmcyCode.RPDO_TIMEOUT and enabled and self.settings.watchdogs:
            self.fault(code)
        else:
            super().communication_error(code)

    def connection_lost(self) -> None:
        enabled = self.machine.state in (PowerState.OPERATION_ENABLED, PowerState.QUICK_STOP_ACTIVE)
        if not enabled or not self.settings.watchdogs:
            return
        reaction = self.values.get((0x6007, 0), 0)
        if reaction == ConnectionLoss.FAULT:
            self.fault(EmcyCode.HEARTBEAT)
        elif reaction == ConnectionLoss.DISABLE_VOLTAGE:
            self.machine.voltage_off()
        elif reaction == ConnectionLoss.QUICK_STOP:
            self._quick_stop()
        self._obey()

    def _quick_stop(self) -> None:
        if self.values[0x605A, 0] == 0:
            self.machine.voltage_off()
        else:
            self.machine.quick_stop()

    # power stage

    def tick(self, now: float) -> None:
        if self.powered:
            self._settle()
            self._obey()
        super().tick(now)

    def _settle(self) -> None:
        """Complete what waits for the torque to be gone."""
        state = self.machine.state
        if state not in (PowerState.QUICK_STOP_ACTIVE, PowerState.FAULT_REACTION_ACTIVE):
            return
        resting = abs(self.readings.motor_torque) <= _RESTING * self.settings.rated_torque * self.settings.gear_ratio
        if state is PowerState.FAULT_REACTION_ACTIVE and (resting or self.values[0x605E, 0] == 0):
            self.machine.reaction_done()
        elif state is PowerState.QUICK_STOP_ACTIVE and resting and self.values[0x605A, 0] < 5:
            self.machine.voltage_off()

    def _obey(self) -> None:
        """State and objects to the power stage. Outside of operation enabled there is no torque."""
        values, settings, command = self.values, self.settings, self.command
        enabled = self.powered and self.machine.state is PowerState.OPERATION_ENABLED
        target = 0
        self.limited = False
        if enabled and values[0x6060, 0] == CST and not self.faults.ignore_command:
            wanted, limit = values[0x6071, 0], self._clamp()
            target = max(-limit, min(limit, wanted))
            self.limited = target != wanted
        scale = settings.torque_sign * settings.rated_torque * settings.gear_ratio * 1e-3
        wanted_command = (
            target * scale * self.faults.torque_sign,
            enabled,
            values[0x6080, 0] * _RPM / settings.gear_ratio,
        )
        if wanted_command != (command.torque, command.enabled, command.max_speed):
            self.before_change(self.now)
            command.torque, command.enabled, command.max_speed = wanted_command

    def _clamp(self) -> int:
        """Largest torque, per mille of rated."""
        values = self.values
        if self.persona.limited_by_current:
            return values[LIMIT] * 1000 // max(1, values[CURRENT])
        return values[0x6072, 0]

    def _velocity_digit(self) -> float:
        """rad/s of the motor per digit of 0x606C."""
        if self.persona.velocity_in_counts:
            return 2.0 * math.pi / self.settings.counts_per_revolution
        exponent = self.values.get((0x60A9, 0), self._unit_code) >> 24
        return float(_RPM * 10.0 ** (exponent - 256 if exponent > 127 else exponent))

    def power_off(self) -> None:
        super().power_off()
        self.machine.voltage_off()
        self._obey()

    # to the master

    def statusword(self) -> int:
        word = self.machine.state.value | _VOLTAGE_ENABLED | _REMOTE
        if self.limited or self.readings.speed_limited:
            word |= _INTERNAL_LIMIT
        follows = self.values[0x6060, 0] == CST and not self.faults.ignore_command
        if self.machine.state is PowerState.OPERATION_ENABLED and follows:
            word |= _FOLLOWS_COMMAND
        if self.values[0x1001, 0] and self.machine.state is not PowerState.FAULT:
            word |= _WARNING
        return word

    def sample(self) -> None:
        if self.faults.clock_drift is not None:
            cycle = math.floor(self.now * (1.0 + self.faults.clock_drift) / _OWN_CYCLE)
            if cycle == self._own_cycle:
                return
            self._own_cycle = cycle
        values, settings, readings = self.values, self.settings, self.readings
        gear = settings.gear_ratio
        per_mille = 1e3 * settings.torque_sign * self.faults.torque_sign / (settings.rated_torque * gear)
        turns = settings.position_sign * gear / (2.0 * math.pi)
        velocity = settings.position_sign * gear * readings.motor_speed / self._velocity_digit()
        torque = readings.motor_torque
        if settings.torque_noise > 0.0:
            torque += self._noise.gauss(0.0, settings.torque_noise)
        values[0x6041, 0] = self.statusword()
        mode = self.faults.wrong_mode
        values[0x6061, 0] = values[0x6060, 0] if mode is None else mode
        values[0x6077, 0] = _bounded(round(torque * per_mille), 0x7FFF)
        values[0x606C, 0] = _bounded(round(velocity), 0x7FFFFFFF)
        values[0x6064, 0] = _wrapped(math.floor(readings.motor_angle * turns * settings.counts_per_revolution))


def _unit_code(settings: DriveSettings) -> int:
    """0x60A9: 10^exponent revolutions per minute."""
    return (settings.velocity_exponent & 0xFF) << 24 | RPM


def _key(name: str) -> Key:
    """`"0x6076:0"`, `"0x6076"`: index and sub-index."""
    index, _, sub = name.partition(":")
    return int(index, 16), int(sub or "0")


def _bounded(value: int, bound: int) -> int:
    return max(-bound, min(bound, value))


def _wrapped(counts: int) -> int:
    """A position counter of 32 bits wraps."""
    return (counts + 0x80000000 & 0xFFFFFFFF) - 0x80000000


def _objects(settings: DriveSettings) -> list[Entry]:
    ro, rw = Access.RO, Access.RW
    rated = round(settings.rated_torque / settings.rated_torque_unit)
    return [
        Entry(0x6007, 0, Type.I16, rw, 1, low=0, high=3),
        Entry(0x603F, 0, Type.U16, ro, mappable=True),
        Entry(0x6040, 0, Type.U16, rw, mappable=True),
        Entry(0x6041, 0, Type.U16, ro, mappable=True),
        Entry(0x605A, 0, Type.I16, rw, 2, low=0, high=7),
        Entry(0x605B, 0, Type.I16, rw, 0, low=0, high=1),
        Entry(0x605C, 0, Type.I16, rw, 1, low=0, high=1),
        Entry(0x605D, 0, Type.I16, rw, 1, low=1, high=4),
        Entry(0x605E, 0, Type.I16, rw, 2, low=0, high=4),
        Entry(0x6060, 0, Type.I8, rw, 0, mappable=True),
        Entry(0x6061, 0, Type.I8, ro, 0, mappable=True),
        Entry(0x6064, 0, Type.I32, ro, mappable=True),
        Entry(0x606C, 0, Type.I32, ro, mappable=True),
        Entry(0x6071, 0, Type.I16, rw, 0, mappable=True),
        Entry(0x6072, 0, Type.U16, rw, 1000, mappable=True, high=5000),
        Entry(0x6075, 0, Type.U32, rw, 5000),  # mA
        Entry(0x6076, 0, Type.U32, rw, rated),
        Entry(0x6077, 0, Type.I16, ro, mappable=True),
        Entry(0x6080, 0, Type.U32, rw, 3000),  # rpm of the motor
        Entry(0x6087, 0, Type.U32, rw, 100_000),  # per mille of rated torque per s
        Entry(0x60A9, 0, Type.U32, rw, _unit_code(settings)),
        Entry(0x60C2, 0, Type.U8, Access.CONST, 2),
        Entry(0x60C2, 1, Type.U8, rw, 1, low=1),
        Entry(0x60C2, 2, Type.I8, rw, -3, low=-6, high=0),
        Entry(0x6502, 0, Type.U32, ro, _CST_SUPPORTED),
    ]
