"""Write the last part of a log as a complete log."""

from __future__ import annotations

import calendar
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.mcap_file import McapFile
from tsa_ctrl.log.process import LogHeader
from tsa_ctrl.log.reader import LogFile
from tsa_ctrl.signals import FIELD_NAMES


def write_last(log: Path, out: Path, seconds: float) -> float:
    """Write the head, the records of the last `seconds` and all events of a log to a new file.

    Returns:
        The duration of the written part, s.

    Raises:
        UsageError: the log cannot be read, has other columns than this version, or `out` cannot be written.
    """
    file = LogFile(log)
    if tuple(file.fields) != tuple(FIELD_NAMES):
        raise UsageError(f"{log}: is of version {file.about.get('version')} with other columns; use that version")
    end = max((float(block[-1, 0]) for _, block in file.blocks(("t",)) if len(block)), default=0.0)
    started = calendar.timegm(time.strptime(file.about["started"], "%Y-%m-%dT%H:%M:%SZ"))
    header = LogHeader(
        tuple(file.axes), file.about["rate"], file.files, file.codes, float(started), file.about["version"]
    )
    first = end
    try:
        target = McapFile(out, header)
        for axis, block in file.blocks(file.fields):
            kept = block[block[:, 0] >= end - seconds]
            if len(kept):
                first = min(first, float(kept[0, 0]))
                target.write([kept if name == axis else _nothing() for name in file.axes])
        target.write_notes(file.notes)
        target.finish()
    except OSError as error:
        raise UsageError(f"{out}: cannot be written ({error.strerror}); choose another place") from None
    return end - first


def _nothing() -> NDArray[np.float64]:
    return np.empty((0, len(FIELD_NAMES)))
