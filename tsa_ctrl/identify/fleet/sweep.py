"""Diagnose all logs of a folder, continue after an interruption, and write one table of verdicts."""

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
from tsa_ctrl.identify.diagnosis.report.page import JSON, set_aside, write
from tsa_ctrl.identify.fleet.executors import Workers
from tsa_ctrl.identify.fleet.ledger import Row, append, known_rows, row_of, write_table
from tsa_ctrl.log.table import ENDINGS
from tsa_ctrl.model.parameters import load_model
from tsa_ctrl.version import __version__

AHEAD = 2  # submitted jobs per worker: enough that no worker is idle, few enough for the memory

Progress = Callable[[int, int, Row | None], None]


@dataclass(frozen=True)
class Job:
    """A log and the model for its diagnosis; `key` identifies both, the seed and the version.

    `log`: the path for a worker on the same disk, the contents of the file for other workers.
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
    """The result of one log, and the files of its report by name; no files if the diagnosis failed."""

    row: Row
    files: dict[str, bytes]


def carry_out(job: Job) -> Done:
    """Diagnose one log; if the diagnosis fails, the row contains the error, so that the other logs continue."""
    with tempfile.TemporaryDirectory(prefix="tsa-fleet-") as name:
        folder = Path(name)
        model = _laid(folder / "model" / job.model_name, job.model)
        log = job.log if isinstance(job.log, Path) else _laid(folder / "log" / job.name, job.log)
        try:
            result = diagnose(load_logs([log], job.strict), load_model(model), seed=job.seed)
            write(result, folder / "report", model)
        except Exception as error:  # an error on one log, even an unexpected one, must not end the whole run
            kind = "" if isinstance(error, TsaError) else f"{type(error).__name__}: "
            return Done(Row(job.name, job.key, "error", error=f"{kind}{_plain(error, log, model)}"), {})
        files = {path.name: path.read_bytes() for path in sorted((folder / "report").iterdir()) if path.is_file()}
        return Done(row_of(job.name, job.key, result), files)


def _laid(path: Path, content: bytes) -> Path:
    path.parent.mkdir()
    path.write_bytes(content)
    return path


def _plain(error: Exception, *files: Path) -> str:
    """Return the message in one line, without the folders of the files, because they may be temporary."""
    text = " ".join(str(error).split())
    for path in files:
        text = text.replace(str(path), path.name)
    return text


def logs_in(folder: Path) -> list[Path]:
    """Return the logs directly in a folder, sorted by name; raises UsageError if the folder contains none."""
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
    say: Callable[[str], None] = lambda line: None,
) -> list[Row]:
    """Diagnose each log separately with `model`; return the results in the order of `logs`.

    Each report is written to out/NAME, and each result to out/fleet.jsonl as soon as it is available. The table is
    written to out/verdicts.csv at the end or at an interruption. Results in fleet.jsonl for the same log, model, seed
    and version are reused. progress(done, total, row) is called at the start (row None) and after each result. `say`
    is called with a line if the run renames earlier reports.

    Raises:
        UsageError: a file cannot be read or written.
        BusError: a worker process died.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        model_text = model.read_bytes()
        known = known_rows(out)
    except OSError as error:
        raise UsageError(f"{error.filename}: {error.strerror}; choose another") from None
    waiting = {path: _key(path, model_text, seed, strict) for path in logs}
    rows = {
        path: row
        for path, key in waiting.items()
        if (row := known.get(path.name)) is not None and row.key == key and _reported(out, row)
    }
    queue = [path for path in logs if path not in rows]
    earlier = sum((out / path.name / JSON).is_file() for path in queue)
    if earlier:
        say(
            f"{out}: {earlier} of {len(logs)} logs have a report of another model, seed, version or content; its data "
            "files are kept next to the new ones as NAME.~N~: remove them, or choose another --out"
        )
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
    """Return a hash of the version, the seed, `strict`, the log's name, and the contents of log and model."""
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
    """Return True if the report of a result still exists; the result of a failed diagnosis needs none."""
    return row.verdict == "error" or (out / row.log / JSON).is_file()


def _file(folder: Path, done: Done) -> None:
    """Write the files of a report, with diagnosis.json last, because it marks the report as complete.

    Files of an earlier report of the same log are treated as in `set_aside`.
    """
    try:
        if folder.is_dir():
            set_aside(folder, ())
        for name in sorted(done.files, key=lambda name: name == JSON):
            folder.mkdir(exist_ok=True)
            (folder / name).write_bytes(done.files[name])
    except OSError as error:
        raise UsageError(f"{folder}: cannot be written ({error.strerror}); choose another --out") from None
