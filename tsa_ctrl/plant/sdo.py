"""Implement an SDO server (CiA 301) with expedited and segmented transfers in both directions, one at a time.

A block transfer is optional in CiA 301. The server aborts it with 0x05040001, as many drives do.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from tsa_ctrl.plant.dictionary import AbortCode, Key, ObjectDictionary, SdoAbort

_HEADER = struct.Struct("<BHB4s")
_MAX_DOWNLOAD = 4096  # bytes; more is rejected, as in a node with little memory
_ABORT = 0x80


@dataclass(slots=True)
class _Transfer:
    key: Key
    data: bytearray
    toggle: int = 0
    upload: bool = True
    size: int | None = None


class SdoServer:
    """Respond to requests, with frames of 8 bytes, and hold the state of one segmented transfer."""

    def __init__(self, dictionary: ObjectDictionary) -> None:
        self._dictionary = dictionary
        self._transfer: _Transfer | None = None

    def reset(self) -> None:
        self._transfer = None

    def handle(self, request: bytes) -> list[bytes]:
        """Return the responses to one request frame; an abort and a frame that is not an SDO get none."""
        if len(request) != 8:
            return []
        if request[0] == _ABORT:
            self.reset()
            return []
        try:
            return [self._answer(request)]
        except SdoAbort as abort:
            running = self._transfer if request[0] >> 5 in (0, 3) else None
            key = running.key if running is not None else _HEADER.unpack(request)[1:3]
            self.reset()
            return [_HEADER.pack(_ABORT, *key, struct.pack("<I", abort.code))]

    def _answer(self, request: bytes) -> bytes:
        command, index, sub, data = _HEADER.unpack(request)
        specifier = command >> 5
        if specifier == 1:
            return self._start_download((index, sub), command, data)
        if specifier == 0:
            return self._download_segment(command, request[1:])
        if specifier == 2:
            return self._start_upload((index, sub))
        if specifier == 3:
            return self._upload_segment(command)
        raise SdoAbort(AbortCode.UNKNOWN_COMMAND)

    def _start_download(self, key: Key, command: int, data: bytes) -> bytes:
        expedited, sized = command & 0x02, command & 0x01
        entry = self._dictionary.find(key)
        if expedited:
            size = 4 - ((command >> 2) & 0x03) if sized else entry.type.size
            self._dictionary.write(key, data[:size])
        else:
            announced = int.from_bytes(data, "little") if sized else None
            if announced is not None and announced > _MAX_DOWNLOAD:
                raise SdoAbort(AbortCode.OUT_OF_MEMORY)
            self._transfer = _Transfer(key, bytearray(), upload=False, size=announced)
        return _HEADER.pack(0x60, *key, bytes(4))

    def _download_segment(self, command: int, data: bytes) -> bytes:
        transfer = self._running(upload=False, toggle=command >> 4 & 1)
        transfer.data += data[: 7 - (command >> 1 & 0x07)]
        if len(transfer.data) > _MAX_DOWNLOAD:
            raise SdoAbort(AbortCode.OUT_OF_MEMORY)
        if command & 0x01:
            if transfer.size is not None and transfer.size != len(transfer.data):
                raise SdoAbort(AbortCode.LENGTH)
            self._dictionary.write(transfer.key, bytes(transfer.data))
            self._transfer = None
        answer = 0x20 | transfer.toggle << 4
        transfer.toggle ^= 1
        return bytes((answer, 0, 0, 0, 0, 0, 0, 0))

    def _start_upload(self, key: Key) -> bytes:
        data = self._dictionary.read(key)
        if 0 < len(data) <= 4:
            return _HEADER.pack(0x43 | (4 - len(data)) << 2, *key, data.ljust(4, b"\0"))
        self._transfer = _Transfer(key, bytearray(data), upload=True)
        return _HEADER.pack(0x41, *key, struct.pack("<I", len(data)))

    def _upload_segment(self, command: int) -> bytes:
        transfer = self._running(upload=True, toggle=command >> 4 & 1)
        part = bytes(transfer.data[:7])
        del transfer.data[:7]
        last = not transfer.data
        answer = transfer.toggle << 4 | (7 - len(part)) << 1 | last
        transfer.toggle ^= 1
        if last:
            self._transfer = None
        return bytes((answer,)) + part.ljust(7, b"\0")

    def _running(self, *, upload: bool, toggle: int) -> _Transfer:
        transfer = self._transfer
        if transfer is None or transfer.upload is not upload:
            raise SdoAbort(AbortCode.UNKNOWN_COMMAND)
        if toggle != transfer.toggle:
            raise SdoAbort(AbortCode.TOGGLE_BIT)
        return transfer
