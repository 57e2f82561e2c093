"""A node with one CiA 402 drive, or with several: their objects lie 0x800 apart, their PDOs 0x40."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

from tsa_ctrl.errors import UsageError
from tsa_ctrl.plant.cia402 import PowerState
from tsa_ctrl.plant.dictionary import AbortCode, Access, Entry, Key, SdoAbort, Type
from tsa_ctrl.plant.drive import Drive
from tsa_ctrl.plant.drive_objects import AXIS_OFFSET, objects, pdos, shifted
from tsa_ctrl.plant.emergency import EmcyCode
from tsa_ctrl.plant.identity import Identity
from tsa_ctrl.plant.node import Node, Send
from tsa_ctrl.plant.persona import Persona

DEVICE_TYPE = 0x00020192  # servo drive, CiA 402
_SEVERAL = 0xFFFF0000  # additional information of a device with several axes (CiA 301, 7.5.2.1)
_POWERED = (PowerState.SWITCHED_ON, PowerState.OPERATION_ENABLED, PowerState.QUICK_STOP_ACTIVE)


class DriveNode(Node):
    """Identity, quirks of the communication and persona are those of its first drive."""

    def __init__(self, drives: Sequence[Drive], send: Send) -> None:
        first = drives[0].settings
        assert first.node_id is not None
        self.drives = tuple(drives)
        several = len(drives) > 1
        device_type = DEVICE_TYPE & 0xFFFF | _SEVERAL if several else DEVICE_TYPE
        serial = first.node_id if first.serial_number is None else first.serial_number
        identity = Identity(device_type, first.name, first.vendor, first.product, serial=serial)
        entries, tpdos, rpdos = [], [], []
        for drive in drives:
            offset = (drive.settings.slot - 1) * AXIS_OFFSET
            for entry in objects(drive.settings):
                entries.append(dataclasses.replace(entry, index=entry.index + offset))
            if several:
                entries.append(Entry(0x67FF + offset, 0, Type.U32, Access.CONST, DEVICE_TYPE))
            sent, received = pdos(drive.settings)
            tpdos += sent
            rpdos += received
        self._controlwords = tuple(shifted((0x6040, 0), (d.settings.slot - 1) * AXIS_OFFSET) for d in drives)
        super().__init__(first.node_id, identity, entries, tpdos, rpdos, send, first)
        for drive in drives:
            drive.attach(self)
            self._impersonate(drive)
            self._apply_quirks(drive)

    # what the drives add to a node

    def power_on(self) -> None:
        for drive in self.drives:
            drive.power_on()

    def power_off(self) -> None:
        super().power_off()
        for drive in self.drives:
            drive.power_off()

    def sample(self) -> None:
        for drive in self.drives:
            drive.sample()

    def written(self, keys: Sequence[Key]) -> None:
        for drive, controlword in zip(self.drives, self._controlwords, strict=True):
            drive.written(controlword in keys)

    def connection_lost(self, overdue: bool) -> None:
        for drive in self.drives:
            drive.connection_lost(overdue)

    def communication_error(self, code: EmcyCode) -> None:
        taken = [drive.communication_error(code) for drive in self.drives]
        if not any(taken):
            super().communication_error(code)

    def tick(self, now: float) -> None:
        if self.powered:
            self.now = now
            for drive in self.drives:
                drive.tick()
        super().tick(now)

    # what a maker, or the settings, make different

    def _impersonate(self, drive: Drive) -> None:
        """Objects of the maker, and what the standard's objects do otherwise."""
        dictionary, persona = self.dictionary, drive.persona
        offset = (drive.settings.slot - 1) * AXIS_OFFSET
        for entry in persona.added:
            dictionary.add(entry)
        for key, value in persona.defaults.items():
            self._replace(shifted(key, offset), default=value)
        for key in persona.read_only:
            self._replace(shifted(key, offset), access=Access.RO)
        for key in {*persona.fixed, *persona.off_only}:
            dictionary.on_write[shifted(key, offset)] = _guard(key, persona, drive)
        for index, sub in persona.absent:
            dictionary.remove(shifted((index, 0), offset)[0], sub)

    def _apply_quirks(self, drive: Drive) -> None:
        settings, dictionary = drive.settings, self.dictionary
        offset = (settings.slot - 1) * AXIS_OFFSET
        for absent in settings.absent:
            index, sub = (absent, None) if isinstance(absent, int) else _place(absent)
            dictionary.remove(shifted((index, 0), offset)[0], sub)
        for name, value in settings.objects.items():
            index, sub = _place(name)
            key = shifted((index, sub or 0), offset)
            if key not in dictionary.entries:
                raise UsageError(f"[axis.drive] objects: there is no {name} in this drive; correct index and sub-index")
            self._replace(key, default=value, plus_node=False)
        mapping = [f"0x{base + n:04X}" for base in (0x1600, 0x1A00) for n in range(4)] if settings.fixed_mapping else []
        for name in [*settings.read_only, *mapping]:
            index, sub = _place(name)
            for key in [key for key in dictionary.entries if key[0] == shifted((index, 0), offset)[0]]:
                if sub in (None, key[1]):
                    self._replace(key, access=Access.RO)

    def _replace(self, key: Key, **changes: object) -> None:
        entry = self.dictionary.entries[key]
        self.dictionary.add(dataclasses.replace(entry, **changes))  # type: ignore[arg-type]


def _guard(key: Key, persona: Persona, drive: Drive) -> Callable[[int], None]:
    allowed, off_only = persona.fixed.get(key), key in persona.off_only

    def check(value: int) -> None:
        if allowed is not None and value not in allowed:
            raise SdoAbort(AbortCode.INVALID_VALUE)
        if off_only and drive.machine.state in _POWERED:
            raise SdoAbort(AbortCode.DEVICE_STATE)

    return check


def _place(name: str) -> tuple[int, int | None]:
    """`"0x6076:0"`, `"0x6076"`: index, and sub-index if it is named."""
    index, colon, sub = name.partition(":")
    return int(index, 16), int(sub) if colon else None
