"""Test the events in a log: faults with their cause, in addition to the records."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader

from tests.log.logs import HEADER, kill_an_owner, notes_of, push, wait_for
from tsa_ctrl.cli import main
from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.convert import convert
from tsa_ctrl.log.mcap_file import Note
from tsa_ctrl.log.process import LogProcess
from tsa_ctrl.log.reader import LogFile
from tsa_ctrl.log.ring import NOTE_BYTES, RingReader, RingWriter
from tsa_ctrl.log.writer import DEAD, LogWriter

FAULT = Note(0.25, "knee", "stale PDO: drive node 1: 3 cycles in a row", fault=True)
LOSS = Note(0.1, "", "log: written again", fault=False)


def log_with(ring: RingWriter, path: Path, *notes: Note) -> Path:
    writer = LogWriter(RingReader(ring.fd), path, HEADER)
    push(ring, 300)
    for note in notes:
        ring.note(note.encoded())
    writer.end()
    return path


def test_notes_come_back_in_order_beside_the_records(ring: RingWriter, tmp_path: Path) -> None:
    file = LogFile(log_with(ring, tmp_path / "x.mcap", LOSS, FAULT))
    assert file.axes == ["hip", "knee"]
    assert len(file.columns("knee", ["t"])["t"]) == 300
    assert file.notes == [LOSS, FAULT]
    assert (file.complete, file.damaged) == (True, 0)


def test_the_library_of_the_format_reads_them_as_log_messages(ring: RingWriter, tmp_path: Path) -> None:
    data = log_with(ring, tmp_path / "x.mcap", FAULT).read_bytes()
    found = [
        (schema.name, json.loads(message.data))
        for schema, channel, message in make_reader(io.BytesIO(data)).iter_messages(topics=["/events"])
        if schema is not None
    ]
    ((name, content),) = found
    assert name == "foxglove.Log"
    assert (content["level"], content["message"], content["name"]) == (4, FAULT.text, "knee")
    assert content["timestamp"] == {"sec": 1_700_000_000, "nsec": 250_000_000}


def test_info_tells_them_and_convert_leaves_the_table_as_it_was(
    ring: RingWriter, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = log_with(ring, tmp_path / "x.mcap", FAULT)
    with pytest.raises(SystemExit):
        main(["log", "info", str(path), "--json"])
    assert json.loads(capsys.readouterr().out)["events"] == [vars(FAULT)]
    with pytest.raises(SystemExit):
        main(["log", "info", str(path)])
    assert f"FAULT  knee: {FAULT.text}" in capsys.readouterr().out
    written = convert(path, tmp_path / "x.csv")
    assert [len(file.path.read_text().splitlines()) for file in written] == [301, 301]


def test_notes_survive_a_disk_in_trouble(ring: RingWriter, tmp_path: Path) -> None:
    """A note that could not be written is written once the folder exists."""
    folder = tmp_path / "later"
    writer = LogWriter(RingReader(ring.fd), folder / "x.mcap", HEADER)
    ring.note(FAULT.encoded())
    writer.step(0.0)
    folder.mkdir()
    writer.step(10.0)
    writer.end()
    assert notes_of(LogFile(folder / "x.mcap")) == [FAULT]


def test_a_ring_overrun_by_notes_keeps_the_newest(ring: RingWriter) -> None:
    reader = RingReader(ring.fd)
    for number in range(200):
        ring.note(Note(float(number), "", "x", fault=False).encoded())
    found = [note.t for data in reader.notes() if (note := Note.decoded(data))]
    assert found == [float(number) for number in range(136, 200)]
    assert reader.notes() == []


@pytest.mark.slow
@given(st.text(max_size=3000), st.text(max_size=32), st.floats(allow_nan=False, allow_infinity=False), st.booleans())
def test_any_note_fits_the_ring_and_reads_as_one(text: str, axis: str, t: float, fault: bool) -> None:
    data = Note(t, axis, text, fault).encoded()
    assert len(data) <= NOTE_BYTES
    found = Note.decoded(data)
    assert found is not None
    assert (found.t, found.axis, found.fault) == (t, axis, fault)
    assert text.startswith(found.text)


@given(st.binary(max_size=200))
def test_garbage_is_no_note(data: bytes) -> None:
    assert Note.decoded(data) is None or data.strip().startswith(b"{")


def test_a_loop_that_is_killed_is_named_in_the_log_and_one_that_ends_in_order_is_not(
    ring: RingWriter, tmp_path: Path
) -> None:
    log = LogProcess(tmp_path / "ended.mcap", ring, HEADER)
    push(ring, 10)
    ring.note(FAULT.encoded())
    log.end()
    assert notes_of(LogFile(tmp_path / "ended.mcap")) == [FAULT]
    path = tmp_path / "x.mcap"
    kill_an_owner(path)

    def complete() -> bool:
        try:
            file = LogFile(path)
        except (OSError, UsageError):  # the file or its header is missing
            return False
        return notes_of(file) != [] and file.complete

    assert wait_for(complete)
    (note,) = notes_of(LogFile(path))
    assert (note.text, note.fault) == (DEAD, True)
    assert note.t == pytest.approx(0.699)
    assert len(LogFile(path).columns("knee", ["t"])["t"]) == 700
