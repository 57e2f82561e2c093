"""SDO block transfers (CiA 301, 7.2.4.3.12 to 7.2.4.3.17) at the server, both ways, with their check sum."""

from __future__ import annotations

import binascii
import struct

from tsa_ctrl.plant.dictionary import AbortCode, Key, SdoAbort

_HEADER = struct.Struct("<BHB4s")
_SEGMENT = 7  # bytes of data in a segment
_BLOCK = 127  # segments in a block that is sent to us
_LAST = 0x80
_PADDING = bytes(7)


class BlockUpload:
    """Data to the client: what to send next, in blocks as long as the client asks for."""

    def __init__(self, key: Key, data: bytes, block: int, check: bool) -> None:
        if not 1 <= block <= 127:
            raise SdoAbort(AbortCode.BLOCK_SIZE)
        self.key = key
        self._data = data
        self._block = block
        self._check = check
        self._sent = 0  # bytes that the client has confirmed
        self._begun = False
        self._ended = False

    def first(self) -> bytes:
        """The answer to the request: we can make a check sum, and the size."""
        return _HEADER.pack(0xC6, *self.key, struct.pack("<I", len(self._data)))

    def take(self, request: bytes) -> tuple[list[bytes], bool]:
        """One frame of the client; what to send, and whether the transfer is over. Raises SdoAbort."""
        kind = request[0] & 0x03
        if self._ended and kind == 1:
            return [], True
        if kind == 3 and not self._begun:
            self._begun = True
            return self._segments(), False
        if kind != 2 or not self._begun or self._ended:
            raise SdoAbort(AbortCode.UNKNOWN_COMMAND)
        confirmed, self._block = request[1], request[2]
        if confirmed > 127 or not 1 <= self._block <= 127:
            raise SdoAbort(AbortCode.BLOCK_SIZE)
        self._sent = min(len(self._data), self._sent + confirmed * _SEGMENT)
        if self._sent < len(self._data):
            return self._segments(), False
        self._ended = True
        unused = -len(self._data) % _SEGMENT
        crc = binascii.crc_hqx(self._data, 0) if self._check else 0
        return [struct.pack("<BH5x", 0xC1 | unused << 2, crc)], False

    def _segments(self) -> list[bytes]:
        part = self._data[self._sent : self._sent + self._block * _SEGMENT]
        last = self._sent + len(part) == len(self._data)
        count = max(1, -(-len(part) // _SEGMENT))
        frames = []
        for number in range(1, count + 1):
            piece = part[(number - 1) * _SEGMENT : number * _SEGMENT]
            flag = _LAST if last and number == count else 0
            frames.append(bytes((number | flag,)) + piece.ljust(_SEGMENT, b"\0"))
        return frames


class BlockDownload:
    """Data from the client, a confirmation after each block."""

    def __init__(self, key: Key, size: int | None, check: bool, most: int) -> None:
        if size is not None and size > most:
            raise SdoAbort(AbortCode.OUT_OF_MEMORY)
        self.key = key
        self.data = bytearray()
        self._size = size
        self._check = check
        self._most = most
        self._number = 0  # of the last segment that came in order
        self._complete = False

    def first(self) -> bytes:
        return _HEADER.pack(0xA4, *self.key, struct.pack("<B3x", _BLOCK))

    def take(self, request: bytes) -> tuple[list[bytes], bool]:
        """One frame of the client; what to answer, and whether `data` is complete. Raises SdoAbort."""
        if self._complete:
            return self._end(request)
        number, last = request[0] & 0x7F, bool(request[0] & _LAST)
        if number == self._number + 1:
            self._number = number
            self.data += request[1:]
            self._complete = last
        if len(self.data) > self._most:
            raise SdoAbort(AbortCode.OUT_OF_MEMORY)
        if number != _BLOCK and not last:
            return [], False
        confirmed, self._number = self._number, 0
        return [bytes((0xA2, confirmed, _BLOCK)) + _PADDING[:5]], False

    def _end(self, request: bytes) -> tuple[list[bytes], bool]:
        if request[0] & 0xE3 != 0xC1:
            raise SdoAbort(AbortCode.UNKNOWN_COMMAND)
        unused = request[0] >> 2 & 0x07
        if unused:
            del self.data[-unused:]
        if self._size is not None and self._size != len(self.data):
            raise SdoAbort(AbortCode.LENGTH)
        if self._check and binascii.crc_hqx(bytes(self.data), 0) != int.from_bytes(request[1:3], "little"):
            raise SdoAbort(AbortCode.CRC)
        return [b"\xa1" + _PADDING], True
