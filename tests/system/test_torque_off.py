"""Test the outputs for safe torque off with a pseudo-terminal, a command and a fake GPIO library."""

from __future__ import annotations

import os
import sys
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from tests.sensors.lines import Line, wait_for
from tsa_ctrl.errors import UsageError
from tsa_ctrl.system import torque_off
from tsa_ctrl.system.torque_off import OutputSettings, TorqueOff, check_output


@pytest.fixture
def line(tmp_path: Path) -> Iterator[Line]:
    made = Line(tmp_path / "tty")
    yield made
    made.unplug()


def test_a_serial_output_permits_byte_by_byte_and_takes_it_away(line: Line) -> None:
    output = TorqueOff(OutputSettings(serial=str(line.path)))
    output.permit()
    assert os.read(line.ours, 1) == b"1"
    output.permit()
    assert os.read(line.ours, 1) == b"1"
    assert output.off()
    assert os.read(line.ours, 1) == b"0"


@pytest.mark.parametrize("name", ["dtr", "rts"])
def test_a_serial_output_switches_its_modem_line(name: str, line: Line, monkeypatch: pytest.MonkeyPatch) -> None:
    import serial

    switched: list[tuple[str, bool]] = []
    for each in ("dtr", "rts"):
        monkeypatch.setattr(
            serial.Serial, each, property(None, lambda port, on, each=each: switched.append((each, on)))
        )
    output = TorqueOff(OutputSettings(serial=str(line.path), line=name))  # type: ignore[arg-type]
    switched.clear()
    output.permit()
    output.off()
    assert switched == [(name, True), (name, False)]


def test_a_command_runs_until_it_succeeds(tmp_path: Path) -> None:
    script = f'echo x >> {tmp_path}/runs; test "$(wc -l < {tmp_path}/runs)" -ge 3'
    output = TorqueOff(OutputSettings(command=("sh", "-c", script)))
    output.permit()
    assert not (tmp_path / "runs").exists()
    wait_for(output.off)
    assert (tmp_path / "runs").read_text() == "x\n" * 3
    assert output.off()
    assert (tmp_path / "runs").read_text() == "x\n" * 3


def test_a_gpio_line_is_active_while_torque_is_permitted(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[Any] = []

    class Request:
        def set_value(self, line: int, value: str) -> None:
            calls.append((line, value))

    def request(path: str, consumer: str, config: dict[int, Any]) -> Request:
        calls.append((path, consumer, config))
        return Request()

    lines = types.SimpleNamespace(
        Direction=types.SimpleNamespace(OUTPUT="out"), Value=types.SimpleNamespace(ACTIVE="on", INACTIVE="off")
    )
    library = types.SimpleNamespace(LineSettings=lambda **given: given, request_lines=request, line=lines)
    monkeypatch.setitem(sys.modules, "gpiod", library)
    monkeypatch.setitem(sys.modules, "gpiod.line", lines)
    monkeypatch.setattr(torque_off.importlib.util, "find_spec", lambda name: object())
    output = TorqueOff(OutputSettings(gpio="gpiochip0:17"))
    assert calls == [("/dev/gpiochip0", "tsa", {17: {"direction": "out", "output_value": "on"}})]
    assert output.off()
    assert calls[1:] == [(17, "off")]


@pytest.mark.parametrize("use", [TorqueOff, check_output])
def test_a_url_of_an_unknown_kind_is_refused_with_the_remedy(use: Callable[[OutputSettings, str], None]) -> None:
    with pytest.raises(UsageError, match=r'^output: port "relay://1": .*not known; give a device such as /dev/ttyUSB0'):
        use(OutputSettings(serial="relay://1"), "output")


def test_an_output_is_exactly_one_of_three_and_can_be_used_here(monkeypatch: pytest.MonkeyPatch) -> None:
    for text in (
        "{}",
        '{"command": ["a"], "gpio": "gpiochip0:1"}',
        '{"gpio": "17"}',
        '{"serial": ""}',
        '{"serial": "a\\u0000"}',
        '{"relay": 1}',
    ):
        with pytest.raises(msgspec.ValidationError):
            msgspec.json.decode(text, type=OutputSettings)
    monkeypatch.setattr(torque_off.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(UsageError, match=r"needs the package gpiod; install it: pip install '.\[gpio\]'"):
        check_output(OutputSettings(gpio="gpiochip0:17"), "[monitor] output")
    with pytest.raises(UsageError, match=r"output: command \"/no/such/program\" is not a program here"):
        check_output(OutputSettings(command=("/no/such/program",)), "output")
