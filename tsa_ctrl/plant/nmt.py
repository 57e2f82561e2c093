"""NMT of CiA 301: states and commands. The plant has its own, so that it checks the controller's."""

from __future__ import annotations

from enum import IntEnum


class NmtState(IntEnum):
    """Values as in the heartbeat."""

    BOOT_UP = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


class NmtCommand(IntEnum):
    """Command specifier of NMT (CiA 301, 7.2.8.3.1)."""

    START = 1
    STOP = 2
    ENTER_PRE_OPERATIONAL = 128
    RESET_NODE = 129
    RESET_COMMUNICATION = 130
