"""A process that answers each SYNC with the TPDOs of some axes, from constant bytes: the fastest nodes there can be.

Arguments: INTERFACE AXES [walk]; says `ready` on stdout, ends when its stdin closes. With `walk`
it takes the commands, too: the statusword follows the controlword, the torque the command.
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
BEATS = 20  # SYNCs between the heartbeats of a node; the nodes take turns, as their clocks run apart
ENABLED = 0x1237  # statusword: operation enabled, follows the command
STATUSWORDS = {0x0F: ENABLED, 0x07: 0x1233, 0x06: 0x1231}  # by controlword, else switch on disabled
DISABLED = 0x1250


def frame(can_id: int, data: bytes) -> bytes:
    return FRAME.pack(can_id, len(data), data)


def answers(axis: int, statusword: int = ENABLED, count: int = 0) -> list[bytes]:
    """TPDO1 and TPDO2 of the drive, TPDO1 of encoder and torque sensor: all at rest, the motor at `count`."""
    return [
        frame(0x181 + axis, struct.pack("<Hhi", statusword, 0, 0)),
        frame(0x281 + axis, struct.pack("<ibH", count, 10, 0)),
        frame(0x1A0 + axis, struct.pack("<I", 0)),
        frame(0x1C0 + axis, struct.pack("<i", 0)),
    ]


def main() -> int:
    """Answer until stdin closes."""
    interface, axes, walk = sys.argv[1], int(sys.argv[2]), "walk" in sys.argv[3:]
    bus = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    ids = [SYNC, *(0x201 + axis for axis in range(axes if walk else 0))]
    filters = b"".join(FILTER.pack(can_id, ID_MASK) for can_id in ids)
    bus.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, filters)
    bus.bind((interface,))
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except OSError:
        print("no real-time scheduling", file=sys.stderr)
    send, recv = bus.send, bus.recv
    state = DISABLED if walk else ENABLED
    pair = [[answer for axis in range(axes) for answer in answers(axis, state, count)] for count in (0, 1)]
    beats = [frame(0x700 + node + axis, b"\x05") for axis in range(axes) for node in (1, 32, 64)]
    os.write(1, b"ready\n")
    syncs = 0
    while True:
        if not select.select([bus], [], [], 0.5)[0]:
            if select.select([0], [], [], 0.0)[0]:
                return 0
            continue
        can_id, _, data = FRAME.unpack(recv(16))
        if can_id != SYNC:
            axis = can_id - 0x201
            controlword, torque = struct.unpack_from("<Hh", data)
            statusword = STATUSWORDS.get(controlword, DISABLED)
            for cyclic in pair:
                cyclic[4 * axis] = frame(0x181 + axis, struct.pack("<Hhi", statusword, torque, 0))
            continue
        for answer in pair[syncs % 2]:  # the motor trembles by a count: what does not move at all is frozen
            send(answer)
        syncs += 1
        for beat in beats[syncs % BEATS :: BEATS]:
            send(beat)
