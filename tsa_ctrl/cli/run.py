"""`tsa run`: run the daemon."""

from __future__ import annotations

import contextlib
import json
import math
import os
import sys
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tsa_ctrl.cli.options import Finite
from tsa_ctrl.outputs import terminal

if TYPE_CHECKING:
    from tsa_ctrl.config import Configuration
    from tsa_ctrl.ipc.server_process import ServerProcess


@click.command(
    "run",
    epilog="Example: tsa run config/controller.toml --seconds 20",
)
@click.argument("controller", type=click.Path(path_type=Path))
@click.option("--check", is_flag=True, help="Validate the configuration and the files that it refers to; move nothing.")
@click.option("--seconds", type=Finite(min=0.0, min_open=True), help="End after this duration with torque, s.")
@click.option("--reset-faults", is_flag=True, help="Reset drives that are in fault at startup.")
@click.option("--allow-simulated", is_flag=True, help="Allow a model file with simulated numbers on real drives.")
@click.option(
    "--record-bus",
    type=click.Path(path_type=Path),
    help="Record every frame of the bus: .log (candump), .asc, .blf, .csv or .trc.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the summary as one JSON object.")
def command(
    controller: Path,
    check: bool,
    seconds: float | None,
    reset_faults: bool,
    allow_simulated: bool,
    record_bus: Path | None,
    as_json: bool,
) -> int:
    """Bring the drives up, run the loop and log, until SIGTERM, SIGINT, SIGHUP or `tsa stop`."""
    leave_out()
    if check:
        _check(controller, allow_simulated, record_bus)
        return 0
    with contextlib.ExitStack() as stack:
        server = _socket_server(controller)
        if server is not None:
            stack.callback(server.end)
            server.stage("importing")
        from tsa_ctrl.config import load_configuration
        from tsa_ctrl.daemon.bus_recorder import recorded
        from tsa_ctrl.daemon.joint_files import admitted

        configuration = admitted(load_configuration(controller), allow_simulated)
        from tsa_ctrl.daemon.run import run  # imports the loop; not needed for a rejected file

        def say(line: str) -> None:
            click.echo(line, err=True)

        with recorded(configuration.file.buses, record_bus, say):
            summary = run(
                configuration,
                math.inf if seconds is None else seconds,
                say,
                reset_faults=reset_faults,
                allow_simulated=allow_simulated,
                server=server,
            )
    if as_json:
        click.echo(json.dumps(summary.as_dict()))
    else:
        summary.show(terminal(stderr=True))
    return 1 if summary.failed else 0


def _socket_server(controller: Path) -> ServerProcess | None:
    """Open the daemon's socket before slow imports; return None for a file that will be rejected."""
    from tsa_ctrl.ipc.protocol import default_path
    from tsa_ctrl.ipc.server_process import ServerProcess

    try:
        data = tomllib.loads(controller.read_text(encoding="utf-8"))
        socket = data.get("socket", {})
        place = (socket.get("path") or default_path(), socket.get("group"), socket.get("watch_group"))
        name = data.get("controller", {}).get("name", "rig")
    except (OSError, ValueError, AttributeError):
        return None
    if not all(value is None or isinstance(value, str) for value in (*place, name)):
        return None
    return ServerProcess(*place, name)


def _check(controller: Path, allow_simulated: bool, record_bus: Path | None) -> None:
    """Validate the configuration and print the result, without importing the loop."""
    from tsa_ctrl.config import check_drives, load_configuration
    from tsa_ctrl.daemon.bus_recorder import check_record
    from tsa_ctrl.daemon.joint_files import admitted
    from tsa_ctrl.readiness import loose_lines, missing, require
    from tsa_ctrl.system.torque_off import check_output

    configuration = admitted(load_configuration(controller), allow_simulated)
    check_drives(configuration)
    check_record(configuration.file.buses, record_bus)
    if configuration.monitored and configuration.file.monitor.output is not None:
        check_output(configuration.file.monitor.output, f"{configuration.path}: [monitor] output")
    for line in loose_lines(configuration):
        click.echo(line, err=True)
    require(configuration, missing(configuration))
    click.echo(_checked(configuration))
    for axis, profile in zip(configuration.file.axes, configuration.profiles, strict=True):
        for line in profile.unknown:
            click.echo(f"axis '{axis.name}': not known in the profile of {profile.name}: {line}", err=True)


def _checked(configuration: Configuration) -> str:
    file = configuration.file
    axes = ", ".join(axis.name for axis in file.axes)
    loads = ", ".join(
        f"{bus.name}{' ' if bus.name else ''}{100 * load.least:.0f} to {100 * load.worst:.0f} % of {bus.bitrate} bit/s"
        for bus, load in zip(file.buses, configuration.loads, strict=True)
    )
    return f"{configuration.path}: valid; {axes} at {file.controller.rate:g} Hz, bus load {loads}"


def leave_out() -> None:
    """Exclude scipy.linalg and the threads of OpenBLAS from this process, unless it already uses numpy.

    numba imports scipy.linalg for matrix products in compiled functions, but the daemon's functions have none. The
    largest matrix of the daemon has a dozen rows, for which a single thread is sufficient.
    """
    if "numpy" in sys.modules:  # called from Python, where a later diagnosis needs scipy.linalg
        return
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    sys.modules["scipy.linalg"] = None  # type: ignore[assignment]  # makes an import of this module fail
