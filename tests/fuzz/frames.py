"""Invalid CAN frames: random frames and corrupted copies of real ones."""

from __future__ import annotations

import random

from tsa_ctrl.bus.wire.bus import Frame

NODES = (1, 32, 64)
KNOWN = tuple(
    base + node for node in NODES for base in (0x080, 0x180, 0x200, 0x280, 0x300, 0x380, 0x580, 0x600, 0x700)
)  # fmt: skip
OTHERS = (0x000, 0x080, 0x100, 0x77F, 0x7E4, 0x7FF)
ERRORS = tuple(0x20000000 | bits for bits in (0x001, 0x004, 0x008, 0x020, 0x040, 0x080, 0x100, 0x1FF))
STATUSWORDS = (0x0000, 0x0240, 0x0250, 0x1231, 0x1233, 0x1237, 0x0237, 0x0217, 0x021F, 0x0218, 0x1637)


def any_frame(draw: random.Random) -> Frame:
    """Return random data under an identifier that is mostly in use."""
    can_id = draw.choice((*KNOWN, *OTHERS, draw.randrange(0x800)))
    if draw.random() < 0.02:
        can_id = draw.choice((*ERRORS, 0x80000000 | draw.randrange(1 << 29), 0x40000000 | can_id))
    return can_id, draw.randbytes(draw.randrange(9))


def spoil(frame: Frame, draw: random.Random) -> list[Frame]:
    """Return the frames that arrive in place of this one.

    The frame is lost, doubled, shortened, lengthened, changed in one bit or in all bytes, or follows a foreign frame.
    """
    can_id, data = frame
    kind = draw.randrange(7)
    if kind == 0:
        return []
    if kind == 1:
        return [frame, frame]
    if kind == 2:
        return [(can_id, data[: draw.randrange(len(data) + 1)])]
    if kind == 3:
        return [(can_id, (data + draw.randbytes(8))[: draw.randrange(len(data), 9)])]
    if kind == 4 and data:
        spoiled = bytearray(data)
        spoiled[draw.randrange(len(data))] ^= 1 << draw.randrange(8)
        return [(can_id, bytes(spoiled))]
    if kind == 5:
        return [(can_id, draw.randbytes(len(data)))]
    return [(draw.choice(KNOWN), data), frame]
