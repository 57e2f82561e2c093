"""LSS slave (CiA 305): a node without an id is given one, over two identifiers that no other service uses."""

from __future__ import annotations

import struct
from collections.abc import Callable

REQUEST, ANSWER = 0x7E5, 0x7E4
_SWITCH, _NODE_ID, _BIT_TIMING, _STORE = 0x04, 0x11, 0x13, 0x17
_SELECT = range(0x40, 0x44)
_SELECTED = 0x44
_INQUIRE = range(0x5A, 0x5E)
_INQUIRE_NODE_ID = 0x5E
_OUT_OF_RANGE, _NOT_SUPPORTED = 1, 1
_UNCONFIGURED = 255


class LssSlave:
    """`identity`: vendor, product, revision, serial number. `assigned` is called when a new id becomes valid."""

    def __init__(
        self, identity: tuple[int, int, int, int], send: Callable[[int, bytes], bool], assigned: Callable[[int], None]
    ) -> None:
        self._identity = identity
        self._send = send
        self._assigned = assigned
        self._configuring = False
        self._matched = 0
        self._pending: int | None = None
        self.node_id: int | None = None
        self.stored: int | None = None  # survives a power cycle

    def receive(self, data: bytes, now: float) -> None:
        if len(data) != 8:
            return
        command = data[0]
        if command == _SWITCH:
            self._switch(data[1] == 1)
        elif command in _SELECT:
            self._select(command - _SELECT.start, int.from_bytes(data[1:5], "little"))
        elif self._configuring:
            self._configure(command, data)

    def _switch(self, configuring: bool) -> None:
        self._configuring = configuring
        if not configuring and self.node_id is None and self._pending is not None:
            self.node_id = self._pending
            self._assigned(self.node_id)

    def _select(self, place: int, value: int) -> None:
        """The four numbers in order, all of them ours."""
        self._matched = place + 1 if self._matched == place and self._identity[place] == value else 0
        if self._matched == len(self._identity):
            self._matched = 0
            self._configuring = True
            self._answer(bytes((_SELECTED,)))

    def _configure(self, command: int, data: bytes) -> None:
        if command == _NODE_ID:
            good = 1 <= data[1] <= 127
            if good:
                self._pending = data[1]
            self._answer(bytes((command, 0 if good else _OUT_OF_RANGE, 0)))
        elif command == _BIT_TIMING:
            self._answer(bytes((command, _NOT_SUPPORTED, 0)))
        elif command == _STORE:
            self.stored = self._pending
            self._answer(bytes((command, 0, 0)))
        elif command in _INQUIRE:
            self._answer(struct.pack("<BI", command, self._identity[command - _INQUIRE.start]))
        elif command == _INQUIRE_NODE_ID:
            self._answer(bytes((command, self.node_id or _UNCONFIGURED)))

    def _answer(self, data: bytes) -> None:
        self._send(ANSWER, data.ljust(8, b"\0"))
