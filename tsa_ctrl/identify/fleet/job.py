"""One log of a fleet, from the bytes of the file to the bytes of its report: needs no disk that others share."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

from tsa_ctrl.errors import TsaError
from tsa_ctrl.identify.dataset import load_logs
from tsa_ctrl.identify.diagnosis import diagnose
from tsa_ctrl.identify.diagnosis.report.page import write
from tsa_ctrl.identify.fleet.ledger import Row, row_of
from tsa_ctrl.model.parameters import load_model


@dataclass(frozen=True)
class Job:
    """A log and the model to diagnose it with. `key` stands for all of it.

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
    """Diagnose one log. Never raises: a fleet goes on, and what was wrong with this log stands in its row."""
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
    """The message in one line, without folders: they may be ones that nobody knows."""
    text = " ".join(str(error).split())
    for path in files:
        text = text.replace(str(path), path.name)
    return text
