"""Reading logs: complete, truncated, damaged, and by the library of the format."""

from __future__ import annotations

import contextlib
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import Writer

from tests.log.logs import HEADER, records, write_log
from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.mcap_file import McapFile
from tsa_ctrl.log.reader import LogFile
from tsa_ctrl.log.table import read_table
from tsa_ctrl.signals import FIELD_NAMES


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    write_log(path)
    return path


def test_the_head_comes_back(log: Path) -> None:
    file = LogFile(log)
    assert file.axes == ["hip", "knee"]
    assert file.fields == list(FIELD_NAMES)
    assert file.codes == HEADER.codes
    assert file.files == HEADER.files
    assert file.about["rate"] == 1000.0


def test_all_records_of_an_axis_come_back(log: Path) -> None:
    columns = LogFile(log).columns("knee", ["t", "tau_m", "tau_j"])
    assert columns["t"].tolist() == [i * 1e-3 for i in range(400)]
    assert set(columns["tau_m"].tolist()) == {1.0}
    assert np.isnan(columns["tau_j"]).all()


def content(path: Path) -> tuple[object, ...]:
    file = LogFile(path)
    columns = {axis: file.columns(axis, file.fields) for axis in file.axes}
    values = {axis: {name: value.tobytes() for name, value in each.items()} for axis, each in columns.items()}
    return file.fields, file.about, file.files, file.notes, values, file.problems


@given(place=st.floats(0.0, 1.0, exclude_max=True), bit=st.integers(0, 7))
@settings(max_examples=200, deadline=None)
def test_a_flipped_bit_is_reported_or_changes_nothing(
    log: Path, tmp_path_factory: pytest.TempPathFactory, place: float, bit: int
) -> None:
    """A flipped bit in header, chunks or end of a log causes an error, a reported problem, or no change."""
    data = bytearray(log.read_bytes())
    data[int(place * len(data))] ^= 1 << bit
    path = tmp_path_factory.mktemp("flipped") / "run.mcap"
    path.write_bytes(data)
    with contextlib.suppress(UsageError):
        found = content(path)
        assert found[-1] or found == content(log)


def test_a_chunk_that_no_longer_looks_like_one_is_counted(log: Path, tmp_path: Path) -> None:
    """A flipped bit of its first byte makes it an index, which is not read."""
    data = bytearray(log.read_bytes())
    position = 8  # after the magic bytes
    while data[position] != Opcode.CHUNK:
        position += 9 + int.from_bytes(data[position + 1 : position + 9], "little")
    data[position] ^= 1
    (tmp_path / "run.mcap").write_bytes(data)
    file = LogFile(tmp_path / "run.mcap")
    assert len(file.columns("hip", ["t"])["t"]) == 300
    assert (file.complete, file.damaged) == (True, 1)


@given(kept=st.floats(0.0, 0.999))
@settings(max_examples=60)
def test_a_log_cut_at_any_byte_reads_up_to_its_last_whole_chunk(
    log: Path, tmp_path_factory: pytest.TempPathFactory, kept: float
) -> None:
    data = log.read_bytes()
    cut = tmp_path_factory.mktemp("cut") / "cut.mcap"
    cut.write_bytes(data[: int(kept * len(data))])
    try:
        file = LogFile(cut)
        t = file.columns("hip", ["t"])["t"]
    except UsageError:
        return  # truncated within its header
    assert len(t) % 100 == 0
    np.testing.assert_array_equal(t, np.arange(len(t)) * 1e-3)
    assert not file.complete


def test_the_library_of_the_format_reads_every_message_and_finds_a_stretch_by_its_index(log: Path) -> None:
    with log.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == 800
        messages = [(channel.topic, message) for _, channel, message in reader.iter_messages()]
        begin, end = (1_700_000_000_000_000_000 + n * 1_000_000 for n in (150, 160))
        assert len(list(reader.iter_messages(topics="/hip", starting_at=begin, ending_before=end))) == 10
    assert len(messages) == 800
    topic, message = messages[0]
    assert topic in ("/hip", "/knee")
    assert message.data[:4] == b"\x00\x01\x00\x00"
    assert struct.unpack_from("<d", message.data, 4) == (0.0,)
    assert messages[-1][1].log_time == 1_700_000_000_399_000_000


def test_a_record_without_a_time_is_kept(tmp_path: Path) -> None:
    file = McapFile(tmp_path / "x.mcap", HEADER)
    file.write([records(3, t=np.nan), records(0)])
    file.finish()
    assert len(LogFile(tmp_path / "x.mcap").columns("hip", ["cycle"])["cycle"]) == 3


@pytest.mark.parametrize(
    ("axis", "said"),
    [(None, "has the axes hip, knee; select one"), ("elbow", "has no axis 'elbow'; its axes are hip, knee")],
)
def test_several_axes_want_a_name(log: Path, axis: str | None, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        read_table(f"{log}:{axis}" if axis else log)


def test_what_is_no_log_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    for content, said in ((b"", "is empty"), (b"t,tau_m\n", "is not an MCAP file")):
        path.write_bytes(content)
        with pytest.raises(UsageError, match=said):
            LogFile(path)
    writer = Writer(str(path), use_chunking=False)
    writer.start()
    schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
    writer.register_channel("/chatter", "cdr", schema)
    writer.finish()
    with pytest.raises(UsageError, match="holds 'std_msgs/msg/String' messages"):
        LogFile(path)
