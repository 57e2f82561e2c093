"""Simple nodes for the fake bus. Their frames are literal bytes, without the encoders of the package."""

from __future__ import annotations

import struct
from collections.abc import Iterable

from tests.bus.fake import FakeBus, FakeClock
from tsa_ctrl.bus.drive.profile import DriveProfile
from tsa_ctrl.bus.live.rig import Rig
from tsa_ctrl.bus.settings import AxisNodes, BusSettings, DriveSettings, EncoderSettings, TorqueSensorSettings
from tsa_ctrl.bus.wire.bus import Frame

OPERATION_ENABLED = 0x1637  # with bits 9, 10 and 12
READY = 0x1231


class Responder:
    """Drive 1, encoder 32 and torque sensor 64, which answer each SYNC with the values set here in device units."""

    def __init__(self) -> None:
        self.statusword = OPERATION_ENABLED
        self.torque = 0
        self.velocity = 0
        self.position = 0
        self.mode = 10
        self.error_code = 0
        self.count = 0
        self.sensor = 0
        self.silent: set[int] = set()

    def frames(self) -> list[Frame]:
        answers = [
            (0x181, struct.pack("<Hhi", self.statusword, self.torque, self.velocity)),
            (0x281, struct.pack("<ibH", self.position, self.mode, self.error_code)),
            (0x1A0, struct.pack("<I", self.count % (1 << 32))),
            (0x1C0, struct.pack("<i", self.sensor)),
        ]
        return [frame for frame in answers if frame[0] not in self.silent]

    def __call__(self, frame: Frame) -> Iterable[Frame]:
        return self.frames() if frame[0] == 0x080 else []


def axis_nodes(**drive: object) -> AxisNodes:
    """Return axis "knee" with drive 1, encoder 32 and torque sensor 64."""
    return AxisNodes(
        name="knee",
        drive=DriveSettings(node_id=1, **drive),  # type: ignore[arg-type]
        encoder=EncoderSettings(node_id=32),
        torque_sensor=TorqueSensorSettings(node_id=64),
    )


def one_axis_rig(responder: Responder | None = None, **drive: object) -> tuple[Rig, FakeBus, Responder]:
    """Return a started rig of one axis, its fake bus and the nodes that answer on it."""
    nodes = responder or Responder()
    bus = FakeBus(FakeClock(), nodes)
    rig = Rig(bus, BusSettings(), [axis_nodes(**drive)], [DriveProfile()])
    rig.start()
    return rig, bus, nodes


def cycle(rig: Rig, bus: FakeBus, period: float = 0.001) -> None:
    """Run one cycle: send SYNC, collect the answers, and advance the clock by one period."""
    start = bus.clock.now
    rig.sync()
    rig.collect(start + 0.6 * period)
    bus.clock.now = start + period
