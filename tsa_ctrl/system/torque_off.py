"""Switch an output of this computer for safe torque off: a command, a GPIO line, or a modem line of a serial port."""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import shutil
import subprocess
from collections.abc import Callable
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from tsa_ctrl.errors import UsageError
from tsa_ctrl.system.serial_port import Port, check_port

_PERMIT, _OFF = b"1", b"0"  # bytes on the serial line, in addition to the modem line
_BAUD_RATE = 9600  # bit/s


class OutputSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[monitor] output: exactly one of `command`, `gpio` and `serial`."""

    command: tuple[str, ...] = ()  # program and arguments, started again until it ends with 0
    gpio: Annotated[str, Meta(pattern=r"^\w+:\d+$")] | None = None  # chip:line, active while torque is permitted
    serial: Port | None = None  # with its modem line on while torque is permitted
    line: Literal["dtr", "rts"] = "dtr"  # modem line of that port

    def __post_init__(self) -> None:
        if [bool(self.command), self.gpio is not None, self.serial is not None].count(True) != 1:
            raise ValueError("output names none or several of command, gpio and serial; give exactly one")

    @property
    def named(self) -> str:
        """Return the name of the output."""
        if self.command:
            return f"command {self.command[0]}"
        return f"gpio {self.gpio}" if self.gpio is not None else f"serial {self.serial} {self.line}"


class MonitorSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[monitor]: switch and output of the second channel."""

    enabled: bool | None = None  # default: true in class "worn", else false
    output: OutputSettings | None = None  # in addition to NMT stop


def check_output(output: OutputSettings, where: str) -> None:
    """Raise UsageError if this computer cannot open a URL or lacks a package or a program. Switch nothing."""
    if output.serial is not None:
        check_port(output.serial, where)
    if output.gpio is not None and importlib.util.find_spec("gpiod") is None:
        raise UsageError(f"{where}: gpio \"{output.gpio}\" needs the package gpiod; install it: pip install '.[gpio]'")
    if output.command and shutil.which(output.command[0]) is None:
        raise UsageError(f'{where}: command "{output.command[0]}" is not a program here; correct the path')


class TorqueOff:
    """An output that permits torque once it is opened, and removes it with `off`. Lines go inactive at process end.

    Attributes:
        permit: switches a serial output to permit torque.
        off: removes torque, and returns True once this is done. Call it repeatedly until then.
    """

    def __init__(self, output: OutputSettings | None, where: str = "[monitor] output") -> None:
        """Open the output. Raise UsageError if its line cannot be opened."""
        self.permit: Callable[[], None] = lambda: None
        self.off: Callable[[], bool] = lambda: True
        self._running: subprocess.Popen[bytes] | None = None
        self._done = False
        if output is None:
            return
        check_output(output, where)
        try:
            if output.gpio is not None:
                self._open_gpio(*output.gpio.split(":"))
            elif output.serial is not None:
                self._open_serial(output.serial, output.line)
            else:
                self.off = lambda: self._run(output.command)
        except (OSError, ValueError) as error:
            name = output.gpio or output.serial
            reason = getattr(error, "strerror", None) or " ".join(str(error).split())
            raise UsageError(f'{where}: "{name}" cannot be opened ({reason}); correct the name or its rights') from None

    def _open_gpio(self, chip: str, line: str) -> None:
        gpiod: Any = importlib.import_module("gpiod")  # an optional extra
        lines: Any = importlib.import_module("gpiod.line")
        settings = gpiod.LineSettings(direction=lines.Direction.OUTPUT, output_value=lines.Value.ACTIVE)
        request: Any = gpiod.request_lines(f"/dev/{chip}", consumer="tsa", config={int(line): settings})

        def off() -> bool:
            request.set_value(int(line), lines.Value.INACTIVE)
            return True

        self.off = off

    def _open_serial(self, port: str, line: str) -> None:
        import serial  # slow to import

        opened: Any = serial.serial_for_url(port, _BAUD_RATE, write_timeout=0)

        def switch(on: bool) -> None:
            with contextlib.suppress(OSError):  # a pseudo-terminal has no modem lines
                setattr(opened, line, on)
            with contextlib.suppress(OSError):  # the buffer is full
                opened.write(_PERMIT if on else _OFF)

        def off() -> bool:
            switch(False)
            return True

        self.permit, self.off = lambda: switch(True), off

    def _run(self, command: tuple[str, ...]) -> bool:
        """Start the command, and start it again after a failure. Return True once it has ended with 0."""
        if self._running is not None and self._running.poll() is not None:
            self._done = self._done or self._running.returncode == 0
            self._running = None
        if self._running is None and not self._done:
            quiet = subprocess.DEVNULL
            with contextlib.suppress(OSError):
                self._running = subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=quiet)
        return self._done
