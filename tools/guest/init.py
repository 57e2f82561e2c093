"""Run as the first process of the user-mode Linux guest: mount, create a vcan, run the command, and power off.

The kernel starts it with a FOLDER of the host's file system that contains `request.json`, and it writes the files
`ready` and `status` there. The serial lines 0 and 1 carry the command's output and errors. Line 2 carries its input in
blocks of two bytes of length and then the data. Length 0 marks the end, and each block is acknowledged by one byte.
Line 3 carries signals, one number per line.
"""

from __future__ import annotations

import ctypes
import fcntl
import json
import os
import signal
import struct
import sys
import termios
import tty
from contextlib import suppress
from pathlib import Path
from threading import Thread
from typing import Any

from tools.guest import link

LIBC = ctypes.CDLL(None, use_errno=True)
SYS_FINIT_MODULE = 313  # x86-64, the only 64-bit processor with user-mode Linux
POWER_OFF = 0x4321FEDC  # linux/reboot.h
MODULES = (
    "net/can/can.ko",
    "net/can/can-raw.ko",
    "drivers/net/can/dev/can-dev.ko",
    "drivers/net/can/vcan.ko",
)
BLOCK = 1 << 16


def main() -> int:
    folder = Path(sys.argv[1])
    try:
        request = json.loads((folder / "request.json").read_text())
        prepare(Path(request["modules"]), request["interface"])
        lines = [serial_line(number) for number in range(4)]
        (folder / "ready").touch()
        (folder / "status").write_text(str(run(request, lines)))
    except OSError as error:
        print(f"vcan guest: {error}", flush=True)
    finally:
        os.sync()
        LIBC.reboot(POWER_OFF)
    return 0


def prepare(modules: Path, interface: str) -> None:
    mount("proc", "/proc")
    mount("sysfs", "/sys")
    with suppress(OSError):  # the kernel has already mounted it if the root has a /dev
        mount("devtmpfs", "/dev")
    names = {"fd": "/proc/self/fd", "stdin": "fd/0", "stdout": "fd/1", "stderr": "fd/2"}
    for path, target in names.items():
        with suppress(FileExistsError):
            Path("/dev", path).symlink_to(target)
    for folder, kind in (("/dev/shm", "tmpfs"), ("/dev/pts", "devpts")):
        Path(folder).mkdir(exist_ok=True)
        mount(kind, folder)
    for folder in ("/dev/shm/tmp", "/dev/shm/run"):
        Path(folder).mkdir(mode=0o700)
    for module in MODULES:
        insert(modules / module)
    link.bring_up_alone(interface)


def mount(kind: str, folder: str) -> None:
    check(LIBC.mount(kind.encode(), folder.encode(), kind.encode(), 0, None), folder)


def insert(module: Path) -> None:
    with module.open("rb") as file:
        check(LIBC.syscall(SYS_FINIT_MODULE, file.fileno(), b"", 0), str(module))


def check(result: int, what: str) -> None:
    if result:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()), what)


def run(request: dict[str, Any], lines: list[int]) -> int:
    """Run the command with its streams on the serial lines. Return its exit status as a shell does."""
    os.environ.clear()
    os.environ.update(request["environment"])
    os.chdir(request["directory"])
    size = request["size"]
    stdin, keyboard = stream(request["terminals"][0], size, outwards=True)
    stdout, output = stream(request["terminals"][1], size)
    stderr, errors = stream(request["terminals"][2], size)
    child = os.posix_spawnp(
        request["command"][0],
        request["command"],
        os.environ,
        file_actions=[(os.POSIX_SPAWN_DUP2, fd, number) for number, fd in enumerate((stdin, stdout, stderr))],
        setsid=True,
        setsigdef=[signal.SIGPIPE, signal.SIGXFSZ],
    )
    for fd in (stdin, stdout, stderr):
        os.close(fd)
    pumps = [Thread(target=pump, args=pair) for pair in ((output, lines[0]), (errors, lines[1]))]
    hands = [Thread(target=feed, args=(lines[2], keyboard)), Thread(target=forward, args=(lines[3], child))]
    for thread in pumps + hands:
        thread.start()
    status = wait(child)
    with suppress(ProcessLookupError):
        os.kill(-1, signal.SIGKILL)  # remaining processes would keep the output open
    for thread in pumps:
        thread.join()
    return status


def wait(child: int) -> int:
    """Collect ended processes, including orphans, until the child has ended. Return its exit status."""
    while True:
        ended, status = os.wait()
        if ended == child:
            code = os.waitstatus_to_exitcode(status)
            return 128 - code if code < 0 else code


def pump(source: int, line: int) -> None:
    with suppress(OSError):  # reading a terminal fails after its last process has ended
        while data := os.read(source, BLOCK):
            write_all(line, data)
    termios.tcdrain(line)


def feed(line: int, keyboard: int) -> None:
    terminal = os.isatty(keyboard)
    with os.fdopen(line, "rb") as source, suppress(OSError):  # the command may have closed its input
        while length := int.from_bytes(source.read(2), "big"):
            write_all(keyboard, source.read(length))
            os.write(line, b".")
        if terminal:
            write_all(keyboard, b"\x04")
        else:
            os.close(keyboard)


def forward(line: int, child: int) -> None:
    with os.fdopen(line, "rb") as source:
        for number in source:
            with suppress(ProcessLookupError):
                os.killpg(child, int(number))


def stream(terminal: bool, size: list[int], outwards: bool = False) -> tuple[int, int]:
    """Return both ends of a pipe, or of a pseudo-terminal if the caller's stream is one. The command's end is first."""
    if not terminal:
        reader, writer = os.pipe()
        return (reader, writer) if outwards else (writer, reader)
    ours, theirs = os.openpty()
    attributes = termios.tcgetattr(theirs)
    attributes[tty.OFLAG] &= ~termios.OPOST  # the caller's terminal processes the output
    attributes[tty.LFLAG] &= ~(termios.ECHO | termios.ISIG)
    termios.tcsetattr(theirs, termios.TCSANOW, attributes)
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", *size, 0, 0))
    return theirs, ours


def serial_line(number: int) -> int:
    line = os.open(f"/dev/ttyS{number}", os.O_RDWR | os.O_NOCTTY)
    tty.setraw(line)
    return line


def write_all(fd: int, data: bytes) -> None:
    while data:
        data = data[os.write(fd, data) :]
