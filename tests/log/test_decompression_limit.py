"""Files that unpack to more than the limit give a one-line error. Normal logs and tables are read."""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path

import pytest
import zstandard

from tests.log.logs import write_log
from tsa_ctrl.errors import UsageError
from tsa_ctrl.log import reader
from tsa_ctrl.log.reader import DecompressionLimit, LogFile, _unpacked
from tsa_ctrl.log.table import read_table


@pytest.fixture
def strict(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lower the limits so that a small file exceeds them."""
    monkeypatch.setattr(reader, "ALWAYS", 10_000)
    monkeypatch.setattr(reader, "RATIO", 5)


@pytest.mark.usefixtures("strict")
def test_a_log_whose_chunks_unpack_to_more_than_a_log_has_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_log(tmp_path / "run.mcap")
    with pytest.raises(UsageError, match=r"run\.mcap: unpacks to more than .* which no log does"):
        LogFile(tmp_path / "run.mcap").columns("knee", ["t"])
    monkeypatch.setattr(reader, "ALWAYS", 100_000_000)
    assert len(LogFile(tmp_path / "run.mcap").columns("knee", ["t"])["t"]) == 400


@pytest.mark.usefixtures("strict")
def test_a_compressed_table_is_bounded_too(tmp_path: Path) -> None:
    (tmp_path / "small.csv.gz").write_bytes(gzip.compress(b"t,tau_m\n" + b"0,1\n" * 1_000))
    assert len(read_table(tmp_path / "small.csv.gz")) == 1_000
    (tmp_path / "bomb.csv.gz").write_bytes(gzip.compress(b"t,tau_m\n" + b"0,1\n" * 1_000_000))
    with pytest.raises(UsageError, match=r"bomb\.csv\.gz: unpacks to more than"):
        read_table(tmp_path / "bomb.csv.gz")


def test_a_frame_that_is_larger_than_its_chunk_declares_is_not_unpacked(tmp_path: Path) -> None:
    """A frame is not read if it exceeds the size that its chunk declares.

    The declared size counts towards the limit.
    """
    (tmp_path / "x").write_bytes(b"x" * 100)

    def chunk(size: int, data: bytes) -> bytes:
        packed = zstandard.compress(data)
        head = (0).to_bytes(16, "little") + size.to_bytes(8, "little") + zlib.crc32(data).to_bytes(4, "little")
        return head + (4).to_bytes(4, "little") + b"zstd" + len(packed).to_bytes(8, "little") + packed

    assert _unpacked(chunk(1000, bytes(1000)), DecompressionLimit(tmp_path / "x")) == bytes(1000)
    assert _unpacked(chunk(10, bytes(1000)), DecompressionLimit(tmp_path / "x")) is None
    full = DecompressionLimit(tmp_path / "x")
    full.left = 999
    with pytest.raises(UsageError, match="unpacks to more than"):
        _unpacked(chunk(1000, bytes(1000)), full)
