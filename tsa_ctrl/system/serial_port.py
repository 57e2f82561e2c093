"""Check the port of a serial line: a device, or a URL of pyserial."""

from __future__ import annotations

import contextlib
from typing import Annotated

from msgspec import Meta

from tsa_ctrl.errors import UsageError

Port = Annotated[str, Meta(pattern=r"^[^\0]+$")]


def check_port(port: str, where: str) -> None:
    """Raise UsageError for a URL that pyserial cannot open on any machine. A missing device is no error."""
    if "://" not in port:
        return
    import serial  # slow to import

    try:
        with contextlib.suppress(OSError):  # hwgrep:// finds no device
            serial.serial_for_url(port, do_not_open=True)
    except ValueError as error:
        raise UsageError(
            f'{where}: port "{port}": {error}; give a device such as /dev/ttyUSB0, or a URL of pyserial such as '
            "socket://HOST:PORT"
        ) from None
