"""A process of its own that watches the drives: `python -m tsa_ctrl.drills.listener CONTROLLER.toml`.

It is told one word per line on stdin and answers each with one line of JSON: `torque` (the last of each node), `guard`
(begin to keep samples), `quiet` (the samples; no longer on guard), `end`. Drives report on SYNC, which ends with the
loop: on guard it sends the SYNC when the loop does not. A drive that has left the operational state sends no TPDOs:
then it is asked by SDO. A drive that still has torque when the guard ends is switched off.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import struct
import sys
import time
from collections.abc import Callable

import msgspec

from tsa_ctrl.bus.canopen import cia301, objects, pdo
from tsa_ctrl.bus.canopen.cia301 import NmtCommand
from tsa_ctrl.bus.canopen.cia402 import Controlword
from tsa_ctrl.bus.drive.scale import drive_scale
from tsa_ctrl.bus.wire.connect import open_bus
from tsa_ctrl.bus.wire.seam import Bus
from tsa_ctrl.config import Configuration, load_configuration
from tsa_ctrl.drills.samples import Sample
from tsa_ctrl.errors import TsaError
from tsa_ctrl.system.signals import ignore

READY = b"ready\n"
TAKE_OVER = 3  # periods without a SYNC after which the loop counts as gone
SILENT = 0.01  # s without a TPDO after which a drive is asked by SDO
ASK = 0.004  # s between two questions
ZERO_SHARE = 0.02  # of rated torque, up to which torque counts as none
_UPLOAD = struct.Struct("<BHB4x")
_ANSWER = struct.Struct("<BHBh2x")
_WORD = 0x4B  # answer to an expedited upload of two bytes
_DOWNLOAD_WORD = struct.Struct("<BHBH2x")


class Drive:
    """One drive as the listener knows it."""

    def __init__(self, node: int, torque: float, rated: float) -> None:
        self.node = node
        self.torque_per_digit = torque
        self.zero = ZERO_SHARE * rated
        self.last: float | None = None  # N*m
        self.heard = 0.0
        self.asked = 0.0


class Listener:
    """Watches all drives of a configuration on `bus`; `step` is one look."""

    def __init__(self, configuration: Configuration, bus: Bus, clock: Callable[[], float] = time.monotonic) -> None:
        self._bus = bus
        self._clock = clock
        self._period = configuration.period
        self._drives: dict[int, Drive] = {}
        self._tpdo: dict[int, Drive] = {}
        self._sdo: dict[int, Drive] = {}
        for axis, profile in zip(configuration.file.axes, configuration.profiles, strict=True):
            settings = axis.drive
            scale = drive_scale(settings, profile, f"axis '{axis.name}'")
            drive = Drive(settings.node_id, scale.torque, settings.rated_torque * settings.gear_ratio)
            self._drives[drive.node] = drive
            self._tpdo[pdo.MOTION.cob_id(drive.node)] = drive
            self._sdo[cia301.SDO_ANSWER + drive.node] = drive
        bus.accept([cia301.SYNC, *self._tpdo, *self._sdo])
        self._synced = -1.0
        self._own_sync = 0.0
        self._guard = False
        self.took_over = False
        self.samples: list[Sample] = []

    def torques(self) -> dict[int, float | None]:
        return {drive.node: drive.last for drive in self._drives.values()}

    def guard(self) -> None:
        self._guard = True
        self.took_over = False
        self.samples = []
        self._synced = self._own_sync = self._clock()

    def quiet(self) -> list[Sample]:
        """End the guard; a drive that still has torque is switched off by every means there is."""
        self._guard = False
        for drive in self._drives.values():
            if drive.last is not None and abs(drive.last) > drive.zero:
                self.switch_off(drive)
        return self.samples

    def switch_off(self, drive: Drive) -> None:
        off = int(Controlword.DISABLE_VOLTAGE)
        key = objects.CONTROLWORD.key
        self._bus.send(pdo.COMMAND.cob_id(drive.node), pdo.COMMAND.struct.pack(off, 0))
        self._bus.send(cia301.SYNC, b"")
        self._bus.send(cia301.SDO_REQUEST + drive.node, _DOWNLOAD_WORD.pack(0x2B, *key, off))
        self._bus.send(cia301.NMT, cia301.nmt(NmtCommand.STOP, drive.node))

    def step(self, timeout: float) -> None:
        """Take one frame, or wait for it; on guard, do what the loop no longer does."""
        frame = self._bus.recv(timeout)
        now = self._clock()
        if frame is not None:
            self._take(*frame, now)
        if self._guard:
            self._stand_in(now)

    def _take(self, can_id: int, data: bytes, now: float) -> None:
        if can_id == cia301.SYNC:
            self._synced = now
            return
        drive = self._tpdo.get(can_id)
        if drive is not None and len(data) == pdo.MOTION.length:
            drive.heard = now
            self._keep(drive, pdo.MOTION.struct.unpack(data)[1], now, "tpdo")
            return
        drive = self._sdo.get(can_id)
        if drive is not None and len(data) == _ANSWER.size:
            command, index, sub, value = _ANSWER.unpack(data)
            if command == _WORD and (index, sub) == objects.TORQUE_ACTUAL.key:
                self._keep(drive, value, now, "sdo")

    def _keep(self, drive: Drive, digits: int, now: float, source: str) -> None:
        drive.last = digits * drive.torque_per_digit
        if self._guard:
            self.samples.append(Sample(now, drive.node, drive.last, "tpdo" if source == "tpdo" else "sdo"))

    def _stand_in(self, now: float) -> None:
        if now - self._synced > TAKE_OVER * self._period and now >= self._own_sync:
            self.took_over = True
            self._own_sync = now + self._period
            self._bus.send(cia301.SYNC, b"")
        for drive in self._drives.values():
            if now - drive.heard > SILENT and now >= drive.asked:
                drive.asked = now + ASK
                self._bus.send(cia301.SDO_REQUEST + drive.node, _UPLOAD.pack(0x40, *objects.TORQUE_ACTUAL.key))


def main(argv: list[str]) -> int:
    """Serve until told to end, or until stdin closes."""
    ignore(signal.SIGINT, signal.SIGHUP)
    try:
        configuration = load_configuration(argv[0])
        bus = open_bus(configuration.file.bus)
    except TsaError as error:
        print(error, flush=True)
        return error.exit_code
    listener = Listener(configuration, bus)
    with contextlib.suppress(BrokenPipeError):  # who asked is gone: nobody is to be told
        return _serve(listener, 0.5 * configuration.period)
    return 1


def _serve(listener: Listener, patience: float) -> int:
    """`patience`: s, of one look."""
    os.write(1, READY)
    received = b""
    while True:
        listener.step(patience)
        if not select.select([0], [], [], 0.0)[0]:
            continue
        data = os.read(0, 4096)
        if not data:
            return 0
        received += data
        while b"\n" in received:
            word, _, received = received.partition(b"\n")
            if word == b"end":
                return 0
            sys.stdout.buffer.write(msgspec.json.encode(_answer(listener, word.decode())) + b"\n")
            sys.stdout.flush()


def _answer(listener: Listener, word: str) -> object:
    if word == "guard":
        listener.guard()
        return True
    if word == "quiet":
        return {"took_over": listener.took_over, "samples": listener.quiet()}
    return {str(node): torque for node, torque in listener.torques().items()}


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
