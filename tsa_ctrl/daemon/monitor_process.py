"""Run the monitor as a process with a separate CAN socket: `python -m tsa_ctrl.daemon.monitor_process FD`.

It outlives the daemon until the drives confirm that they deliver no torque. Signals of a terminal or a service manager
do not end it. It ends when the pipe from the daemon is closed.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import struct
import sys
import time
from select import select

import msgspec

from tsa_ctrl.bus.wire.datagram import DatagramBus
from tsa_ctrl.errors import TsaError, UsageError
from tsa_ctrl.monitor.watch import Monitor
from tsa_ctrl.monitor.watched import Frame, Stop, Watched
from tsa_ctrl.safety.causes import Cause, Finding
from tsa_ctrl.system.process_supervisor import READY, Child
from tsa_ctrl.system.shared_memory import Newest, SharedMemory, space
from tsa_ctrl.system.torque_off import OutputSettings, TorqueOff

TICK = 0.004  # s between two checks for missing frames
REPEAT = 0.02  # s between two repetitions of the stop
PERMIT = 0.05  # s between two bytes that permit torque
OUTLIVE = 5.0  # s for which it repeats the stop after the daemon's end
LATE = 0.05  # s without a sign of life after which the daemon checks if the process has ended
SILENT = 0.5  # s without a sign of life after which the daemon counts the process as hung
MOST = 64  # maximum number of frames between two checks
_FRAME = struct.Struct("=IB3x8s")  # struct can_frame
_TIMESPEC = struct.Struct("@ll")
_SO_TIMESTAMPNS = 35  # asm-generic/socket.h
_TEXT = 4096  # bytes
_IGNORED = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGTSTP, signal.SIGTTOU, signal.SIGPIPE)


class Given(msgspec.Struct, frozen=True, kw_only=True):
    """Input of the process."""

    watched: Watched
    interface: str
    channel: str
    bitrate: int
    options: dict[str, str | int | float | bool]
    output: OutputSettings | None
    priority: int  # of SCHED_FIFO, above the loop's


class Report(msgspec.Struct, frozen=True):
    """Findings of the monitor so far."""

    stop: Stop | None = None
    confirmed: bool = False
    notices: tuple[Stop, ...] = ()


class Board:
    """Shared memory from the monitor to the daemon: a sign of life, and the report."""

    def __init__(self, descriptor: int | None = None) -> None:
        self._memory = SharedMemory(64 + space(2, _TEXT), descriptor)
        self.descriptor = self._memory.descriptor
        self._words = self._memory.words
        self._report = Newest(self._memory, 64, _TEXT)

    def alive(self) -> None:
        self._words[0] = time.monotonic_ns()

    @property
    def heard(self) -> float:
        """Return the time of the last sign of life, s, monotonic."""
        return self._words[0] * 1e-9

    def tell(self, report: Report) -> None:
        self._report.write(msgspec.json.encode(report))

    def take(self) -> Report | None:
        """Return a new report, or None."""
        content = self._report.take()
        return None if content is None else msgspec.json.decode(content, type=Report)


class RawCan:
    """A raw SocketCAN socket that reports the kernel's time of arrival. Raises OSError."""

    def __init__(self, channel: str) -> None:
        self._socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        self._socket.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        self._socket.bind((channel,))
        self._socket.setblocking(False)
        self.fileno = self._socket.fileno

    def receive(self) -> tuple[Frame, float] | None:
        try:
            data, extra, _, _ = self._socket.recvmsg(_FRAME.size, 64)
        except BlockingIOError:
            return None
        can_id, length, content = _FRAME.unpack(data)
        seconds, nanoseconds = _TIMESPEC.unpack_from(extra[0][2])
        return (can_id, content[:length]), seconds + nanoseconds * 1e-9

    def send(self, can_id: int, data: bytes) -> None:
        self._socket.send(_FRAME.pack(can_id, len(data), data))


class LibraryCan:
    """Any python-can interface that has a descriptor. Raises OSError or can.CanError."""

    def __init__(self, given: Given) -> None:
        import can  # slow to import

        arguments = {"bitrate": given.bitrate} if given.interface != "udp_multicast" else {"fd": False, "hop_limit": 0}
        self._bus = can.Bus(interface=given.interface, channel=given.channel, **{**arguments, **given.options})
        self._message = can.Message
        self.fileno = self._bus.fileno

    def receive(self) -> tuple[Frame, float] | None:
        message = self._bus.recv(0.0)
        if message is None:
            return None
        flags = 0x20000000 * message.is_error_frame | 0x40000000 * message.is_remote_frame
        return (message.arbitration_id | flags, bytes(message.data)), message.timestamp

    def send(self, can_id: int, data: bytes) -> None:
        self._bus.send(self._message(arbitration_id=can_id, is_extended_id=False, data=data))


class DatagramCan:
    """A datagram bus, the substitute for a CAN interface."""

    def __init__(self, channel: str) -> None:
        self._bus = DatagramBus(channel)
        self.fileno, self.send = self._bus.fileno, self._bus.send

    def receive(self) -> tuple[Frame, float] | None:
        frame = self._bus.recv(0.0)
        return None if frame is None else (frame, time.time())


def opened(given: Given) -> RawCan | LibraryCan | DatagramCan:
    """Open the bus of the run with a separate socket."""
    if given.interface == "socketcan":
        return RawCan(given.channel)
    return DatagramCan(given.channel) if given.interface == "datagram" else LibraryCan(given)


class Watch:
    """Run the monitor, its bus and its output until the daemon has ended and the torque is off."""

    def __init__(self, given: Given, bus: RawCan | LibraryCan | DatagramCan, output: TorqueOff, board: Board) -> None:
        self._monitor, self._bus, self._output, self._board = Monitor(given.watched), bus, output, board
        self._number, self._due, self._permit, self._last = 0, 0.0, 0.0, Report()

    def run(self, pipe: int) -> None:
        """Watch until the pipe is closed, then until no drive delivers torque, for at most `OUTLIVE` s."""
        monitor, reading, end = self._monitor, [self._bus.fileno(), pipe], float("inf")
        while time.monotonic() < end and not (end < float("inf") and (monitor.stop is None or self._last.confirmed)):
            readable = select(reading, (), (), TICK)[0]
            if pipe in readable and not os.read(pipe, 64):
                reading.remove(pipe)
                end = time.monotonic() + OUTLIVE
                self._take()
                if monitor.on:
                    monitor.act("daemon", time.monotonic())
            self._take()
            self._board.alive()
            self._follow(time.monotonic())

    def _take(self) -> None:
        """Pass the received frames to the monitor, with their time of arrival."""
        step, receive = self._monitor.step, self._bus.receive
        try:
            for _ in range(MOST):
                found = receive()
                now = time.monotonic()
                if found is None:
                    step(None, now)
                    return
                now -= max(0.0, time.time() - found[1])
                step(found[0], now)
            step(None, now)
        except Exception as error:  # python-can raises exceptions of any type
            if self._monitor.on:
                self._monitor.act("bus", time.monotonic(), error)

    def _follow(self, now: float) -> None:
        """Report a stop and act on it; repeat this until the drives have confirmed it."""
        monitor = self._monitor
        done = monitor.stop is not None and monitor.confirmed
        if monitor.stop is not None and now >= self._due and not self._last.confirmed:
            self._due = now + REPEAT
            self._tell(self._last.confirmed)
            done = self._output.off() and done
            for can_id, data in monitor.action(0 if done else self._number):
                with contextlib.suppress(Exception):
                    self._bus.send(can_id, data)
            self._number += 1
            self._tell(done)
        elif monitor.stop is None:
            if now >= self._permit:
                self._permit = now + PERMIT
                self._output.permit()
            self._tell(False)

    def _tell(self, confirmed: bool) -> None:
        report = Report(self._monitor.stop, confirmed, tuple(self._monitor.notices.values()))
        if report != self._last:
            self._last = report
            self._board.tell(report)


class MonitorProcess:
    """The daemon's side of the monitor: start the process, and supervise it."""

    def __init__(self, given: Given) -> None:
        """Start the process; raise UsageError with its message if it cannot watch."""
        self.report = Report()
        self._told: set[str] = set()
        self._board = Board()
        self._child = Child("tsa_ctrl.daemon.monitor_process", self._board.descriptor, fd=self._board.descriptor)
        self._child.send(msgspec.json.encode(given))
        if failure := self._child.failure():
            self.close()
            raise UsageError(failure)

    @property
    def pid(self) -> int:
        return self._child.pid

    def fault(self, now: float) -> Finding | None:
        """Return the reason why torque is not permitted, or None while the monitor watches; `now` is monotonic, s."""
        found = self._board.take()
        self.report = self.report if found is None else found
        if self.report.stop is not None:
            return Finding(Cause.MONITOR_STOPPED, str(self.report.stop))
        silent = now - self._board.heard
        if silent > LATE and not self._child.alive:
            return Finding(Cause.MONITOR_ENDED, "its process is gone")
        return Finding(Cause.MONITOR_SILENT, f"no sign of life for {SILENT:g} s") if silent > SILENT else None

    def news(self) -> list[str]:
        """Return the notices since the last call."""
        new = [str(notice) for notice in self.report.notices if notice.id not in self._told]
        self._told |= {notice.id for notice in self.report.notices}
        return new

    def close(self) -> None:
        """End the process, which first waits for the drives to confirm no torque; kill a process that hangs."""
        if time.monotonic() - self._board.heard > SILENT:
            self._child.kill()
        self._child.end(OUTLIVE + 1.0)


def main(argv: list[str]) -> int:
    """Watch until the daemon has ended."""
    for number in _IGNORED:
        signal.signal(number, signal.SIG_IGN)
    with contextlib.suppress(OSError):
        os.setsid()  # a stop of the terminal's process group does not stop it
    given = msgspec.json.decode(_first_line(sys.stdin.fileno()), type=Given)
    try:
        bus = opened(given)
        output = TorqueOff(given.output)
    except Exception as error:
        line = str(error) if isinstance(error, TsaError) else f"[monitor] bus '{given.channel}': {error}"
        print(" ".join(line.split()), flush=True)
        return 2
    with contextlib.suppress(OSError):  # these rights may be missing; the loop's are reported
        os.sched_setaffinity(0, range(os.cpu_count() or 1))
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(given.priority))
    board = Board(int(argv[0]))
    board.alive()
    sys.stdout.buffer.write(READY)
    sys.stdout.flush()
    Watch(given, bus, output, board).run(sys.stdin.fileno())
    return 0


def _first_line(pipe: int) -> bytes:
    """Return the first line of the pipe; the daemon sends only one."""
    line = b""
    while not line.endswith(b"\n") and (found := os.read(pipe, 1 << 16)):
        line += found
    return line


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
