"""SDO server (CiA 301): expedited and segmented transfers both ways, one at a time; block transfer is refused."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from tsa_ctrl.plant.dictionary import AbortCode, Key, ObjectDictionary, SdoAbort

_HEADER = struct.Struct("<BHB4s")
_MAX_DOWNLOAD = 4096  # bytes; more is refused, a node's memory is small


@dataclass(slots=True)
class _Transfer:
    key: Key
    data: bytearray
    toggle: int = 0
    upload: bool = True
    size: int | None = None


class SdoServer:
    """Answers requests with responses, both 8 bytes; holds the state of one segmented transfer."""

    def __init__(self, dictionary: ObjectDictionary) -> None:
        self._dictionary = dictionary
        self._transfer: _Transfer | None = None

    def reset(self) -> None:
        self._transfer = None

    def handle(self, request: bytes) -> bytes | None:
        """The response to one request frame; None when there is nothing to say (an abort, a frame that is no SDO)."""
        if len(request) != 8:
            return None
        command, index, sub, data = _HEADER.unpack(request)
        specifier = command >> 5
        try:
            if specifier == 1:
                return self._start_download((index, sub), command, data)
            if specifier == 0:
                return self._download_segment(command, request[1:])
            if specifier == 2:
                return self._start_upload((index, sub))
            if specifier == 3:
                return self._upload_segment(command)
            if specifier == 4:
                self._transfer = None
                return None
            raise SdoAbort(AbortCode.UNKNOWN_COMMAND)
        except SdoAbort as abort:
            key = self._transfer.key if self._transfer and specifier in (0, 3) else (index, sub)
            self._transfer = None
            return _HEADER.pack(0x80, *key, struct.pack("<I", abort.code))

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
