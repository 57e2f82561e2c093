"""The log writer: contents of the file, and failures of the writer, its disk and its owner."""

from __future__ import annotations

import datetime
import errno
import os
import signal
import time
from pathlib import Path
from typing import Any

import pytest

from tests.log.logs import HEADER, notes_of, push, wait_for
from tsa_ctrl.errors import UsageError
from tsa_ctrl.log import writer as writer_module
from tsa_ctrl.log.process import LogLimits, LogProcess
from tsa_ctrl.log.reader import LogFile
from tsa_ctrl.log.ring import LogHealth, RingReader, RingWriter, WriterState
from tsa_ctrl.log.writer import LogWriter
from tsa_ctrl.outputs import untaken


def times(path: Path, axis: str = "hip") -> list[int]:
    return [round(1e3 * t) for t in LogFile(path).columns(axis, ["t"])["t"].tolist()]


class FullDisk:
    """A file that accepts `space` more bytes and then raises ENOSPC."""

    def __init__(self, file: Any, space: int) -> None:
        self._file = file
        self.space = space

    def write(self, data: Any) -> int:
        if self.space <= 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        done: int = self._file.write(bytes(data[: self.space]))
        self.space -= done
        return done

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


def test_chunks_come_at_least_twice_a_second(ring: RingWriter, tmp_path: Path) -> None:
    writer = LogWriter(RingReader(ring.fd), tmp_path / "x.mcap", HEADER)
    for step in range(40):
        push(ring, 50, 50 * step)
        writer.step(0.05 * step)
        assert 50 * (step + 1) - len(times(tmp_path / "x.mcap")) <= 500


def test_a_folder_that_is_gone_is_said_and_costs_nothing_once_it_is_back(ring: RingWriter, tmp_path: Path) -> None:
    path = tmp_path / "gone" / "x.mcap"
    writer = LogWriter(RingReader(ring.fd), path, HEADER)
    push(ring, 10)
    writer.step(0.0)
    health = LogHealth(ring)
    assert (health.state, health.trouble) == (WriterState.TROUBLED, os.strerror(errno.ENOENT))
    path.parent.mkdir()
    push(ring, 10, 10)
    writer.step(2.0)
    assert LogHealth(ring).state is WriterState.WRITING
    assert times(path) == list(range(20))


def test_a_full_disk_leaves_a_readable_file_and_is_tried_again(ring: RingWriter, tmp_path: Path) -> None:
    writer = LogWriter(RingReader(ring.fd), tmp_path / "x.mcap", HEADER)
    push(ring, 10)
    writer.step(0.0)
    file = writer._file
    assert file is not None
    disk = file._file = FullDisk(file._file, space=100)  # type: ignore[assignment]
    push(ring, 10, 10)
    writer.step(1.0)
    assert LogHealth(ring).trouble == os.strerror(errno.ENOSPC)
    assert times(tmp_path / "x.mcap") == list(range(10))
    disk.space = 1 << 20
    writer.step(3.0)
    writer.end()
    assert times(tmp_path / "x.mcap") == list(range(20))
    assert (LogHealth(ring).lost, LogHealth(ring).written) == (0, 40)


def test_the_disk_stores_the_log_once_a_second_and_its_error_is_said(
    ring: RingWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A failed fsync is reported. No record is lost or written twice."""
    calls: list[int] = []

    def fails_once(descriptor: int) -> None:
        calls.append(descriptor)
        if len(calls) == 1:
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(os, "fsync", fails_once)
    writer = LogWriter(RingReader(ring.fd), tmp_path / "x.mcap", HEADER)
    troubles = []
    for step in range(100):  # 5 s
        push(ring, 50, 50 * step)
        before = len(calls)
        writer.step(0.05 * step)
        assert wait_for(lambda at=before, due=step % 20 == 0: len(calls) > at or not due)  # type: ignore[misc]
        troubles.append(LogHealth(ring).trouble)
    assert len(calls) == 5
    assert set(troubles) == {"", os.strerror(errno.EIO)}
    assert troubles[-1] == ""
    writer.end()
    assert len(calls) == 6
    assert times(tmp_path / "x.mcap") == list(range(5000))


def test_a_sync_that_starts_late_does_not_find_a_closed_file(ring: RingWriter, tmp_path: Path) -> None:
    writer = LogWriter(RingReader(ring.fd), tmp_path / "x.mcap", HEADER)
    writer._disk.submit(time.sleep, 0.1)  # a busy disk
    push(ring, 10)
    writer.step(0.0)
    writer.end()
    assert times(tmp_path / "x.mcap") == list(range(10))
    assert LogHealth(ring).trouble == ""


def test_what_a_long_trouble_costs_is_counted(
    ring: RingWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writer_module, "MOST_PENDING", 100)
    writer = LogWriter(RingReader(ring.fd), tmp_path / "gone" / "x.mcap", HEADER)
    for step in range(20):
        push(ring, 10, 10 * step)
        writer.step(0.05 * step)
    assert LogHealth(ring).lost == 300
    writer.end()
    assert LogHealth(ring).lost == 400
    assert LogHealth(ring).state is WriterState.ENDED


def test_a_ring_that_ran_over_is_counted(ring: RingWriter, tmp_path: Path) -> None:
    writer = LogWriter(RingReader(ring.fd), tmp_path / "x.mcap", HEADER)
    push(ring, 2000)
    writer.end()
    health = LogHealth(ring)
    assert health.written + health.lost == 4000
    assert health.lost >= 2 * (2000 - 1024)


def test_a_writer_that_ended_or_hangs_is_not_waited_for_and_is_killed(ring: RingWriter, tmp_path: Path) -> None:
    ended = LogProcess(tmp_path / "x.mcap", ring, HEADER)
    os.kill(ended.pid, signal.SIGSTOP)
    ended.wait_until_up(timeout=0.05)
    os.kill(ended.pid, signal.SIGKILL)
    ended.wait_until_up()
    assert ended.health().state is WriterState.STARTING
    ended.end()
    hangs = LogProcess(tmp_path / "y.mcap", ring, HEADER)
    hangs.wait_until_up()
    os.kill(hangs.pid, signal.SIGSTOP)
    hangs.end(timeout=0.2)
    assert hangs.alive is False


def test_a_writer_killed_in_the_middle_leaves_a_readable_log(ring: RingWriter, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    log = LogProcess(path, ring, HEADER)
    push(ring, 300)
    assert wait_for(lambda: log.health().written >= 600)
    push(ring, 300, 300)
    os.kill(log.pid, signal.SIGKILL)
    assert wait_for(lambda: not log.alive)
    push(ring, 300, 600)  # the loop continues
    health = log.end()
    assert health.state is not WriterState.ENDED
    assert times(path)[:300] == list(range(300))
    assert len(times(path)) in (300, 600)
    file = LogFile(path)
    file.columns("hip", ["t"])
    assert file.complete is False


def test_the_process_completes_the_file_and_leaves_the_end_to_its_owner(ring: RingWriter, tmp_path: Path) -> None:
    """The process is waited for until it reads the ring. An interrupt or a termination signal does not end it."""
    log = LogProcess(tmp_path / "x.mcap", ring, HEADER)
    assert log.health().state is WriterState.STARTING
    log.wait_until_up()
    assert log.health().state is WriterState.WRITING
    os.kill(log.pid, signal.SIGINT)
    os.kill(log.pid, signal.SIGTERM)
    push(ring, 500)
    health = log.end()
    assert (health.state, health.written, health.lost) == (WriterState.ENDED, 1000, 0)
    assert times(tmp_path / "x.mcap", "knee") == list(range(500))


@pytest.mark.slow
def test_a_writer_in_anothers_place_goes_on_where_that_one_was(ring: RingWriter, tmp_path: Path) -> None:
    """The worker is killed while the ring contains unwritten records.

    Its successor writes them to the next file. No record is lost.
    """
    log = LogProcess(tmp_path / "x.mcap", ring, HEADER)
    push(ring, 300)
    assert wait_for(lambda: log.health().written >= 600)
    (worker,) = Path(f"/proc/{log.pid}/task/{log.pid}/children").read_text("ascii").split()
    os.kill(int(worker), signal.SIGSTOP)
    push(ring, 300, 300)
    os.kill(int(worker), signal.SIGKILL)
    assert wait_for(lambda: ring.replaced == 1)
    push(ring, 100, 600)
    health = log.end()
    assert (health.state, health.written, health.lost) == (WriterState.ENDED, 1400, 0)
    assert times(tmp_path / "x.mcap") + times(tmp_path / "x-2.mcap") == list(range(700))


def test_a_place_where_no_log_can_be_created_is_one_line(ring: RingWriter, tmp_path: Path) -> None:
    """An existing log is never overwritten."""
    file = tmp_path / "file"
    file.write_bytes(b"precious")
    places = {
        file: "exists already",
        tmp_path / "no/such/folder/x.mcap": "the log cannot be created",
        file / "x.mcap": "the log cannot be created",
    }
    for place, words in places.items():
        with pytest.raises(UsageError, match=words):
            LogProcess(place, ring, HEADER)
    assert file.read_bytes() == b"precious"


def test_dated_names_are_not_taken(tmp_path: Path) -> None:
    now = datetime.datetime(2025, 1, 31, 14, 25, 1)
    for name in ("tsa-20250131-142501.mcap", "tsa-20250131-142501-2.mcap", "tsa-20250131-142501-3.mcap"):
        path = untaken(tmp_path, "tsa", ".mcap", now)
        assert path.name == name
        path.touch()


def test_a_log_goes_on_in_the_next_file_once_it_is_large_or_old(ring: RingWriter, tmp_path: Path) -> None:
    """Each file is complete and contains the configuration. No record is lost or written twice."""
    limits = LogLimits(file_age=60.0)
    log = LogWriter(RingReader(ring.fd), tmp_path / "log.mcap", HEADER, limits)
    for step in range(4):  # the age of a file counts from its first record: at 0 s and at 140 s
        push(ring, 100, first=100 * step)
        log.step(70.0 * step)
    push(ring, 100, first=400)
    log.end()
    files = [tmp_path / name for name in ("log.mcap", "log-2.mcap", "log-3.mcap")]
    assert sorted(tmp_path.iterdir()) == sorted(files)
    assert [count for file in files for count in times(file)] == list(range(500))
    for file in files:
        found = LogFile(file)
        notes = [note.text for note in notes_of(found)]
        assert found.complete
        assert found.files == HEADER.files
        assert (file == files[0]) == (not any("this log continues" in text for text in notes))
        assert (file == files[-1]) == (not any("continues in" in text for text in notes))
    large = LogWriter(RingReader(ring.fd), tmp_path / "large.mcap", HEADER, LogLimits(file_size=1.0))
    push(ring, 100, first=500)
    large.step(0.0)
    push(ring, 100, first=600)
    large.end()
    assert not any("continues in" in note.text for note in notes_of(LogFile(tmp_path / "large-2.mcap")))
    assert times(tmp_path / "large.mcap") + times(tmp_path / "large-2.mcap") == list(range(500, 700))


def test_the_oldest_logs_are_deleted_beyond_the_size_of_the_folder(ring: RingWriter, tmp_path: Path) -> None:
    """Other files, a link and a recently changed log are kept. The new log lists the deleted ones."""
    (tmp_path / "far").mkdir()
    (tmp_path / "far/tsa-0.mcap").write_bytes(b"x" * 100_000)
    os.utime(tmp_path / "far/tsa-0.mcap", (time.time() - 70,) * 2)
    (tmp_path / "tsa-0.mcap").symlink_to(tmp_path / "far/tsa-0.mcap")
    for age, name in ((50, "tsa-1.mcap"), (40, "tsa-2.mcap"), (30, "tsa-3.mcap"), (0, "tsa-4.mcap"), (60, "my.mcap")):
        (tmp_path / name).write_bytes(b"x" * 1000)
        os.utime(tmp_path / name, (time.time() - age,) * 2)
    log = LogWriter(RingReader(ring.fd), tmp_path / "tsa-5.mcap", HEADER, LogLimits(folder_size=6500.0))
    log.step(0.0)
    assert 3500 < (tmp_path / "tsa-5.mcap").stat().st_size < 4500  # its header, which leaves room for two logs
    log.end()
    kept = {"tsa-3.mcap", "tsa-4.mcap", "tsa-5.mcap", "my.mcap", "tsa-0.mcap", "far"}
    assert {path.name for path in tmp_path.iterdir()} == kept
    notes = [note.text for note in notes_of(LogFile(tmp_path / "tsa-5.mcap"))]
    assert [text.split(":")[0] for text in notes] == [f"deleted the oldest log tsa-{i}.mcap" for i in (1, 2)]


def test_an_old_log_that_vanishes_or_cannot_be_deleted_does_not_stop_the_writer(
    ring: RingWriter, tmp_path: Path
) -> None:
    """A link that leads to itself is listed but has no status, as a log that another daemon deletes at that moment."""
    (tmp_path / "tsa-1.mcap").symlink_to(tmp_path / "tsa-1.mcap")
    (tmp_path / "tsa-2.mcap").mkdir()
    os.utime(tmp_path / "tsa-2.mcap", (time.time() - 50,) * 2)
    log = LogWriter(RingReader(ring.fd), tmp_path / "tsa-3.mcap", HEADER, LogLimits(folder_size=1.0))
    push(ring, 100)
    log.step(0.0)
    assert LogHealth(ring).state is WriterState.WRITING
    log.end()
    assert times(tmp_path / "tsa-3.mcap") == list(range(100))
    (note,) = [note.text for note in notes_of(LogFile(tmp_path / "tsa-3.mcap"))]
    assert note.startswith("the oldest log tsa-2.mcap cannot be deleted (Is a directory)")
