"""A CiA 402 drive on durand, a third-party CANopen stack.

The drive has no heartbeat consumer, no RPDO event timer and no 0x6007. `Durand` attaches it to a wire in virtual time.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from durand import MinimalNode
from durand.datatypes import DatatypeEnum
from durand.network import NetworkABC
from durand.object_dictionary import Record, Variable
from durand.scheduler import VirtualScheduler, set_scheduler

from tsa_ctrl.bus.wire.bus import Frame
from tsa_ctrl.virtual.lockstep import Wire

NODE = 3
U8, U16, U32 = DatatypeEnum.UNSIGNED8, DatatypeEnum.UNSIGNED16, DatatypeEnum.UNSIGNED32
I8, I16, I32 = DatatypeEnum.INTEGER8, DatatypeEnum.INTEGER16, DatatypeEnum.INTEGER32
OBJECTS = (  # index, type, access, power-on value
    (0x603F, U16, "ro", 0), (0x6040, U16, "rw", 0), (0x6041, U16, "ro", 0x0250), (0x605A, I16, "rw", 2),
    (0x605E, I16, "rw", 2), (0x6060, I8, "rw", 0), (0x6061, I8, "ro", 0), (0x6064, I32, "ro", 0),
    (0x606C, I32, "ro", 0), (0x6071, I16, "rw", 0), (0x6072, U16, "rw", 1000), (0x6076, U32, "ro", 1000),
    (0x6077, I16, "ro", 0), (0x6080, U32, "rw", 3000), (0x60A9, U32, "rw", 0x00B44700), (0x6502, U32, "ro", 0x200),
    (0x60B2, I16, "rw", 120),  # per mille of the rated torque, as if left by another tool
)  # fmt: skip
DISABLED, READY, ON, ENABLED = 0x0250, 0x0231, 0x0233, 0x1237
STEPS = {(DISABLED, 0x06): READY, (READY, 0x07): ON, (ON, 0x0F): ENABLED, (ENABLED, 0x06): READY, (ON, 0x06): READY}


class DurandDrive:
    """The application of the drive: its state machine and its torque.

    The torque follows the target plus the torque offset without delay, up to the max torque 0x6072.
    """

    def __init__(self, network: NetworkABC) -> None:
        self.node = MinimalNode(network, node_id=NODE)
        dictionary = self.node.object_dictionary
        for index, kind, access, value in OBJECTS:
            dictionary[index] = Variable(kind, access, value)
        period = Record(name="interpolation time period")
        period[1], period[2] = Variable(U8, "rw", 1), Variable(I8, "rw", -3)
        dictionary[0x60C2] = period
        dictionary.write(0x1000, 0, 0x00020192)
        dictionary.write(0x1018, 1, 0x0F0F)
        for index, react in ((0x6040, self._control), (0x6060, self._set_mode), (0x6071, self.pull)):
            dictionary.update_callbacks[index, 0].add(react)

    def get(self, index: int, subindex: int = 0) -> int:
        return int(self.node.object_dictionary.read(index, subindex))

    def _control(self, controlword: int) -> None:
        state = self.get(0x6041)
        after = DISABLED if controlword & 0x02 == 0 else STEPS.get((state, controlword), state)
        self.node.object_dictionary.write(0x6041, 0, after)
        self.pull(self.get(0x6071))

    def _set_mode(self, mode: int) -> None:
        self.node.object_dictionary.write(0x6061, 0, mode)

    def pull(self, target: int) -> None:
        limit = self.get(0x6072)
        wanted = target + self.get(0x60B2)
        delivered = max(-limit, min(limit, wanted)) if self.get(0x6041) == ENABLED else 0
        self.node.object_dictionary.write(0x6077, 0, delivered)


class Durand(NetworkABC):
    """Connect durand's network to the plant's end of a wire."""

    def __init__(self, wire: Wire) -> None:
        self._wire = wire
        self._heard: dict[int, Callable[[int, bytes], None]] = {}
        self._scheduler = VirtualScheduler()
        self._time = wire.now
        set_scheduler(self._scheduler)
        self.drive = DurandDrive(self)
        wire.attach(self)

    def add_subscription(self, cob_id: int, callback: Any) -> None:
        self._heard[cob_id] = callback

    def remove_subscription(self, cob_id: int, callback: Any = None) -> None:
        self._heard.pop(cob_id, None)

    def send(self, cob_id: int, msg: bytes) -> None:
        self._wire.plant.send(cob_id & 0x7FF, bytes(msg))

    @property
    def due(self) -> float:
        waiting = self._scheduler._timestamp_dict.values()
        return min(waiting) if waiting else math.inf

    def step(self, frame: Frame | None, now: float) -> None:
        self._scheduler.run(now - self._time + 1e-12)
        self._time = now
        handler = None if frame is None else self._heard.get(frame[0])
        if frame is not None and handler is not None:
            handler(frame[0], frame[1])
