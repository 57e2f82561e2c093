"""usage: tools/vcan COMMAND [ARGUMENT...]

Runs COMMAND with a virtual CAN interface, whose name is in TSA_VCAN, and returns its exit status. The command uses the
first of these interfaces that is available:

  1. a vcan that is up
  2. a vcan that this user may create, as root for all users, or else in a network namespace for COMMAND alone
  3. a vcan in a user-mode Linux guest that is started for COMMAND

The guest has the same root file system, its own /dev/shm, TMPDIR, processes and network, and one processor. If no
interface is available, the command prints one line, and the exit status is 77. A bus of local sockets (interface
"datagram") also carries frames between processes and requires no rights. TSA_VCAN is then datagram:NAME. Tests marked
vcan do not accept it.

  TSA_VCAN          name of the interface; default a vcan that is up, else vcan0. "datagram:NAME" selects local sockets
  TSA_VCAN_ELSE     datagram: without a vcan, run COMMAND on local sockets instead of exit status 77
  TSA_VCAN_ALONE    1: do not use a vcan of this machine, which other programs may use at the same time
  TSA_REQUIRE_VCAN  1: without a vcan the exit status is 1, not 77
  TSA_VCAN_TIMEOUT  time in s after which COMMAND is ended with exit status 124; default none
  TSA_VCAN_MEMORY   memory of the guest, for example 512M or 4G; default 2G
  TSA_CACHE         folder for the guest's kernel (16 MB, fetched once); default .cache of the project

example: tools/vcan pytest -m vcan
"""

from __future__ import annotations

import os
import re
import shutil
import sys
from typing import NoReturn

from tools.guest import guest
from tools.guest import link as network
from tools.guest.guest import GRACE_SECONDS, Limits
from tools.guest.kernel import UnavailableError, kernel
from tsa_ctrl.bus.wire import link

DEFAULT = "vcan0"
SUBSTITUTE = "datagram:"  # interface and channel of a bus of local sockets
FAILED, USAGE, SKIPPED, NOT_FOUND, INTERRUPTED = 1, 2, 77, 127, 130


def main() -> int:
    """Run the command of the command line, and return its exit status."""
    try:
        return run(sys.argv[1:])
    except KeyboardInterrupt:
        end(INTERRUPTED, "interrupted")


def run(arguments: list[str]) -> int:
    """Run a command with a vcan, in this process if possible."""
    if arguments[:1] in (["-h"], ["--help"]):
        print((__doc__ or "").strip())
        return 0
    if not arguments or arguments[0].startswith("-"):
        end(USAGE, "usage: tools/vcan COMMAND [ARGUMENT...] (see tools/vcan --help)")
    limits = Limits(memory(), seconds())
    if shutil.which(arguments[0]) is None:
        end(NOT_FOUND, f"{arguments[0]}: no such command")
    name = os.environ.get("TSA_VCAN", "")
    if name.startswith(SUBSTITUTE):
        run_here(arguments, name, limits)
    if os.environ.get("TSA_VCAN_ALONE") != "1" and (interface := found_or_created(name)):
        run_here(arguments, interface, limits)
    name = name or DEFAULT
    if network.possible(name):
        network.enter(name)
        run_here(arguments, name, limits)
    return run_in_guest(arguments, name, limits)


def run_here(command: list[str], interface: str, limits: Limits) -> NoReturn:
    if limits.seconds is not None:
        command = ["timeout", "-k", f"{GRACE_SECONDS:g}", f"{limits.seconds:g}", *command]
    sys.stderr.flush()
    os.execvpe(command[0], command, {**os.environ, "TSA_VCAN": interface})


def run_in_guest(command: list[str], interface: str, limits: Limits) -> int:
    try:
        return guest.run(kernel(), command, {**os.environ, "TSA_VCAN": interface}, limits)
    except UnavailableError as reason:
        if os.environ.get("TSA_REQUIRE_VCAN") == "1":
            end(FAILED, f"no vcan available: {reason}")
        if os.environ.get("TSA_VCAN_ELSE") == "datagram":
            print(f"tools/vcan: no vcan available: {reason}; local sockets are used instead", file=sys.stderr)
            run_here(command, f"{SUBSTITUTE}{interface}", limits)
        end(SKIPPED, f"skipped, no vcan available: {reason}")


def found_or_created(name: str) -> str | None:
    """Return the name of a vcan of this machine that is up or can be created, or None without the rights for one."""
    existing = link.can_interfaces()
    named = link.read(name) if name else None
    if named is not None and named.kind != "vcan":
        end(USAGE, f"TSA_VCAN={name}: that is no vcan but an interface of kind '{named.kind or 'none'}'")
    up = sorted(interface.name for interface in existing.values() if interface.kind == "vcan" and interface.up)
    if name in up or (up and not name):
        return name or up[0]
    name = name or DEFAULT
    try:
        if name in existing:
            link.set_up(name, True)
        else:
            link.make_vcan(name)
    except OSError:
        return None
    print(f"tools/vcan: created {name}; remove it with 'ip link del {name}'", file=sys.stderr)
    return name


def memory() -> int:
    value = os.environ.get("TSA_VCAN_MEMORY") or "2G"
    match = re.fullmatch(r"(\d+)([MG])", value)
    size = int(match[1]) << {"M": 20, "G": 30}[match[2]] if match else 0
    if size < 128 << 20:
        end(USAGE, f"TSA_VCAN_MEMORY={value}: a size from 128M on is required, for example 512M or 2G")
    return size


def seconds() -> float | None:
    value = os.environ.get("TSA_VCAN_TIMEOUT")
    if not value:
        return None
    if not re.fullmatch(r"\d+(\.\d+)?", value) or not float(value):
        end(USAGE, f"TSA_VCAN_TIMEOUT={value}: a number of seconds greater than 0 is required")
    return float(value)


def end(status: int, message: str) -> NoReturn:
    print(f"tools/vcan: {message}", file=sys.stderr)
    sys.exit(status)
