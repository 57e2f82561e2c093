"""Store the results of a fleet in a file of one line per log, which survives interruptions, and write the table."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
import os
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import msgspec

from tsa_ctrl import settings
from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.diagnosis import Diagnosis
from tsa_ctrl.outputs import json_types

LEDGER, TABLE = "fleet.jsonl", "verdicts.csv"


@dataclass(frozen=True)
class Named:
    """Hold an identified cause and the effects that this log cannot distinguish from it."""

    effect: str
    alternatives: tuple[str, ...]


@dataclass(frozen=True)
class Row:
    """The result of one log.

    Attributes:
        key: identifies log, model, seed and version; a result is reused only for the same key.
        verdict: as in diagnosis.json, or "error" with the reason in `error`.
        rms: N*m, as in diagnosis.json.
    """

    log: str
    key: str
    verdict: str
    causes: tuple[Named, ...] = ()
    rms: Mapping[str, float | None] = dataclasses.field(default_factory=dict)
    gain: float = 0.0
    unexplained: str = ""
    sentence: str = ""
    error: str = ""

    @property
    def told(self) -> str:
        """Return the names of the causes in one line, each with its indistinguishable effects."""
        return "; ".join(
            each.effect + (f" (or {', '.join(each.alternatives)})" if each.alternatives else "") for each in self.causes
        )


def row_of(name: str, key: str, result: Diagnosis) -> Row:
    """Return the result of a diagnosis for the ledger and the table."""
    data = result.to_dict()
    return Row(
        log=name,
        key=key,
        verdict=data["verdict"],
        causes=tuple(Named(cause.effect, cause.alternatives) for cause in result.causes),
        rms={step: data["rms"][step] for step in ("as_given", "recalibrated", "extended", "noise_floor")},
        gain=data["gain"],
        unexplained=data["unexplained"]["description"],
        sentence=data["summary"],
    )


def known_rows(folder: Path) -> dict[str, Row]:
    """Return the last result of each log by its name; a line that an interruption cut short is ignored."""
    path = folder / LEDGER
    if not path.exists():
        return {}
    rows = {}
    for line in path.read_bytes().splitlines():
        try:
            row = msgspec.json.decode(line, type=Row)
        except (msgspec.DecodeError, UnicodeDecodeError):
            continue
        rows[row.log] = row
    return rows


def append(folder: Path, row: Row) -> None:
    """Append one result to the ledger and sync it to the disk; raises UsageError if the file cannot be written."""
    path = folder / LEDGER
    try:
        with path.open("a", encoding="utf-8") as file:
            if file.tell() and not _ends_with_a_line(path):
                file.write("\n")  # the last run was interrupted within a line
            file.write(json.dumps(json_types(row), ensure_ascii=False) + "\n")
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise UsageError(f"{path}: cannot be written ({error.strerror}); choose another --out") from None


def _ends_with_a_line(path: Path) -> bool:
    with path.open("rb") as file:
        file.seek(-1, os.SEEK_END)
        return file.read(1) == b"\n"


def write_table(folder: Path, rows: Iterable[Row]) -> Path:
    """Write verdicts.csv with one line per log and return its path; raises UsageError if it cannot be written."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    steps = ("as_given", "recalibrated", "extended", "noise_floor")
    table.writerow(["log", "verdict", "causes", *(f"rms_{step}" for step in steps), "gain", "unexplained", "error"])
    for row in sorted(rows, key=lambda row: row.log):
        errors = [row.rms.get(step) for step in steps]
        values = ["" if value is None else f"{value:.6g}" for value in errors]
        table.writerow([row.log, row.verdict, row.told, *values, f"{row.gain:.4g}", row.unexplained, row.error])
    settings.write_text(folder / TABLE, text.getvalue())
    return folder / TABLE


def counted(rows: Iterable[Row]) -> tuple[Counter[str], Counter[str]]:
    """Return the number of logs by verdict, and by identified cause."""
    rows = list(rows)
    return Counter(row.verdict for row in rows), Counter(each.effect for row in rows for each in row.causes)
