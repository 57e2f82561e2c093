"""`tsa plant`: run the simulated machine on a bus."""

from __future__ import annotations

from pathlib import Path

import click

from tsa_ctrl import outputs


@click.command(
    name="plant",
    epilog="Examples: tsa plant config/plant.toml --record truth.csv --control /tmp/plant.sock; "
    "then, from elsewhere: tsa plant --ask 'torn_tendon axis=joint' --control /tmp/plant.sock",
)
@click.argument("configuration", metavar="PLANT.toml", required=False)
@click.option("--check", is_flag=True, help="Validate the configuration and exit; nothing is sent on the bus.")
@click.option("--record", metavar="FILE", help="Write the plant's true values (torques, angles, tensions) as CSV.")
@click.option("--control", metavar="SOCKET", help="Local socket that accepts faults at run time.")
@click.option("--eds", metavar="FILE", help="Write the EDS of each simulated node and exit; several: FILE-NODE.eds.")
@click.option(
    "--ask", "line", metavar="LINE", help="Send LINE to the plant at --control: a fault, clear, state or list."
)
def command(
    configuration: str | None,
    check: bool,
    record: str | None,
    control: str | None,
    eds: str | None,
    line: str | None,
) -> int | None:
    """Simulated drives, joints and sensors as CANopen nodes on a bus, until Ctrl-C or SIGTERM."""
    if line is not None:
        if control is None:
            raise click.UsageError("--ask requires --control SOCKET, with the socket given at the start of the plant")
        from tsa_ctrl.plant.process import ask

        answer = ask(control, line)
        click.echo(answer, err=answer.startswith("error"))
        return 2 if answer.startswith("error") else 0
    if configuration is None:
        raise click.UsageError("Missing argument 'PLANT.toml'.")
    if not check and eds is None:
        click.echo("plant: starting", err=True)
    from tsa_ctrl.plant import process  # imports compiled code, which --ask does not need

    if check:
        plant = process.check(configuration)
        click.echo(f"{configuration}: valid, {len(plant.axis)} {'axis' if len(plant.axis) == 1 else 'axes'}")
        return None
    if eds is not None:
        outputs.refuse_inputs(Path(eds), [Path(configuration)], "--eds")
        for path, text in process.eds_files(configuration, Path(eds)):
            with outputs.beside(path) as part:
                part.write_bytes(text.encode("latin-1", "replace"))
            click.echo(str(path))
        return None
    if record is not None:
        outputs.refuse_inputs(Path(record), [Path(configuration)], "--record")
        outputs.keep(Path(record))
    process.run(configuration, record, control)
    return None
