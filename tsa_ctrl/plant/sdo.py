"""SDO server (CiA 301): expedited, segmented and block transfers both ways, one at a time."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from tsa_ctrl.plant.dictionary import AbortCode, Key, ObjectDictionary, SdoAbort
from tsa_ctrl.plant.sdo_block import BlockDownload, BlockUpload

_HEADER = struct.Struct("<BHB4s")
_MAX_DOWNLOAD = 4096  # bytes; more is refused, a node's memory is small
_ABORT = 0x80


@dataclass(slots=True)
class _Transfer:
    key: Key
    data: bytearray
    toggle: int = 0
    upload: bool = True
    size: int | None = None


class SdoServer:
    """Answers requests with responses, all of 8 bytes; holds the state of one transfer of several frames."""

    def __init__(self, dictionary: ObjectDictionary) -> None:
        self._dictionary = dictionary
        self._transfer: _Transfer | None = None
        self._block: BlockUpload | BlockDownload | None = None

    def reset(self) -> None:
        self._transfer = self._block = None

    def handle(self, request: bytes) -> list[bytes]:
        """The responses to one request frame; none to an abort, a frame that is no SDO, or amid a block."""
        if len(request) != 8:
            return []
        if request[0] == _ABORT:
            self.reset()
            return []
        try:
            if self._block is not None:
                return self._continue_block(self._block, request)
            answer = self._answer(request)
            return [answer]
        except SdoAbort as abort:
            running = self._block or (self._transfer if request[0] >> 5 in (0, 3) else None)
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
        if specifier == 5 and command & 0x03 == 0:
            value = self._dictionary.read((index, sub))
            self._block = BlockUpload((index, sub), value, data[0], bool(command & 0x04))
            return self._block.first()
        if specifier == 6 and command & 0x01 == 0:
            self._dictionary.find((index, sub))
            size = int.from_bytes(data, "little") if command & 0x02 else None
            self._block = BlockDownload((index, sub), size, bool(command & 0x04), _MAX_DOWNLOAD)
            return self._block.first()
        raise SdoAbort(AbortCode.UNKNOWN_COMMAND)

    def _continue_block(self, block: BlockUpload | BlockDownload, request: bytes) -> list[bytes]:
        answers, over = block.take(request)
        if over:
            if isinstance(block, BlockDownload):
                self._dictionary.write(block.key, bytes(block.data))
            self._block = None
        return answers

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
