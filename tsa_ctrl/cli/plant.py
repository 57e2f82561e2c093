"""`tsa plant`: the simulated machine on a bus."""

from __future__ import annotations

import click

from tsa_ctrl.plant import process


@click.command(
    name="plant",
    epilog="Example: tsa plant config/plant.toml --record truth.csv",
)
@click.argument("configuration", metavar="PLANT.toml")
@click.option("--check", is_flag=True, help="Validate the configuration and end; nothing goes on the bus.")
@click.option("--record", metavar="FILE", help="Write the plant's own truth (torques, angles, tensions) as CSV.")
def command(configuration: str, check: bool, record: str | None) -> None:
    """Simulated drives, joints and sensors as CANopen nodes on a bus, until Ctrl-C or SIGTERM."""
    if check:
        plant = process.check(configuration)
        click.echo(f"{configuration}: valid, {len(plant.axis)} axis" + ("" if len(plant.axis) == 1 else "es"))
        return
    process.run(configuration, record)
