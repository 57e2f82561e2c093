"""Write an MCAP file that stays readable up to its last chunk even if the writing process is killed.

The format is the MCAP specification, version 0 (mcap.dev/spec). Each axis has one channel with schema encoding
"ros2msg" and message encoding "cdr": four bytes of header, then the doubles of one record, little-endian. Another
channel has the events (faults with their cause) in separate chunks, as JSON with the schema "foxglove.Log". Chunks and
the head have a checksum. Indices for fast opening are written at the end.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Message,
    MessageIndex,
    Metadata,
    Schema,
    Statistics,
)
from numpy.typing import NDArray

from tsa_ctrl.log.process import LogHeader
from tsa_ctrl.log.ring import NOTE_BYTES
from tsa_ctrl.signals import FIELDS


@dataclass(frozen=True)
class Note:
    """An event of the log, such as a fault with its cause, a loss or the end of the run.

    Attributes:
        t: time since the start of the log, s.
        axis: name of the axis; empty if the event concerns all axes.
        text: description of the event.
        fault: True if the event stopped the torque.
    """

    t: float
    axis: str
    text: str
    fault: bool

    def __str__(self) -> str:
        return f"{self.t:9.3f} s  {'FAULT  ' if self.fault else ''}{self.axis + ': ' if self.axis else ''}{self.text}"

    def encoded(self) -> bytes:
        """Return the event as JSON for the ring buffer, with the text shortened to fit."""
        text = self.text
        while len(data := json.dumps({**vars(self), "text": text}).encode()) > NOTE_BYTES:
            text = text[: len(text) * 3 // 4]
        return data

    @staticmethod
    def decoded(data: bytes) -> Note | None:
        """Return the event in `data`, or None if `data` is damaged."""
        try:
            found = json.loads(data)
            return Note(float(found["t"]), str(found["axis"]), str(found["text"]), bool(found["fault"]))
        except (ValueError, TypeError, KeyError):
            return None


MAGIC = b"\x89MCAP0\r\n"
SCHEMA_NAME = "tsa_ctrl/msg/Cycle"
CDR_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
NOTES_TOPIC, NOTES_SCHEMA = "/events", "foxglove.Log"
NOTES_ENCODING = "json"
INFO, ERROR = 2, 4  # levels of foxglove.Log
HEAD = "head"  # metadata record at the end of the head, with the checksum of all bytes between MAGIC and this record
FILES = "file:"  # prefix of the metadata records that contain the text of a configuration file
RUN = "run.json"  # file in the head that contains the arguments of a virtual run; other logs have none


def message_type(fields: int) -> np.dtype[np.void]:
    """Return the type of a message record inside a chunk, packed, with this number of values."""
    return np.dtype(
        [
            ("opcode", "u1"),
            ("length", "<u8"),
            ("channel", "<u2"),
            ("sequence", "<u4"),
            ("log_time", "<u8"),
            ("publish_time", "<u8"),
            ("cdr", "V4"),
            ("values", "<f8", (fields,)),
        ]
    )


MESSAGE = message_type(len(FIELDS))


def schema_text() -> bytes:
    """Return the record as a ROS 2 message definition, with units and meanings as comments."""
    return "".join(f"float64 {column.name}  # {column.unit}: {column.doc}\n" for column in FIELDS).encode()


def notes_schema_text() -> bytes:
    """Return the JSON schema of a note: foxglove.Log with time, axis and fault as in `Note`."""
    time_type = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
    kinds = {"level": "integer", "message": "string", "name": "string", "t": "number", "fault": "boolean"}
    properties = {"timestamp": time_type, **{name: {"type": kind} for name, kind in kinds.items()}}
    return json.dumps({"title": NOTES_SCHEMA, "type": "object", "properties": properties}).encode()


class McapFile:
    """Write records chunk by chunk. If a chunk cannot be written, the file stays readable up to the previous one."""

    def __init__(self, path: Path, header: LogHeader) -> None:
        """Create the new file `path`, and write the head of the log. Raise OSError if `path` exists or on failure."""
        self._file = path.open("xb", buffering=0)
        self._header = header
        self._position = 0
        self._sequence = [0] * len(header.axes)
        self._indices: list[ChunkIndex] = []
        self._compress = zstandard.ZstdCompressor(level=1).compress
        self._first_time = self._last_time = 0
        self._schema = Schema(id=1, name=SCHEMA_NAME, encoding="ros2msg", data=schema_text())
        self._channels = [
            Channel(id=i + 1, topic=f"/{name}", message_encoding="cdr", metadata={"axis": name}, schema_id=1)
            for i, name in enumerate(header.axes)
        ]
        self._notes = 0
        self._notes_schema = Schema(id=2, name=NOTES_SCHEMA, encoding="jsonschema", data=notes_schema_text())
        self._notes_channel = Channel(
            id=len(header.axes) + 1, topic=NOTES_TOPIC, message_encoding=NOTES_ENCODING, metadata={}, schema_id=2
        )
        try:
            self._append(MAGIC + self._head())
        except OSError:
            self._file.close()
            path.unlink(missing_ok=True)
            raise

    @property
    def written(self) -> int:
        """Return the number of records written so far."""
        return sum(self._sequence)

    @property
    def size(self) -> int:
        """Return the number of bytes written so far."""
        return self._position

    def write(self, records: Sequence[NDArray[np.float64]]) -> None:
        """Write one chunk with the records of each axis, (k, fields). On OSError the file stays unchanged."""
        messages = [self._messages(axis, block) for axis, block in enumerate(records)]
        if not any(len(block) for block in messages):
            return
        data = b"".join(block.tobytes() for block in messages)
        times = np.concatenate([block["log_time"] for block in messages])
        entries: dict[int, list[tuple[int, int]]] = {}
        begin = 0
        for axis, block in enumerate(messages):
            if len(block):
                at = range(begin, begin + block.nbytes, MESSAGE.itemsize)
                entries[axis + 1] = list(zip(block["log_time"].tolist(), at, strict=True))
            begin += block.nbytes
        self._write_chunk(data, entries, int(times.min()), int(times.max()))
        for axis, block in enumerate(messages):
            self._sequence[axis] += len(block)

    def write_notes(self, notes: Sequence[Note]) -> None:
        """Write one chunk of events. On OSError the file stays unchanged."""
        if not notes:
            return
        builder = RecordBuilder()
        entries: list[tuple[int, int]] = []
        for number, note in enumerate(notes, self._notes):
            at = max(0, round(note.t * 1e9) + round(self._header.started * 1e9))
            entries.append((at, builder.count))
            content = {
                "timestamp": {"sec": at // 1_000_000_000, "nsec": at % 1_000_000_000},
                "level": ERROR if note.fault else INFO,
                "message": note.text,
                "name": note.axis,
                "t": note.t,
                "fault": note.fault,
            }
            Message(
                channel_id=self._notes_channel.id,
                log_time=at,
                publish_time=at,
                sequence=number,
                data=json.dumps(content).encode(),
            ).write(builder)
        times = [at for at, _ in entries]
        self._write_chunk(bytes(builder.end()), {self._notes_channel.id: entries}, min(times), max(times))
        self._notes += len(notes)

    def _write_chunk(self, data: bytes, entries: dict[int, list[tuple[int, int]]], start: int, end: int) -> None:
        """Write a chunk of message records and its indices.

        Args:
            data: message records.
            entries: time (ns) and offset (bytes) of each message by channel.
            start: earliest time of a message, ns.
            end: latest time of a message, ns.
        """
        builder = RecordBuilder()
        Chunk(
            compression="zstd",
            data=self._compress(data),
            message_start_time=start,
            message_end_time=end,
            uncompressed_crc=zlib.crc32(data),
            uncompressed_size=len(data),
        ).write(builder)
        chunk_length = builder.count
        offsets: dict[int, int] = {}
        for channel, records in entries.items():
            offsets[channel] = self._position + builder.count
            MessageIndex(channel_id=channel, records=records).write(builder)
        index = ChunkIndex(
            chunk_start_offset=self._position,
            chunk_length=chunk_length,
            compression="zstd",
            compressed_size=chunk_length - 9 - 40 - len("zstd"),
            message_start_time=start,
            message_end_time=end,
            message_index_length=builder.count - chunk_length,
            message_index_offsets=offsets,
            uncompressed_size=len(data),
        )
        self._append(builder.end())
        self._first_time = start if not self._indices else min(start, self._first_time)
        self._last_time = max(end, self._last_time)
        self._indices.append(index)

    def sync(self) -> None:
        """Wait until the written data is on the disk. Raise OSError on failure."""
        os.fsync(self._file.fileno())

    def finish(self) -> None:
        """Write the indices and close the file, which is readable even without them. Raise OSError on failure."""
        try:
            self._append(self._summary())
            self.sync()
        finally:
            self._file.close()

    def close(self) -> None:
        """Close the file as it is. Repeated calls are permitted."""
        self._file.close()

    def _messages(self, axis: int, block: NDArray[np.float64]) -> NDArray[Any]:
        messages = np.zeros(len(block), dtype=MESSAGE)
        messages["opcode"] = Opcode.MESSAGE
        messages["length"] = MESSAGE.itemsize - 9
        messages["channel"] = axis + 1
        messages["sequence"] = (self._sequence[axis] + np.arange(len(block))) & 0xFFFFFFFF
        seconds = np.nan_to_num(block[:, 0], nan=0.0, posinf=0.0, neginf=0.0)
        nanoseconds = np.rint(seconds * 1e9).astype(np.int64) + round(self._header.started * 1e9)
        messages["log_time"] = messages["publish_time"] = np.maximum(nanoseconds, 0)
        messages["cdr"] = np.void(CDR_LITTLE_ENDIAN)
        messages["values"] = block
        return messages

    def _append(self, data: bytes) -> None:
        """Append all of `data` or nothing."""
        view = memoryview(data)
        try:
            while view:
                view = view[self._file.write(view) :]
        except OSError:
            self._file.truncate(self._position)
            self._file.seek(self._position)
            raise
        self._position += len(data)

    def _head(self) -> bytes:
        builder = RecordBuilder()
        Header(profile="", library=f"tsa-ctrl {self._header.version}").write(builder)
        self._write_channels(builder)
        for record in self._metadata():
            record.write(builder)
        head = bytes(builder.end())
        Metadata(name=HEAD, metadata={"crc32": f"{zlib.crc32(head):08x}"}).write(builder)
        return head + bytes(builder.end())

    def _write_channels(self, builder: RecordBuilder) -> None:
        for schema in (self._schema, self._notes_schema):
            schema.write(builder)
        for channel in (*self._channels, self._notes_channel):
            channel.write(builder)

    def _metadata(self) -> list[Metadata]:
        header = self._header
        started = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(header.started))
        about = {
            "version": header.version,
            "build": header.build,
            "axes": json.dumps(list(header.axes)),
            "rate": repr(header.rate),
            "started": started,
            "fields": json.dumps([column.name for column in FIELDS]),
            "units": json.dumps({column.name: column.unit for column in FIELDS}),
            "codes": json.dumps(header.codes),
            "checksum": HEAD,  # so that a damaged HEAD record is also detected
        }
        records = [Metadata(name="tsa_ctrl", metadata=about)]
        for name, text in header.files.items():
            sha256 = hashlib.sha256(text.encode()).hexdigest()
            records.append(Metadata(name=FILES + name, metadata={"sha256": sha256, "text": text}))
        return records

    def _summary(self) -> bytes:
        builder = RecordBuilder()
        DataEnd(data_section_crc=0).write(builder)
        start = self._position + builder.count
        self._write_channels(builder)
        Statistics(
            attachment_count=0,
            channel_count=len(self._channels) + 1,
            channel_message_counts={
                **{axis + 1: count for axis, count in enumerate(self._sequence)},
                self._notes_channel.id: self._notes,
            },
            chunk_count=len(self._indices),
            message_count=self.written + self._notes,
            message_start_time=self._first_time,
            message_end_time=self._last_time,
            metadata_count=2 + len(self._header.files),
            schema_count=2,
        ).write(builder)
        for index in self._indices:
            index.write(builder)
        Footer(summary_start=start, summary_offset_start=0, summary_crc=0).write(builder)
        return bytes(builder.end()) + MAGIC
