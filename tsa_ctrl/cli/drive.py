"""`tsa drive`: probe a drive; dump, restore or compare the objects that this master writes; set a node id."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tsa_ctrl.errors import UsageError

if TYPE_CHECKING:
    from tsa_ctrl.bus.canopen.objects import Object, Write
    from tsa_ctrl.bus.drive.profile import DriveProfile
    from tsa_ctrl.bus.drive.session import Session
    from tsa_ctrl.bus.settings import AxisNodes, BusSettings
    from tsa_ctrl.bus.wire.bus import Bus

_CONTEXT = {"help_option_names": ["-h", "--help"]}
_PERIOD = 0.001  # s, SYNC period without a configuration


class Target:
    """The drive selected on the command line, with its bus, its profile and the SYNC period."""

    def __init__(self, bus: BusSettings, axis: AxisNodes, profile: DriveProfile, period: float) -> None:
        self.bus = bus
        self.axis = axis
        self.profile = profile
        self.period = period

    @property
    def node_id(self) -> int:
        return self.axis.drive.node_id

    def plan(self, session: Session) -> list[Write]:
        """Return the values that the startup writes to the node; this method only reads."""
        from tsa_ctrl.bus.drive.bring_up import whole_plan
        from tsa_ctrl.bus.drive.plan import drive_plan
        from tsa_ctrl.bus.drive.profile import drive_scale

        drive = self.axis.drive
        scale = drive_scale(drive, self.profile, f"axis '{self.axis.name}'")
        plan = drive_plan(self.axis, self.profile, scale, self.bus, self.period)
        return whole_plan(session, self.node_id, plan, drive.slot, self.profile, self.bus.host_node_id)

    @contextmanager
    def session(self) -> Iterator[Session]:
        from tsa_ctrl.bus.drive.network import frames_of_drives
        from tsa_ctrl.bus.drive.session import Session

        with opened(self.bus) as bus, Session(bus, self.bus) as session:
            session.alone(tolerated=frames_of_drives([self.profile]))
            yield session


def target_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that select a drive: controller file and axis, or interface, channel and node id."""
    options = (
        click.option("--config", type=click.Path(), help="Controller file with bus, drive and profile."),
        click.option("--axis", "axis_name", help="Axis in the controller file; required if it has several."),
        click.option("--node", type=click.IntRange(1, 127), help="Node id, without a controller file."),
        bus_options,
        click.option(
            "--profile",
            default="generic",
            show_default=True,
            help="Drive profile: a name in ./config/drives, or a path to a .toml file.",
        ),
    )
    for option in reversed(options):
        function = option(function)
    return function


def bus_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that select a bus."""
    options = (
        click.option("--interface", default="socketcan", show_default=True, help="As in [bus] interface."),
        click.option("--channel", default="can0", show_default=True, help="As in [bus] channel."),
        click.option(
            "--bitrate", default=1_000_000, show_default=True, help="Bit rate, bit/s, if the interface needs it."
        ),
    )
    for option in reversed(options):
        function = option(function)
    return function


def bus_of(interface: str, channel: str, bitrate: int) -> BusSettings:
    """Return the bus that the options select; raise UsageError for a wrong option."""
    from tsa_ctrl import settings
    from tsa_ctrl.bus.settings import BusSettings

    data = {"interface": interface, "channel": channel, "bitrate": bitrate}
    return settings.convert(data, BusSettings, "command line")


def find_target(
    config: str | None,
    axis_name: str | None,
    node: int | None,
    interface: str,
    channel: str,
    bitrate: int,
    profile: str,
) -> Target:
    """Return the drive that the options select; raise UsageError unless they select exactly one."""
    from tsa_ctrl.bus.drive.profile import load_profile
    from tsa_ctrl.bus.settings import AxisNodes, DriveSettings

    if config is None:
        if node is None:
            raise UsageError(
                "no drive selected; give --config CONTROLLER.toml, or --node with --interface and --channel"
            )
        bus = bus_of(interface, channel, bitrate)
        axis = AxisNodes(name=f"node {node}", drive=DriveSettings(node_id=node, profile=profile))
        folder = "." if profile.endswith(".toml") else "config"
        return Target(bus, axis, load_profile(profile, folder), _PERIOD)
    if node is not None:
        raise UsageError("--node and --config are both given; with a controller file, select the drive with --axis")
    from tsa_ctrl.config import load_configuration

    configuration = load_configuration(config)
    axes = configuration.file.axes
    names = [axis.name for axis in axes]
    if axis_name is None and len(axes) > 1:
        raise UsageError(f"{config}: has several axes; give --axis {' or --axis '.join(names)}")
    if axis_name is not None and axis_name not in names:
        raise UsageError(f"{config}: no axis '{axis_name}'; its axes are {', '.join(names)}")
    number = 0 if axis_name is None else names.index(axis_name)
    bus = configuration.file.bus_of(axes[number])
    return Target(bus, axes[number], configuration.profiles[number], configuration.period)


@click.group("drive", context_settings=_CONTEXT)
def command() -> None:
    """Look at a drive, dump, restore or compare the objects that this master writes, or give it a node id.

    The drive must be idle: no daemon may be running on its bus.
    """


@command.command(
    "dump", context_settings=_CONTEXT, epilog="Example: tsa drive dump --config config/controller.toml --out knee.toml"
)
@target_options
@click.option("--out", type=click.Path(path_type=Path), help="File to write; default: stdout.")
def dump_command(out: Path | None, **options: Any) -> None:
    """Read the objects and write them as TOML."""
    from tsa_ctrl import outputs, settings
    from tsa_ctrl.bus.drive.backup import dump, entries_of

    target = find_target(**options)
    with target.session() as session:
        backup = dump(session, target.node_id, entries_of(target.plan(session), target.axis.drive.slot))
    for name in backup.unreadable:
        click.echo(f"node {target.node_id}: {name} cannot be read and is not in the backup", err=True)
    if out is None:
        click.echo(backup.text(), nl=False)
        return
    outputs.keep(out)
    settings.write_text(out, backup.text())
    click.echo(f"{out}: {len(backup.object)} objects of node {target.node_id}")


@command.command(
    "restore",
    context_settings=_CONTEXT,
    epilog="Example: tsa drive restore knee.toml --config config/controller.toml",
)
@click.argument("backup_file", metavar="FILE", type=click.Path())
@target_options
def restore_command(backup_file: str, **options: Any) -> None:
    """Write the objects of FILE to the drive and read each back."""
    from tsa_ctrl.bus.drive.backup import load_backup, restore

    target = find_target(**options)
    backup = load_backup(backup_file)
    with target.session() as session:
        rows = restore(session, target.node_id, backup)
    for row in rows:
        if row.changed:
            click.echo(str(row))
    changed = sum(row.changed for row in rows)
    click.echo(f"node {target.node_id}: {len(rows)} objects verified, {changed} changed")


@command.command(
    "diff",
    context_settings=_CONTEXT,
    epilog="Example: tsa drive diff knee.toml --config config/controller.toml",
)
@click.argument("backup_file", metavar="[FILE]", type=click.Path(), required=False)
@target_options
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout and nothing else.")
def diff_command(backup_file: str | None, as_json: bool, **options: Any) -> int:
    """Compare the drive with FILE or with the configuration, and change nothing. Exit code 1 when objects differ.

    The notes list the drive's own limits and ramps of the torque, if they act.
    """
    from tsa_ctrl.bus.drive.backup import compare, load_backup, wanted_by
    from tsa_ctrl.bus.drive.checks import Node, check_torque_path
    from tsa_ctrl.bus.settings import Role

    target = find_target(**options)
    stored = None if backup_file is None else load_backup(backup_file)
    unreadable: list[Object] = []
    with target.session() as session:
        if stored is None:
            wanted = wanted_by(session, target.node_id, target.plan(session), unreadable)
        else:
            wanted = [(item.entry, item.raw) for item in stored.object]
        differences = compare(session, target.node_id, wanted, unreadable)
        node = Node(target.axis, target.profile, Role.DRIVE, target.axis.drive)
        _, notes = check_torque_path(session, node, {entry.key for entry, _ in wanted if stored is None})
    compared = sum(entry not in unreadable for entry, _ in wanted)
    notes = [*(f"{entry} cannot be read and was not compared" for entry in dict.fromkeys(unreadable)), *notes]
    if as_json:
        found = [
            {
                "index": difference.entry.index,
                "subindex": difference.entry.subindex,
                "name": difference.entry.name,
                "wanted": difference.wanted,
                "found": difference.found,
            }
            for difference in differences
        ]
        result = {"schema": 1, "node": target.node_id, "compared": compared, "differences": found, "notes": notes}
        click.echo(json.dumps(result, allow_nan=False))
        return int(bool(differences))
    for difference in differences:
        click.echo(str(difference))
    for note in notes:
        click.echo(note)
    click.echo(f"node {target.node_id}: {compared} objects compared, {len(differences)} differ")
    return int(bool(differences))


@contextmanager
def opened(settings: BusSettings) -> Iterator[Bus]:
    """Open a bus for the block; raise BusError if that fails."""
    from tsa_ctrl.bus.wire.link import open_bus

    bus = open_bus(settings)
    try:
        yield bus
    finally:
        bus.close()


@command.command(
    "probe", context_settings=_CONTEXT, epilog="Example: tsa drive probe --channel can0 --node 5 --out drives/mine.toml"
)
@bus_options
@click.option("--node", type=click.IntRange(1, 127), required=True, help="Node id of the drive.")
@click.option(
    "--slot", type=click.IntRange(1, 8), default=1, show_default=True, help="Axis number in a device with several axes."
)
@click.option("--out", type=click.Path(path_type=Path), help="Profile to write; default: stdout.")
def probe_command(interface: str, channel: str, bitrate: int, node: int, slot: int, out: Path | None) -> None:
    """Read the capabilities of a drive, and write a draft of its profile; nothing is commanded, written or moved.

    Asks by SDO alone: no NMT, no SYNC, no heartbeat.
    """
    from tsa_ctrl import outputs
    from tsa_ctrl.bus.drive.probe import probe, profile_text
    from tsa_ctrl.bus.drive.session import Session

    settings = bus_of(interface, channel, bitrate)
    with opened(settings) as bus, Session(bus, settings) as session:
        text = profile_text(probe(session, bus.name, node, slot), f"{interface} {channel}")
    if out is None:
        click.echo(text, nl=False)
        return
    with outputs.beside(out) as part:
        part.write_text(text, encoding="utf-8")
    unfinished = text.count("FINISH: ")
    lines = "1 line" if unfinished == 1 else f"{unfinished} lines"
    click.echo(f"{out}: {lines} to complete (marked FINISH); then run: tsa run --check CONTROLLER.toml")


@command.command(
    "set-node-id", context_settings=_CONTEXT, epilog="Example: tsa drive set-node-id 5 --channel can0 --yes"
)
@click.argument("node_id", metavar="ID", type=click.IntRange(1, 127))
@bus_options
@click.option("--yes", is_flag=True, help="Store it without asking.")
def set_node_id_command(node_id: int, interface: str, channel: str, bitrate: int, yes: bool) -> None:
    """Give the one drive on the bus this node id by LSS, and have it keep it.

    It must be alone on the bus: every node that knows LSS would take the id.
    """
    from tsa_ctrl.bus.drive import lss

    with opened(bus_of(interface, channel, bitrate)) as bus:
        found = lss.find(bus)
        named = ", ".join(f"{name} 0x{value:08X}" for name, value in found.identity.items())
        has = "no node id" if found.node_id is None else f"node id {found.node_id}"
        click.echo(f"{channel}: one node with {has}: {named}", err=True)
        if not yes:
            if not sys.stdin.isatty():
                raise UsageError(
                    f"node id {node_id} would be stored in the drive; confirm this in a terminal, or give --yes"
                )
            click.confirm(f"Store node id {node_id} in the drive?", abort=True)
        lss.set_node_id(bus, node_id, lambda line: click.echo(line, err=True))
    click.echo(f"{channel}: node id {node_id} is stored in the drive")
