"""The daemon's MCAP logs read back, whole or cut off: everything up to the last whole chunk.

Chunks are decoded as arrays, not message by message: an hour at 1 kHz takes about a second.
"""

from __future__ import annotations

import io
import json
import mmap
import zlib
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Metadata, Schema
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.mcap_file import FILES, MAGIC, SCHEMA_NAME
from tsa_ctrl.log.table import Table

_PREFIX = 9  # opcode and length of a record
_MESSAGE_HEAD = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("times", "<u8", (2,)),
        ("cdr", "V4"),
    ]
)


@dataclass
class LogContents:
    """A log file taken apart: axes in order, fields, metadata, and per axis the decoded blocks of records.

    `kept` are the fields that were decoded, in the order of the blocks' columns. `complete` is false when the file was
    cut off (its writer was killed or is still writing); `damaged` counts chunks whose check sum is wrong, which are
    left out.
    """

    axes: list[str] = field(default_factory=list)
    fields: list[str] = field(default_factory=list)
    kept: list[str] = field(default_factory=list)
    about: dict[str, Any] = field(default_factory=dict)
    files: dict[str, str] = field(default_factory=dict)
    blocks: dict[str, list[NDArray[np.float64]]] = field(default_factory=dict)
    complete: bool = False
    damaged: int = 0

    @property
    def codes(self) -> dict[str, dict[int, str]]:
        """Names of the coded fields' values."""
        return {
            name: {int(code): text for code, text in names.items()}
            for name, names in self.about.get("codes", {}).items()
        }

    def column(self, axis: str, name: str) -> NDArray[np.float64]:
        """One field of one axis over the whole log."""
        index = self.kept.index(name)
        return np.concatenate([np.empty(0), *(block[:, index] for block in self.blocks[axis])])


def read_log(path: Path, wanted: Collection[str] | None = None) -> LogContents:
    """Read all axes of a log, `wanted` fields only (None: all). Raises UsageError when it is no log of this package."""
    contents = LogContents()
    channels: dict[int, str] = {}
    pick = np.empty(0, dtype=np.int64)
    with path.open("rb") as stream:
        try:
            data = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
        except ValueError:
            raise UsageError(f"{path}: is empty; give a log that was recorded") from None
        with data:
            if data[: len(MAGIC)] != MAGIC:
                raise UsageError(f"{path}: is no MCAP file; give a log that the daemon wrote")
            for opcode, content in _records(data):
                if opcode == Opcode.SCHEMA:
                    _take_schema(path, content, contents)
                    contents.kept = [name for name in contents.fields if wanted is None or name in wanted]
                    pick = np.array([contents.fields.index(name) for name in contents.kept], dtype=np.int64)
                elif opcode == Opcode.CHANNEL:
                    channel = Channel.read(_stream(content))
                    axis = channel.metadata.get("axis", channel.topic.strip("/"))
                    if channel.id not in channels:
                        channels[channel.id] = axis
                        contents.axes.append(axis)
                        contents.blocks[axis] = []
                elif opcode == Opcode.METADATA:
                    _take_metadata(Metadata.read(_stream(content)), contents)
                elif opcode == Opcode.CHUNK:
                    _take_chunk(content, contents, channels, pick)
                elif opcode == Opcode.FOOTER:
                    contents.complete = True
    if not contents.fields or not contents.axes:
        raise UsageError(f"{path}: holds no axis (cut off at its head, or not from this package); give another log")
    return contents


def read_axis(path: Path, axis: str | None, wanted: Collection[str] | None = None) -> Table:
    """One axis of a log as a table. Raises UsageError when there are several and none is named, or it is unknown."""
    contents = read_log(path, wanted)
    listed = ", ".join(contents.axes)
    if axis is None and len(contents.axes) > 1:
        raise UsageError(f"{path}: holds the axes {listed}; name one as {path}:{contents.axes[0]}")
    if axis is not None and axis not in contents.axes:
        raise UsageError(f"{path}: holds no axis '{axis}'; it holds {listed}")
    axis = axis or contents.axes[0]
    columns: dict[str, NDArray[np.float64]] = {}
    for name in contents.kept:
        values = contents.column(axis, name)
        if name == "t" or not np.isnan(values).all():
            columns[name] = values
    label = str(path) if len(contents.axes) == 1 else f"{path}:{axis}"
    left_out = tuple(name for name in contents.fields if name not in contents.kept)
    return Table(label, columns, left_out, axis=axis, recorded=True)


def _records(data: mmap.mmap) -> Iterator[tuple[int, bytes]]:
    """Opcode and content of each whole record; ends where the file is cut off or its trailing magic begins."""
    position, end = len(MAGIC), len(data)
    while position + _PREFIX <= end:
        opcode = data[position]
        length = int.from_bytes(data[position + 1 : position + _PREFIX], "little")
        position += _PREFIX
        if length > end - position:
            return
        yield opcode, data[position : position + length]
        position += length
        if opcode == Opcode.FOOTER:
            return


def _stream(content: bytes) -> ReadDataStream:
    return ReadDataStream(io.BytesIO(content))


def _take_schema(path: Path, content: bytes, contents: LogContents) -> None:
    schema = Schema.read(_stream(content))
    if schema.name != SCHEMA_NAME:
        raise UsageError(
            f"{path}: holds messages of type '{schema.name}', not a log of this package; convert it to CSV"
        )
    lines = schema.data.decode().splitlines()
    contents.fields = [line.split("#")[0].split()[1] for line in lines if line.startswith("float64")]


def _take_metadata(record: Metadata, contents: LogContents) -> None:
    if record.name.startswith(FILES):
        contents.files[record.name.removeprefix(FILES)] = record.metadata["text"]
        return
    about: dict[str, Any] = dict(record.metadata)
    for key in ("axes", "fields", "units", "codes", "rate"):
        about[key] = json.loads(about[key])
    contents.about = about


def _take_chunk(content: bytes, contents: LogContents, channels: dict[int, str], pick: NDArray[np.int64]) -> None:
    chunk = Chunk.read(_stream(content))
    try:
        data = zstandard.decompress(chunk.data, chunk.uncompressed_size)
    except zstandard.ZstdError:
        contents.damaged += 1
        return
    message = np.dtype([("head", _MESSAGE_HEAD), ("values", "<f8", (len(contents.fields),))])
    if zlib.crc32(data) != chunk.uncompressed_crc or len(data) % message.itemsize:
        contents.damaged += 1
        return
    messages = np.frombuffer(data, dtype=message)
    for number in np.unique(messages["head"]["channel"]).tolist():
        values = messages["values"][messages["head"]["channel"] == number]
        contents.blocks[channels[number]].append(np.ascontiguousarray(values[:, pick]))
