"""`tsa doctor`: check that this machine can run the loop."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tsa_ctrl.cli.options import Finite
from tsa_ctrl.outputs import json_types, terminal

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from tsa_ctrl.bus.drive.profile import DriveProfile
    from tsa_ctrl.bus.settings import AxisNodes, BusSettings
    from tsa_ctrl.bus.wire.bus import Bus
    from tsa_ctrl.config import Configuration
    from tsa_ctrl.doctor.can_interface import Check

COLOURS = {"pass": "green", "warn": "yellow", "fail": "red"}


@click.command("doctor", epilog="Example: tsa doctor config/controller.toml")
@click.argument("controller", required=False, type=click.Path(path_type=Path))
@click.option(
    "--seconds",
    default=3.0,
    show_default=True,
    type=Finite(0.1, 600.0),
    help="Duration of the lateness measurement, s.",
)
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")
@click.option(
    "--serial-numbers", is_flag=True, help="Read the drives' serial numbers, write them to CONTROLLER.toml, and exit."
)
def command(controller: Path | None, seconds: float, as_json: bool, serial_numbers: bool) -> int:
    """Check kernel, rights, clock, CAN interface, bus load and latency; exit code 1 if a check fails.

    With a CONTROLLER.toml, its rate, rights, bus and CAN interrupts are checked; without one, the machine at 1 kHz.
    """
    from tsa_ctrl.bus.drive.network import axes_of
    from tsa_ctrl.config import check_drives, load_configuration
    from tsa_ctrl.doctor import can_interface, machine
    from tsa_ctrl.doctor.can_interface import Result
    from tsa_ctrl.system.realtime import RealtimeSettings

    configuration = None if controller is None else load_configuration(controller)
    if serial_numbers:
        if configuration is None:
            raise click.UsageError("--serial-numbers writes to CONTROLLER.toml; give this file")
        return _write_serial_numbers(configuration)
    found: list[Check] = []
    if configuration is None:
        found += machine.checks(RealtimeSettings(), 1000.0, seconds)
    else:
        check_drives(configuration)
        file = configuration.file
        found += machine.checks(file.realtime, file.controller.rate, seconds)
        for bus in file.buses:
            axes = axes_of(bus, file.axes)
            found += can_interface.checks(bus, axes, file.controller.rate, configuration.profiles)
            if bus.interface == "socketcan":
                found += machine.can_interrupts(bus.channel, file.realtime)
    if as_json:
        click.echo(json.dumps({"schema": 1, "checks": json_types(found)}))
    else:
        _show(found)
    return int(any(check.result is Result.FAIL for check in found))


def _write_serial_numbers(configuration: Configuration) -> int:
    """Read the serial numbers by SDO without any command, and write them to the file; a backup is kept next to it."""
    from tsa_ctrl import outputs
    from tsa_ctrl.bus.drive.network import open_buses

    file = configuration.file
    bus = open_buses(file.buses, file.axes)
    try:
        found = serial_numbers(bus, file.bus, file.axes, configuration.profiles)
    finally:
        bus.close()
    for axis, number in found.items():
        click.echo(f"axis '{axis}': {number if isinstance(number, str) else f'serial_number = {number}'}")
    numbers = {axis: number for axis, number in found.items() if isinstance(number, int)}
    if not numbers:
        click.echo(f"not written: {configuration.path}")
        return 1
    text = with_serial_numbers(configuration.path.read_text(encoding="utf-8"), numbers)
    with outputs.beside(configuration.path) as part:
        part.write_text(text, encoding="utf-8")
    click.echo(f"written: {configuration.path}")
    return int(len(numbers) < len(found))


def _show(found: list[Check]) -> None:
    from rich.table import Table
    from rich.text import Text

    console = terminal()
    table = Table("check", "result", "found", "required")
    for check in found:
        result = Text(check.result.value, style=COLOURS[check.result.value])
        table.add_row(check.name, result, check.found, check.wanted)
    console.print(table)
    for check in found:
        if check.fix:
            console.print(f"{check.name}: {check.fix}", soft_wrap=True)


def serial_numbers(
    bus: Bus, settings: BusSettings, axes: Sequence[AxisNodes], profiles: Sequence[DriveProfile]
) -> dict[str, int | str]:
    """Return 0x1018:4 of the drive of each axis, or the reason why it has none ("no serial number: REASON").

    Raises:
        BusError: the bus failed, or another master is active.
    """
    from tsa_ctrl.bus.canopen import objects
    from tsa_ctrl.bus.drive.checks import Node
    from tsa_ctrl.bus.drive.network import frames_of_drives
    from tsa_ctrl.bus.drive.session import Session
    from tsa_ctrl.bus.settings import Role
    from tsa_ctrl.errors import BusError

    found: dict[str, int | str] = {}
    with Session(bus, settings) as session:
        session.alone(tolerated=frames_of_drives(profiles))
        for axis, profile in zip(axes, profiles, strict=True):
            node = Node(axis, profile, Role.DRIVE, axis.drive)
            session.be_patient(node.node_id, node.answer_timeout)
            try:
                number = session.read(node.node_id, objects.SERIAL_NUMBER)
            except BusError as error:
                if bus.fault is not None:
                    raise
                found[axis.name] = f"no serial number: {error}"
            else:
                found[axis.name] = number or f"no serial number: node {node.node_id} has 0 in {objects.SERIAL_NUMBER}"
    return found


def with_serial_numbers(text: str, numbers: Mapping[str, int]) -> str:
    """Return the text of a controller file with these serial numbers in its [axis.drive] tables."""
    import tomlkit

    document = tomlkit.parse(text)
    axes: Any = document["axis"]
    for axis in axes:
        if axis["name"] in numbers:
            axis["drive"]["serial_number"] = numbers[axis["name"]]
    return str(tomlkit.dumps(document))
