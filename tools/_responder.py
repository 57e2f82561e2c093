"""A process that answers each SYNC with the TPDOs of some axes, from constant bytes: the fastest nodes there can be.

Usage: python tools/_responder.py INTERFACE AXES; says `ready` on stdout, ends when its stdin closes.
"""

from __future__ import annotations

import os
import select
import socket
import struct
import sys

FRAME = struct.Struct("=IB3x8s")
FILTER = struct.Struct("=II")
SYNC, ID_MASK = 0x080, 0xC00007FF
PRIORITY = 70  # below the loop, above everything else
BEATS = 20  # SYNCs between heartbeats
STATUSWORD = 0x1237  # operation enabled, follows the command


def frame(can_id: int, data: bytes) -> bytes:
    return FRAME.pack(can_id, len(data), data)


def answers(axis: int) -> list[bytes]:
    """TPDO1 and TPDO2 of the drive, TPDO1 of encoder and torque sensor: all at rest."""
    return [
        frame(0x181 + axis, struct.pack("<Hhi", STATUSWORD, 0, 0)),
        frame(0x281 + axis, struct.pack("<ibH", 0, 10, 0)),
        frame(0x1A0 + axis, struct.pack("<I", 0)),
        frame(0x1C0 + axis, struct.pack("<i", 0)),
    ]


def main(interface: str, axes: int) -> None:
    bus = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    bus.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, FILTER.pack(SYNC, ID_MASK))
    bus.bind((interface,))
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except OSError:
        print("no real-time scheduling", file=sys.stderr)
    send, recv = bus.send, bus.recv
    cyclic = [answer for axis in range(axes) for answer in answers(axis)]
    beats = [frame(0x700 + node + axis, b"\x05") for axis in range(axes) for node in (1, 32, 64)]
    os.write(1, b"ready\n")
    syncs = 0
    while True:
        if not select.select([bus], [], [], 0.5)[0]:
            if select.select([0], [], [], 0.0)[0]:
                return
            continue
        recv(16)
        for answer in cyclic:
            send(answer)
        syncs += 1
        if syncs % BEATS == 1:
            for beat in beats:
                send(beat)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
