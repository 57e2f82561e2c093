"""Many CAN frames by one call of the kernel: recvmmsg(2), which Python's socket module does not offer."""

from __future__ import annotations

import ctypes
import errno
import socket
import struct

FRAME = struct.Struct("=IB3x8s")  # struct can_frame: can_id, len, padding, data
_MOST = 64  # frames taken by one call


class _Vector(ctypes.Structure):
    _fields_ = (("base", ctypes.c_void_p), ("length", ctypes.c_size_t))  # struct iovec


class _Header(ctypes.Structure):  # struct msghdr
    _fields_ = (
        ("name", ctypes.c_void_p),
        ("name_length", ctypes.c_uint32),
        ("vectors", ctypes.POINTER(_Vector)),
        ("vector_count", ctypes.c_size_t),
        ("control", ctypes.c_void_p),
        ("control_length", ctypes.c_size_t),
        ("flags", ctypes.c_int),
    )


class _Message(ctypes.Structure):  # struct mmsghdr
    _fields_ = (("header", _Header), ("received", ctypes.c_uint))


_recvmmsg = ctypes.CDLL(None, use_errno=True).recvmmsg
_recvmmsg.argtypes = (ctypes.c_int, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int, ctypes.c_void_p)


class Batch:
    """Takes what waits on one raw CAN socket, without waiting."""

    def __init__(self, raw: socket.socket) -> None:
        self._fd = raw.fileno()
        self._frames = bytearray(_MOST * FRAME.size)
        self._view = memoryview(self._frames)
        first = ctypes.addressof(ctypes.c_char.from_buffer(self._frames))
        self._vectors = (_Vector * _MOST)(*(_Vector(first + n * FRAME.size, FRAME.size) for n in range(_MOST)))
        self._messages = (_Message * _MOST)()
        for message, vector in zip(self._messages, self._vectors, strict=True):
            message.header.vectors, message.header.vector_count = ctypes.pointer(vector), 1
        self._address = ctypes.addressof(self._messages)

    def take(self, most: int) -> tuple[list[tuple[int, bytes]], int]:
        """At most `most` frames, and the kernel's error number (0 when there was none; EAGAIN is none)."""
        frames: list[tuple[int, bytes]] = []
        while most > 0:
            wanted = most if most < _MOST else _MOST
            count = _recvmmsg(self._fd, self._address, wanted, socket.MSG_DONTWAIT, None)
            if count < 0:
                number = ctypes.get_errno()
                return frames, 0 if number == errno.EAGAIN else number
            for can_id, length, data in FRAME.iter_unpack(self._view[: count * FRAME.size]):
                frames.append((can_id, data[:length]))
            if count < wanted:
                break
            most -= count
        return frames, 0
