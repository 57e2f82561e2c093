"""A loop on a fake bus with simple CiA 402 nodes and a simulated clock."""

from __future__ import annotations

import itertools
import math
import shutil
import struct
from collections.abc import Callable, Iterable
from pathlib import Path

from tests.bus.fake import FakeBus, FakeClock
from tests.bus.nodes import Responder
from tsa_ctrl.bus.live.rig import Rig
from tsa_ctrl.bus.wire.bus import Frame
from tsa_ctrl.config import load_configuration
from tsa_ctrl.daemon.build import control_axes, tuners_of
from tsa_ctrl.daemon.loop import Loop
from tsa_ctrl.daemon.notices import Events
from tsa_ctrl.daemon.telemetry import Telemetry
from tsa_ctrl.ipc.mailbox import Mailbox
from tsa_ctrl.log.ring import RingReader, RingWriter
from tsa_ctrl.signals import FIELD_NAMES

CONFIG = Path(__file__).resolve().parents[2] / "config"
SWITCH_ON_DISABLED, READY, SWITCHED_ON, ENABLED, FAULT = 0x1250, 0x1231, 0x1233, 0x1237, 0x1218
WALK = {  # statusword after a controlword, by state
    (SWITCH_ON_DISABLED, 0x06): READY,
    (READY, 0x07): SWITCHED_ON,
    (SWITCHED_ON, 0x0F): ENABLED,
    (ENABLED, 0x06): READY,
    (SWITCHED_ON, 0x06): READY,
}
MOST_CYCLES = 20_000
CONSTANT = ('kind = "sine"  ', 'kind = "constant"\noffset = 0.5  ')
HERE = "# Sensors on serial lines that send"  # heading of this section in the example file
CELLS = "".join(f'[[axis.serial]]\nquantity = "{name}"\nport = "/dev/{name}"\n\n' for name in ("t1", "t3"))
WITH_CELLS = (HERE, CELLS + HERE)
BARE = ("# compensation = 0.95", "compensation = 0.0")  # motor torque is r_M/r_J times the set-point
TICK = 2e-5  # s by which the clock advances at each reading


class Drive(Responder):
    """Drive 1, encoder 32 and sensor 64 of one axis.

    The drive follows its controlword and delivers the commanded torque immediately.
    """

    def __init__(self) -> None:
        super().__init__()
        self.statusword = SWITCH_ON_DISABLED
        self.commands: list[tuple[int, int]] = []  # (controlword, target torque in per mille)
        self.beats = 0
        self.at_sync: dict[int, Callable[[], None]] = {}
        self.extra: list[Frame] = []
        self.heartbeat = True

    def __call__(self, frame: Frame) -> Iterable[Frame]:
        can_id, data = frame
        if can_id == 0x201:
            self._obey(*struct.unpack("<Hh", data))
        if can_id != 0x080:
            return []
        self.beats += 1
        assert self.beats < MOST_CYCLES, "the loop does not end"
        action = self.at_sync.pop(self.beats, None)
        if action is not None:
            action()
        alive = [(0x700 + node, b"\x05") for node in (1, 32, 64)] if self.heartbeat and self.beats % 10 == 1 else []
        extra, self.extra = self.extra, []
        return [*self.frames(), *alive, *extra]

    def _obey(self, controlword: int, target: int) -> None:
        self.commands.append((controlword, target))
        before = self.commands[-2][0] if len(self.commands) > 1 else 0
        if self.statusword == FAULT:
            if controlword & 0x80 and not before & 0x80:
                self.statusword, self.error_code = SWITCH_ON_DISABLED, 0
        elif controlword & 0x02 == 0:
            self.statusword = SWITCH_ON_DISABLED
        else:
            self.statusword = WALK.get((self.statusword, controlword), self.statusword)
        self.torque = target if self.statusword == ENABLED else 0

    def fail(self) -> None:
        """Enter the fault state and send an emergency message."""
        self.statusword, self.error_code = FAULT, 0x2310
        self.extra.append((0x081, struct.pack("<HB5x", 0x2310, 0x02)))

    @property
    def torques(self) -> list[int]:
        return [torque for _, torque in self.commands]


class Machine:
    """All parts of a daemon without its processes: configuration, rig, axes, loop and shared memory."""

    def __init__(self, folder: Path, *edits: tuple[str, str], drive: Drive | None = None) -> None:
        for name in ("controller.toml", "actuator.toml"):
            shutil.copy(CONFIG / name, folder)
        path = folder / "controller.toml"
        text = path.read_text(encoding="utf-8")
        for before, after in [("# settle_cycles = 100 ", "settle_cycles = 5 "), *edits]:
            assert before in text, before
            text = text.replace(before, after, 1)
        path.write_text(text, encoding="utf-8")
        self.configuration = load_configuration(path)
        file = self.configuration.file
        self.drive = drive or Drive()
        self.bus = FakeBus(FakeClock(), self.drive)
        self.rig = Rig(self.bus, file.bus, file.axes, self.configuration.profiles)
        self.axes = control_axes(self.configuration, self.rig)
        self.axis = self.axes[0]
        tuners = tuners_of(self.axes, self.configuration.period)
        self.names = [parameter.name for parameter in tuners[0].parameters]
        self.mailbox = Mailbox(len(self.axes), len(self.names))
        self.ring = RingWriter(len(self.axes))
        self.events = Events()
        telemetry = Telemetry(self.rig, self.axes, tuners, self.mailbox, self.ring, None, self.events)
        self.loop = Loop(
            self.rig,
            self.axes,
            tuners,
            self.mailbox,
            telemetry,
            self.events,
            file.controller,
            file.bus.supervision,
            self._now,
        )
        self.rig.start()

    def _now(self) -> int:
        """Return the bus time for the loop (ns). Each call advances it by `TICK`."""
        self.bus.clock.now += TICK
        return round(self.bus.clock.now * 1e9)

    def wake_late(self, cycle: int, seconds: float) -> None:
        """Make the wait of the given cycle end too late by `seconds`."""
        wait, waits = self.rig.wait, itertools.count(1)
        self.rig.wait = lambda until: wait(until + (seconds if next(waits) == cycle else 0.0))  # type: ignore[method-assign]

    def run(self, seconds: float = math.inf) -> None:
        self.loop.run(seconds)

    def records(self) -> dict[str, list[float]]:
        """Return the logged values by column name."""
        rows = RingReader(self.ring.fd).read(0)
        return {name: rows[:, n].tolist() for n, name in enumerate(FIELD_NAMES)}

    def close(self) -> None:
        self.mailbox.close()
        self.ring.close()
