"""Download a published data set, convert it, and keep it only if its bytes equal the tested ones."""

from __future__ import annotations

import gzip
import hashlib
import http.client
import io
import math
import urllib.error
import urllib.request
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from tsa_ctrl import outputs
from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.published.catalogue import File, Published

# Encoder counts per turn, and N*m per count of the torque sensors, from the publisher's README
_DRIVER, _JAW, _TORQUE = 8192, 4000, 3.9811e-5
_RATED = 9.84e-3  # N*m: 100 % of the EPOS drive's torque, its motor's nominal torque


def _rows(text: str, first: int, separator: str, columns: tuple[int, ...], name: str) -> Iterator[tuple[float, ...]]:
    """Yield the numbers of each row from line `first` (counted from 0) on; raise UsageError with file and line."""
    for number, line in enumerate(text.splitlines()):
        if number < first or not line.strip():
            continue
        cells = line.split(separator)
        try:
            yield tuple(float(cells[column]) for column in columns)
        except (ValueError, IndexError):
            raise UsageError(
                f"{name}, line {number + 1}: not the published file ('{line[:40]}'); fetch it again"
            ) from None


def cable_tool(data: bytes, name: str) -> str:
    """Convert a table of encoder and torque counts to CSV; two signs are reversed so that work put in is positive."""
    lines = ["t,q_m,tau_m,q_j,tau_j"]
    turn = 2.0 * math.pi
    text = data.decode("utf-8", "replace")
    first = next((number for number, line in enumerate(text.splitlines()) if not line.startswith("%")), 0)
    for t, driver, driver_torque, jaw, jaw_torque in _rows(text, first, ",", (0, 1, 2, 4, 5), name):
        values = (-driver * turn / _DRIVER, driver_torque * _TORQUE, jaw * turn / _JAW, -jaw_torque * _TORQUE)
        lines.append(f"{t:.3f}," + ",".join(f"{value:.6f}" for value in values))
    return "\n".join([*lines, ""])


def drive_recorder(data: bytes, name: str) -> str:
    """Convert a record of EPOS Studio (ms, rpm, % of the nominal torque) to CSV with reversed signs."""
    text = data.decode("utf-8", "replace")
    first = next((number for number, line in enumerate(text.splitlines()) if line.startswith("ms;")), -1) + 1
    lines = ["t,tau_m,omega_m"]
    for t, speed, torque in _rows(text, first, ";", (0, 1, 2), name):
        values = (t / 1e3, -torque * _RATED / 100.0, -speed * math.pi / 30.0)
        lines.append(",".join(f"{value:.9g}" for value in values))
    return "\n".join([*lines, ""])


def linear_axis(data: bytes, name: str) -> str:
    """Convert a MATLAB file with `t` (s), `qm` (m), `vir` (V) and `gtau` (N/V) to CSV."""
    from scipy.io import loadmat  # slow to import
    from scipy.io.matlab import MatReadError

    wrong = (MatReadError, ValueError, TypeError, KeyError, IndexError, NotImplementedError, OSError, zlib.error)
    try:
        found = loadmat(io.BytesIO(data))  # type: ignore[arg-type]  # loadmat also reads file objects
        columns = [found[key].ravel() for key in ("t", "vir", "qm")]
        gain = float(found["gtau"].ravel()[0])
    except wrong as error:
        raise UsageError(f"{name}: not the published file ({error}); fetch it again") from None
    rows = zip(columns[0], gain * columns[1], columns[2], strict=True)
    return "\n".join(["t,tau_m,q_m", *(",".join(f"{float(value):.9g}" for value in row) for row in rows), ""])


CONVERTERS: Mapping[str, Callable[[bytes, str], str]] = MappingProxyType(
    {"cable_tool": cable_tool, "drive_recorder": drive_recorder, "linear_axis": linear_axis}
)


PATIENCE = 30.0  # s without a received byte until the download fails
LARGEST = 32 << 20  # bytes, largest permitted file; the largest published one has 2 MB


@dataclass(frozen=True)
class Fetched:
    """Hold the folder, the number of logs just written, and the number of logs that were already present."""

    folder: Path
    written: int
    kept: int


def fetch(
    wanted: Published,
    place: Path,
    address: str | None = None,
    progress: Callable[[int, int], None] = lambda n, of: None,
) -> Fetched:
    """Fill `place`/NAME with the logs, a model file, and a note on licence and source; correct files are kept.

    `address`: another address with the same files.

    Raises:
        BusError: the address cannot be reached.
        UsageError: a file differs from the published one, or cannot be written.
    """
    target = place / wanted.name
    files = wanted.files
    written = 0
    for number, file in enumerate(files):
        progress(number, len(files))
        path = target / file.name
        if path.is_file() and _digest(path) == file.sha256:
            continue
        _write(path, gzip.compress(_converted(wanted, file, address or wanted.address), mtime=0))
        written += 1
    progress(len(files), len(files))
    if not (target / wanted.model).exists():
        _write(target / wanted.model, wanted.model_text.encode())
    _write(target / "SOURCE.txt", _note(wanted).encode())
    return Fetched(target, written, len(files) - written)


def _converted(wanted: Published, file: File, address: str) -> bytes:
    source = f"{address}/{file.source}"
    text = CONVERTERS[wanted.converter](_download(source), source).encode()
    found = hashlib.sha256(text).hexdigest()
    if found != file.sha256:
        raise UsageError(
            f"{source}: is not the published file (SHA-256 of its CSV {found[:12]}..., "
            f"expected {file.sha256[:12]}...); nothing was kept"
        )
    return text


def _download(source: str) -> bytes:
    try:
        with urllib.request.urlopen(source, timeout=PATIENCE) as answer:
            data: bytes = answer.read(LARGEST + 1)
    except (OSError, ValueError, http.client.HTTPException) as error:
        reason = getattr(error, "reason", None) or error
        raise BusError(
            f"{source}: cannot be reached ({reason}); check the network, or give another address with --from"
        ) from None
    if len(data) > LARGEST:
        raise UsageError(f"{source}: is larger than {LARGEST >> 20} MiB and not the published file; nothing was kept")
    return data


def _digest(path: Path) -> str:
    try:
        return hashlib.sha256(gzip.decompress(path.read_bytes())).hexdigest()
    except (OSError, EOFError, zlib.error):
        return ""


def _note(wanted: Published) -> str:
    return (
        f"{wanted.what}\nSource: {wanted.address}\nLicence: {wanted.licence}\nCite: {wanted.cite}\n"
        f"Converted to SI by tsa data fetch {wanted.name}; {wanted.model} is a first guess of the actuator.\n"
    )


def _write(path: Path, data: bytes) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with outputs.beside(path, keeping=False) as fresh:
            fresh.write_bytes(data)
    except OSError as error:
        raise UsageError(f"{path}: cannot be written ({error.strerror}); choose another --out") from None
