"""Diagnoses all logs of a folder, goes on where an interruption stopped it, and writes one table of verdicts."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from dataclasses import dataclass
from pathlib import Path

from tsa_ctrl.errors import BusError, TsaError, UsageError
from tsa_ctrl.identify.dataset import load_logs
from tsa_ctrl.identify.diagnosis import diagnose
from tsa_ctrl.identify.diagnosis.report.page import write
from tsa_ctrl.identify.fleet.executors import Workers
from tsa_ctrl.identify.fleet.ledger import Row, append, known_rows, row_of, write_table
from tsa_ctrl.log.table import ENDINGS
from tsa_ctrl.model.parameters import load_model
from tsa_ctrl.version import __version__

AHEAD = 2  # jobs per worker that are handed out: enough that none waits, few enough to be kept in memory

Progress = Callable[[int, int, Row | None], None]


@dataclass(frozen=True)
class Job:
    """A log and the model to diagnose it with. `key` identifies all of it.

    `log`: where it lies, for a worker that sees the same disk; for any other its contents.
    """

    name: str
    key: str
    log: Path | bytes
    model_name: str
    model: bytes
    seed: int
    strict: bool = False


@dataclass(frozen=True)
class Done:
    """The line of the table, and the files of the report by name (none where the log could not be diagnosed)."""

    row: Row
    files: dict[str, bytes]


def carry_out(job: Job) -> Done:
    """Diagnose one log. Never raises: a fleet continues, and the row of this log has its error."""
    with tempfile.TemporaryDirectory(prefix="tsa-fleet-") as name:
        folder = Path(name)
        model = _laid(folder / "model" / job.model_name, job.model)
        log = job.log if isinstance(job.log, Path) else _laid(folder / "log" / job.name, job.log)
        try:
            result = diagnose(load_logs([log], job.strict), load_model(model), seed=job.seed)
            write(result, folder / "report", model)
        except TsaError as error:
            return Done(Row(job.name, job.key, "error", error=_plain(error, log, model)), {})
        except Exception as error:  # one log that no one thought of must not cost the other hundreds their answer
            return Done(
                Row(job.name, job.key, "error", error=f"{type(error).__name__}: {_plain(error, log, model)}"), {}
            )
        files = {path.name: path.read_bytes() for path in sorted((folder / "report").iterdir()) if path.is_file()}
        return Done(row_of(job.name, job.key, result), files)


def _laid(path: Path, content: bytes) -> Path:
    path.parent.mkdir()
    path.write_bytes(content)
    return path


def _plain(error: Exception, *files: Path) -> str:
    """The message in one line, without folders: they may be temporary ones."""
    text = " ".join(str(error).split())
    for path in files:
        text = text.replace(str(path), path.name)
    return text


def logs_in(folder: Path) -> list[Path]:
    """The logs that lie in a folder itself, by name. Raises UsageError if there is no log."""
    try:
        found = sorted(path for path in folder.iterdir() if path.is_file() and path.name.lower().endswith(ENDINGS))
    except OSError as error:
        raise UsageError(f"{folder}: cannot be read ({error.strerror}); give a folder of logs") from None
    found = [path for path in found if not path.name.startswith(".")]
    if not found:
        raise UsageError(f"{folder}: holds no log ({', '.join(ENDINGS)}); give the folder in which the logs lie")
    return found


def sweep(
    logs: Sequence[Path],
    model: Path,
    out: Path,
    workers: Workers,
    *,
    seed: int = 0,
    strict: bool = False,
    progress: Progress = lambda done, total, row: None,
) -> list[Row]:
    """Diagnose each log separately with `model`; returns the rows of the table by name.

    Each report goes to out/NAME, each answer to out/fleet.jsonl at once, the table to out/verdicts.csv at the end or at
    an interruption. Answers in fleet.jsonl for the same log, model, seed and version are reused.
    progress(done, total, row) is called at the start (row None) and after each answer. Raises UsageError when a file
    cannot be read or written, BusError when a worker dies.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        model_text = model.read_bytes()
    except OSError as error:
        raise UsageError(f"{error.filename}: {error.strerror}; choose another") from None
    known = known_rows(out)
    waiting = {path: _key(path, model_text, seed, strict) for path in logs}
    rows = {path: known[key] for path, key in waiting.items() if key in known and _reported(out, known[key])}
    queue = [path for path in logs if path not in rows]
    progress(len(rows), len(logs), None)
    running: dict[Future[Done], Path] = {}
    try:
        while queue or running:
            while queue and len(running) < AHEAD * workers.count:
                path = queue.pop(0)
                log = path.absolute() if workers.same_disk else _contents(path)
                job = Job(path.name, waiting[path], log, model.name, model_text, seed, strict)
                running[workers.executor.submit(carry_out, job)] = path
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                path, done = running.pop(future), future.result()
                rows[path] = done.row
                _file(out / path.name, done)
                append(out, done.row)
                progress(len(rows), len(logs), done.row)
    except BrokenExecutor:
        raise BusError(
            f"a worker died while it diagnosed; {len(rows)} of {len(logs)} logs are done: try again with fewer --jobs"
        ) from None
    finally:
        write_table(out, rows.values())
    return [rows[path] for path in logs]


def _key(path: Path, model: bytes, seed: int, strict: bool) -> str:
    """The same for the same name and contents of the log, model, seed and version."""
    digest = hashlib.sha256(f"{__version__} {seed} {'strict ' if strict else ''}{path.name} ".encode())
    digest.update(hashlib.sha256(model).digest())
    try:
        with path.open("rb") as file:
            digest.update(hashlib.file_digest(file, "sha256").digest())
    except OSError as error:
        raise _unreadable(path, error) from None
    return digest.hexdigest()


def _contents(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise _unreadable(path, error) from None


def _unreadable(path: Path, error: OSError) -> UsageError:
    return UsageError(f"{path}: cannot be read ({error.strerror}); allow reading it or take it away")


def _reported(out: Path, row: Row) -> bool:
    """Return True if the report of an answer still exists."""
    return row.verdict == "error" or (out / row.log / "diagnosis.json").is_file()


def _file(folder: Path, done: Done) -> None:
    """Write a report's files; diagnosis.json last: it marks the others as complete."""
    try:
        for name in sorted(done.files, key=lambda name: name == "diagnosis.json"):
            folder.mkdir(exist_ok=True)
            (folder / name).write_bytes(done.files[name])
    except OSError as error:
        raise UsageError(f"{folder}: cannot be written ({error.strerror}); choose another --out") from None
