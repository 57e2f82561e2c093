"""Create a vcan without root rights, in a network namespace of this user, as `unshare --map-root-user --net` does."""

from __future__ import annotations

import ctypes
import os
from pathlib import Path

from tools.guest import link

CLONE_NEWUSER, CLONE_NEWNET = 0x10000000, 0x40000000
LIBC = ctypes.CDLL(None, use_errno=True)


def possible(vcan: str) -> bool:
    """Return True if `enter` works. A child process tries it, because a process cannot leave a namespace."""
    child = os.fork()
    if not child:
        try:
            enter(vcan)
        except OSError:
            os._exit(1)
        os._exit(0)
    return os.waitpid(child, 0)[1] == 0


def enter(vcan: str) -> None:
    """Move this process into a network namespace with loopback and `vcan`.

    Raises:
        OSError: The kernel denies the request.
    """
    user, group = os.getuid(), os.getgid()
    if LIBC.unshare(CLONE_NEWUSER | CLONE_NEWNET):
        raise OSError(ctypes.get_errno(), "unshare")
    Path("/proc/self/setgroups").write_text("deny")
    Path("/proc/self/uid_map").write_text(f"0 {user} 1")
    Path("/proc/self/gid_map").write_text(f"0 {group} 1")
    link.bring_up_alone(vcan)
