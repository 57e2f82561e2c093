"""Record every frame of the bus to a file during `tsa run --record-bus FILE`, in a separate process.

The recorder opens the bus a second time and only listens, so the loop does no additional work. The suffix of the file
selects the format. A record in the format of candump (`.log`) or in ASC format (`.asc`) contains the answers of each
drive, and tests can replay it. The frames are written to a file next to the target, which is renamed at the end.
"""

from __future__ import annotations

import json
import logging
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import can

from tsa_ctrl.bus.settings import BusSettings
from tsa_ctrl.bus.wire.bus import REMOTE_FLAG
from tsa_ctrl.bus.wire.datagram import DatagramBus
from tsa_ctrl.bus.wire.python_can import Option, opened
from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.system.process_supervisor import READY, Child, follow, ignore

FORMATS = (".asc", ".blf", ".csv", ".log", ".trc")
SHARED = ("socketcan", "udp_multicast", "datagram")  # interfaces that several programs can open at once
LOOK = 0.1  # s between two checks for the end of the run
LONGEST_END = 0.5  # s, longest recording after the end of the run
PATIENCE = 5.0  # s for the last frames to be written


def check_record(buses: Sequence[BusSettings], path: Path | None) -> None:
    """Raise UsageError if the suffix, the folder or an interface does not permit a record of the buses."""
    for settings, file in _files(buses, path):
        _check(settings, file)


def _files(buses: Sequence[BusSettings], path: Path | None) -> list[tuple[BusSettings, Path]]:
    """Return the file of each bus: `path`, or with several buses `path` with the name of the bus."""
    if path is None:
        return []
    if len(buses) == 1:
        return [(buses[0], path)]
    return [(settings, path.with_stem(f"{path.stem}-{settings.name}")) for settings in buses]


def _check(settings: BusSettings, path: Path) -> None:
    if path.suffix.lower() not in FORMATS:
        raise UsageError(f"--record-bus {path}: the suffix is not one of {', '.join(FORMATS)}; choose one of them")
    if path.exists():
        raise UsageError(f"--record-bus {path}: exists already; choose another name")
    if not path.resolve().parent.is_dir():
        raise UsageError(f"--record-bus {path}: no such folder; create it")
    if settings.interface not in SHARED:
        raise UsageError(
            f"--record-bus: interface '{settings.interface}' can be opened by one program only; it works with "
            f"{' and '.join(SHARED)}"
        )


@contextmanager
def recorded(buses: Sequence[BusSettings], path: Path | None, say: Callable[[str], None]) -> Iterator[None]:
    """Record each bus during the block to its file (see `_files`); without a `path` nothing is recorded.

    Raises:
        UsageError: see `check_record`.
        BusError: a bus cannot be opened.
    """
    check_record(buses, path)
    with ExitStack() as stack:
        for settings, file in _files(buses, path):
            stack.enter_context(_recording(settings, file, say))
        yield


@contextmanager
def _recording(settings: BusSettings, path: Path, say: Callable[[str], None]) -> Iterator[None]:
    part = path.with_name(f".{path.stem}.part{path.suffix}")
    options = json.dumps(settings.options)
    arguments = (settings.interface, settings.channel, settings.bitrate, options, part)
    child = Child("tsa_ctrl.daemon.bus_recorder", *arguments)
    try:
        if failure := child.failure():
            raise BusError(f"--record-bus {path}: {failure}")
        yield
        if not child.alive:
            say(f"--record-bus {path}: the recorder has ended early; the file contains the frames until then")
    finally:
        child.end(PATIENCE)
        with suppress(FileNotFoundError):
            part.rename(path)


def record(interface: str, channel: str, bitrate: str, options: str, path: str) -> int:
    """Write frames until stdin is closed; return the exit code."""
    ended = threading.Event()

    def wait() -> None:
        sys.stdin.read()
        ended.set()

    threading.Thread(target=wait, daemon=True).start()
    try:
        with _received(interface, channel, int(bitrate), json.loads(options)) as receive, can.Logger(path) as log:
            os.write(1, READY)
            last = math.inf  # s, end of the record even if other nodes still send
            while time.monotonic() < last:
                message = receive(LOOK)
                if message is not None:
                    log.on_message_received(message)
                elif ended.is_set():
                    break
                if ended.is_set() and last == math.inf:
                    last = time.monotonic() + LONGEST_END
    except (BusError, can.CanError, OSError, ValueError) as error:
        print(" ".join(str(error).split()) or type(error).__name__, flush=True)
        return 1
    return 0


@contextmanager
def _received(
    interface: str, channel: str, bitrate: int, options: Mapping[str, Option]
) -> Iterator[Callable[[float], can.Message | None]]:
    """Open the bus and yield a function that waits at most a time in s for the next frame."""
    if interface != "datagram":
        with opened(interface, channel, bitrate, options) as library:
            yield library.recv
        return
    bus = DatagramBus(channel)

    def receive(timeout: float) -> can.Message | None:
        frame = bus.recv(timeout)
        if frame is None:
            return None
        can_id, data = frame
        remote = bool(can_id & REMOTE_FLAG)
        return can.Message(time.time(), can_id & 0x7FF, is_extended_id=False, is_remote_frame=remote, data=data)

    try:
        yield receive
    finally:
        bus.close()


if __name__ == "__main__":
    follow()
    ignore(signal.SIGINT, signal.SIGTERM)
    logging.getLogger("can").addHandler(logging.NullHandler())  # the error is reported in one line
    sys.exit(record(*sys.argv[1:]))
