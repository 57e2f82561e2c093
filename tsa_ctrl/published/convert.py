"""The publishers' files to the text of our CSV: one function per format. Pure; the same bytes give the same text."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType

from tsa_ctrl.errors import UsageError

# Counts of the encoders per turn, and N*m per count of the torque sensors, as the publisher's README gives them.
_DRIVER, _JAW, _TORQUE = 8192, 4000, 3.9811e-5
_RATED = 9.84e-3  # N*m: 100 % of the EPOS drive's torque, its motor's nominal torque


def _rows(text: str, first: int, separator: str, columns: tuple[int, ...], name: str) -> Iterator[tuple[float, ...]]:
    """Numbers of the rows from line `first` (0: the first); raises UsageError naming file and line."""
    for number, line in enumerate(text.splitlines()):
        if number < first or not line.strip():
            continue
        cells = line.split(separator)
        try:
            yield tuple(float(cells[column]) for column in columns)
        except (ValueError, IndexError):
            raise UsageError(
                f"{name}, line {number + 1}: not what was published ('{line[:40]}'); fetch it anew"
            ) from None


def cable_tool(data: bytes, name: str) -> str:
    """Ten columns, counts of both ends; driver's angle and jaw's torque turned: work put in is positive."""
    lines = ["t,q_m,tau_m,q_j,tau_j"]
    turn = 2.0 * math.pi
    text = data.decode("utf-8", "replace")
    first = next((number for number, line in enumerate(text.splitlines()) if not line.startswith("%")), 0)
    for t, driver, driver_torque, jaw, jaw_torque in _rows(text, first, ",", (0, 1, 2, 4, 5), name):
        values = (-driver * turn / _DRIVER, driver_torque * _TORQUE, jaw * turn / _JAW, -jaw_torque * _TORQUE)
        lines.append(f"{t:.3f}," + ",".join(f"{value:.6f}" for value in values))
    return "\n".join([*lines, ""])


def drive_recorder(data: bytes, name: str) -> str:
    """EPOS Studio's recorder: ms, rpm, % of the nominal torque; turned, so that its positive speed is ours."""
    text = data.decode("utf-8", "replace")
    first = next((number for number, line in enumerate(text.splitlines()) if line.startswith("ms;")), -1) + 1
    lines = ["t,tau_m,omega_m"]
    for t, speed, torque in _rows(text, first, ";", (0, 1, 2), name):
        values = (t / 1e3, -torque * _RATED / 100.0, -speed * math.pi / 30.0)
        lines.append(",".join(f"{value:.9g}" for value in values))
    return "\n".join([*lines, ""])


def linear_axis(data: bytes, name: str) -> str:
    """MATLAB's `t` (s), `qm` (m), `vir` (V) and `gtau` (N/V)."""
    from scipy.io import loadmat  # slow to import
    from scipy.io.matlab import MatReadError

    try:
        found = loadmat(io.BytesIO(data))  # type: ignore[arg-type]  # it reads files, too
        columns = [found[key].ravel() for key in ("t", "vir", "qm")]
        gain = float(found["gtau"].ravel()[0])
    except (MatReadError, ValueError, TypeError, KeyError, IndexError, NotImplementedError) as error:
        raise UsageError(f"{name}: not what was published ({error}); fetch it anew") from None
    rows = zip(columns[0], gain * columns[1], columns[2], strict=True)
    return "\n".join(["t,tau_m,q_m", *(",".join(f"{float(value):.9g}" for value in row) for row in rows), ""])


CONVERTERS: Mapping[str, Callable[[bytes, str], str]] = MappingProxyType(
    {"cable_tool": cable_tool, "drive_recorder": drive_recorder, "linear_axis": linear_axis}
)
