"""Read the daemon's MCAP logs, complete or truncated, up to the last complete chunk.

The records are parsed with the mcap library, but its reader is not used. That reader yields single messages and takes
4.9 s of processor time for ten minutes at 1 kHz. Decoding chunks as arrays takes 0.63 s. The library's reader also
reads nothing from a truncated file ("unknown (opcode 196) record has length 16256141150751413024"), and returns a
flipped byte as a value. This module reads a truncated file up to its last chunk, skips damaged chunks, and reports
both.
"""

from __future__ import annotations

import io
import json
import os
import struct
import zlib
from collections.abc import Callable, Collection, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Metadata, Schema, Statistics
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.mcap_file import FILES, HEAD, MAGIC, NOTES_SCHEMA, NOTES_TOPIC, SCHEMA_NAME, Note, message_type
from tsa_ctrl.signals import JOINT_ANGLE

ALWAYS = 256 << 20  # bytes to which any file may unpack: half an hour of one axis at 1 kHz as CSV
RATIO = 200  # permitted compression ratio above that size: logs of a rig at rest reach 60, of a moving rig 2 to 10


class DecompressionLimit:
    """Limit the unpacked size of a compressed file, so that a small file cannot fill the reader's memory."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.left = max(ALWAYS, RATIO * path.stat().st_size)

    def take(self, size: int) -> None:
        """Count `size` bytes. Raise UsageError if the total exceeds the limit."""
        self.left -= size
        if self.left < 0:
            limit = max(ALWAYS, RATIO * self._path.stat().st_size)
            raise UsageError(
                f"{self._path}: unpacks to more than {limit >> 20} MiB from {self._path.stat().st_size >> 10} KiB, "
                "which no log does; unpack it yourself if you trust it"
            )


_DAMAGED = (ValueError, LookupError, OverflowError, MemoryError, struct.error, McapError)  # from parsing garbage
_PREFIX = 9  # bytes of opcode and length before the content of a record


class LogFile:
    """A log of the daemon. The constructor reads the header, and `blocks` reads the records.

    The last three attributes are valid once `blocks` has ended.

    Attributes:
        axes: names of the axes, in order.
        fields: names of the columns, in order.
        about: metadata of the header (version, rate, started, units, codes).
        files: text of each configuration file by its name.
        complete: False if the file is truncated, because its writer was killed or is still writing.
        damaged: number of missing or damaged chunks.
        notes: events in order. Logs of earlier versions have none.
    """

    def __init__(self, path: Path) -> None:
        """Read the header. Raise UsageError if `path` is not a log of this package."""
        self.path = path
        self.axes: list[str] = []
        self.fields: list[str] = []
        self.about: dict[str, Any] = {}
        self.files: dict[str, str] = {}
        self.complete = False
        self.damaged = 0
        self.notes: list[Note] = []
        self._notes_channel: int | None = None
        self._channels: dict[int, str] = {}
        with path.open("rb") as stream:
            magic = stream.read(len(MAGIC))
        if magic != MAGIC:
            raise UsageError(f"{path}: is {'not an MCAP file' if magic else 'empty'}; give a log that the daemon wrote")
        try:
            self._read_head()
        except _DAMAGED as error:
            raise UsageError(f"{path}: its header is damaged ({error}); give another copy") from None
        self.axes = list(self._channels.values())
        if not self.fields or not self.axes:
            raise UsageError(f"{path}: has no axis (header cut off, or not a log of this package); give another log")

    @property
    def codes(self) -> dict[str, dict[int, str]]:
        """Return the names of the values of coded fields."""
        codes: dict[str, dict[str, str]] = self.about.get("codes", {})
        return {field: {int(code): name for code, name in names.items()} for field, names in codes.items()}

    @property
    def problems(self) -> list[str]:
        """Return the defects of the file as text. The list is complete once `blocks` has ended."""
        problems = (
            [] if self.complete else ["the log was cut off, or is still being written; read up to its last chunk"]
        )
        if self.damaged:
            problems.append(f"damaged chunks left out: {self.damaged}")
        return problems

    def chosen(self, axis: str | None) -> list[str]:
        """Return the name of one axis in a list, or all names for None. Raise UsageError for an unknown axis."""
        if axis is not None and axis not in self.axes:
            raise UsageError(f"{self.path}: has no axis '{axis}'; its axes are {', '.join(self.axes)}")
        return self.axes if axis is None else [axis]

    def blocks(self, wanted: Collection[str]) -> Iterator[tuple[str, NDArray[np.float64]]]:
        """Yield name and records (k, fields) of each axis in each chunk, with the fields in the order of `wanted`."""
        pick = [self.fields.index(name) for name in wanted]
        message = message_type(len(self.fields))
        self.complete, self.damaged = False, 0
        self.notes = []
        counted = DecompressionLimit(self.path)
        chunks = 0
        for opcode, content in self._records():
            if opcode == Opcode.FOOTER:
                self.complete = True
            elif opcode == Opcode.STATISTICS:  # counts chunks that were not recognised because of a damaged first byte
                announced = _announced(content)
                self.damaged += 1 if announced is None else abs(announced - chunks)
            if opcode != Opcode.CHUNK:
                continue
            chunks += 1
            data = _unpacked(content, counted)
            if data is not None and self._holds_notes(data):
                self.notes += _notes(data)
                continue
            if data is None or len(data) % message.itemsize:
                self.damaged += 1
                continue
            messages = np.frombuffer(data, dtype=message)
            channel = messages["channel"]
            numbers = np.unique(channel).tolist()
            if not self._channels.keys() >= set(numbers):  # records of an axis that is not in the header
                self.damaged += 1
                continue
            for number in numbers:
                yield self._channels[number], np.ascontiguousarray(messages["values"][channel == number][:, pick])

    def columns(self, axis: str, wanted: Collection[str]) -> dict[str, NDArray[np.float64]]:
        """Return the chosen fields of one axis over the whole log."""
        names = list(wanted)
        found = [bytearray() for _ in names]  # they grow in place, because a list of parts would fragment the heap
        for name, block in self.blocks(names):
            if name == axis:
                for column, values in zip(found, block.T, strict=True):
                    column += values.astype(np.float64).tobytes()
        return {name: np.frombuffer(column, dtype=np.float64) for name, column in zip(names, found, strict=True)}

    def joint_angles(self) -> dict[str, Callable[[NDArray[np.float64]], NDArray[np.float64]]]:
        """Return functions that map the record times (s) of an axis to q_j.NAME, by column name.

        The axes of a log share the clock of the loop. The value is nan at a time without a record of axis NAME. The
        result is empty for a log with one axis.
        """
        if len(self.axes) < 2 or not {"t", "q_j"} <= set(self.fields):
            return {}
        blocks: dict[str, list[NDArray[np.float64]]] = {axis: [] for axis in self.axes}
        for axis, block in self.blocks(("t", "q_j")):
            blocks[axis].append(block)
        joined = {axis: np.concatenate(parts) for axis, parts in blocks.items() if parts}
        return {
            f"{JOINT_ANGLE}{axis}": partial(_at_times, rows[:, 0].copy(), rows[:, 1].copy())
            for axis, rows in joined.items()
            if not np.isnan(rows[:, 1]).all()
        }

    def _holds_notes(self, data: bytes) -> bool:
        """Return True if an unpacked chunk contains events. A chunk contains either records or events."""
        channel = int.from_bytes(data[_PREFIX : _PREFIX + 2], "little")
        return self._notes_channel is not None and channel == self._notes_channel

    def _records(self) -> Iterator[tuple[int, bytes]]:
        """Yield opcode and content of each complete record, up to the end of the file."""
        with self.path.open("rb") as stream:
            left = os.fstat(stream.fileno()).st_size - stream.seek(len(MAGIC))
            while left >= _PREFIX:
                prefix = stream.read(_PREFIX)
                opcode, length = prefix[0], int.from_bytes(prefix[1:], "little")
                left -= _PREFIX + length
                if left < 0:
                    return
                yield opcode, stream.read(length)
                if opcode == Opcode.FOOTER:
                    return

    def _read_head(self) -> None:
        read = 0  # CRC 32 of the records before this one
        for opcode, content in self._records():
            before, read = read, _chained(read, opcode, content)
            if opcode == Opcode.SCHEMA:
                self._take_schema(Schema.read(_stream(content)))
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(_stream(content))
                if channel.topic == NOTES_TOPIC and "axis" not in channel.metadata:
                    self._notes_channel = channel.id
                    continue
                self._channels[channel.id] = channel.metadata.get("axis", channel.topic.strip("/"))
            elif opcode == Opcode.METADATA:
                record = Metadata.read(_stream(content))
                if record.name == HEAD:
                    if record.metadata != {"crc32": f"{before:08x}"}:
                        raise ValueError("wrong checksum")
                    return
                self._take_metadata(record)
            elif opcode in (Opcode.CHUNK, Opcode.DATA_END):
                break
        if "checksum" in self.about:  # logs of earlier versions have none
            raise ValueError("no checksum")

    def _take_schema(self, schema: Schema) -> None:
        if schema.name == NOTES_SCHEMA:
            return
        if schema.name != SCHEMA_NAME:
            raise UsageError(
                f"{self.path}: holds {schema.name[:40]!r} messages, not a log of this package; convert it to CSV"
            )
        lines = schema.data.decode().splitlines()
        self.fields = [line.split("#")[0].split()[1] for line in lines if line.startswith("float64")]

    def _take_metadata(self, record: Metadata) -> None:
        if record.name.startswith(FILES):
            self.files[record.name.removeprefix(FILES)] = record.metadata["text"]
            return
        self.about = dict(record.metadata)
        for key in ("axes", "fields", "units", "codes", "rate"):
            self.about[key] = json.loads(self.about[key])


def _notes(data: bytes) -> list[Note]:
    """Return the undamaged events of an unpacked chunk of events."""
    found = []
    position = 0
    while position + _PREFIX <= len(data):
        length = int.from_bytes(data[position + 1 : position + _PREFIX], "little")
        position += _PREFIX
        try:
            content = json.loads(Message.read(_stream(data[position : position + length]), length).data)
            found.append(Note(float(content["t"]), content["name"], content["message"], bool(content["fault"])))
        except (*_DAMAGED, TypeError):
            pass
        position += length
    return found


def _announced(content: bytes) -> int | None:
    """Return the number of chunks from the statistics at the end of a log, or None if these are damaged."""
    try:
        return int(Statistics.read(_stream(content)).chunk_count)
    except _DAMAGED:
        return None


def _chained(checksum: int, opcode: int, content: bytes) -> int:
    """Return the CRC 32 of all earlier records, with the CRC 32 `checksum`, and one more record."""
    return zlib.crc32(content, zlib.crc32(bytes([opcode]) + len(content).to_bytes(8, "little"), checksum))


def _stream(content: bytes) -> ReadDataStream:
    return ReadDataStream(io.BytesIO(content))


def _unpacked(content: bytes, counted: DecompressionLimit) -> bytes | None:
    """Return the messages of a chunk, or None if they are damaged. Raise UsageError above the size limit."""
    try:
        chunk = Chunk.read(_stream(content))
        if zstandard.frame_content_size(chunk.data) != chunk.uncompressed_size:
            return None
        counted.take(chunk.uncompressed_size)
        data: bytes = zstandard.decompress(chunk.data, chunk.uncompressed_size)
    except (*_DAMAGED, zstandard.ZstdError):
        return None
    return data if zlib.crc32(data) == chunk.uncompressed_crc else None


def _at_times(known: NDArray[np.float64], values: NDArray[np.float64], t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the values at the times `t`, or nan for a time that is not in the increasing times `known`."""
    place = np.minimum(np.searchsorted(known, t), len(known) - 1)
    return np.where(known[place] == t, values[place], np.nan)
