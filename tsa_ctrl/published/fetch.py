"""Gets a published set from its home, converts it, and keeps what is, byte for byte, what it was tried with."""

from __future__ import annotations

import gzip
import hashlib
import urllib.error
import urllib.request
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tsa_ctrl import outputs
from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.published.catalogue import File, Published
from tsa_ctrl.published.convert import CONVERTERS

PATIENCE = 30.0  # s without a byte
LARGEST = 32 << 20  # bytes of a file; the largest of the sets has 2 MB


@dataclass(frozen=True)
class Fetched:
    """What was done: logs written now, logs that were there already, and where they lie."""

    folder: Path
    written: int
    kept: int


def fetch(
    wanted: Published,
    place: Path,
    address: str | None = None,
    progress: Callable[[int, int], None] = lambda n, of: None,
) -> Fetched:
    """Fill `place`/NAME with the logs, a model file and a note on licence and source; what is there and right is kept.

    `address`: another home with the same files. Raises BusError where it is not reached, UsageError where what comes is
    not what was published or cannot be written.
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
            f"{source}: is not what was published (SHA-256 of its CSV {found[:12]}..., "
            f"expected {file.sha256[:12]}...); nothing of it was kept"
        )
    return text


def _download(source: str) -> bytes:
    try:
        with urllib.request.urlopen(source, timeout=PATIENCE) as answer:
            data: bytes = answer.read(LARGEST + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "reason", None) or error
        raise BusError(
            f"{source}: not reached ({reason}); try again with a network, or give another address by --from"
        ) from None
    if len(data) > LARGEST:
        raise UsageError(f"{source}: is larger than {LARGEST >> 20} MiB and not what was published; nothing was kept")
    return data


def _digest(path: Path) -> str:
    try:
        return hashlib.sha256(gzip.decompress(path.read_bytes())).hexdigest()
    except (OSError, EOFError, gzip.BadGzipFile):
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
