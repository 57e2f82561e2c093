"""Write controller and plant files for the benchmarks, with one to eight axes at the highest rate of the bus."""

from __future__ import annotations

import shutil
from pathlib import Path

from tools.command import CONFIG

RATES = {1: 1000.0, 2: 750.0, 4: 375.0, 8: 180.0}  # Hz that fit 1 Mbit/s in the worst case of bit stuffing
AXIS = """
[[axis]]
name = "axis{n}"
model = "actuator.toml"
[axis.drive]
node_id = {drive}
max_torque = 3.0
{drive_more}
[axis.encoder]
node_id = {encoder}
{more}
[axis.torque_sensor]
node_id = {sensor}
{more}
[axis.setpoint]
kind = "sine"
amplitude = 0.3
frequency = 0.5
[axis.limits]
torque = 2.0
{each}
"""
PATIENT = ("rpdo_timeout = 1.0\nhost_timeout = 2.0\nheartbeat_timeout = 2.0", "heartbeat_timeout = 2.0")  # s
TOLERANT = "[bus.supervision]\ntolerated_misses = 100\nlost_share = 1.0"


def controller_text(
    folder: str | Path, interface: str, axes: int, rate: float = 0.0, patient: bool = False, each: str = ""
) -> str:
    """Return the TOML of a controller whose files are in `folder`. Rate 0 is the highest rate of the bus.

    With `patient` the time-outs are long, so that a stall of the machine does not end the run. `each` is TOML that is
    added to every axis.
    """
    shutil.copy(CONFIG / "actuator.toml", folder)
    drive_more, more = PATIENT if patient else ("", "")
    text = f"""
[controller]
rate = {rate or RATES[axes]}
{"collect = 0.8" if patient else ""}
[bus]
channel = "{interface}"
{TOLERANT if patient else ""}
[realtime]
allow_without = true
[log]
folder = "logs"
[socket]
path = "{folder}/tsa.sock"
"""
    return text + "".join(
        AXIS.format(n=n, drive=1 + n, encoder=32 + n, sensor=64 + n, drive_more=drive_more, more=more, each=each)
        for n in range(axes)
    )


def plant_text(interface: str, axes: int) -> str:
    """Return the TOML of the matching plant, whose friction and pretension differ from the controller's model."""
    axis = """
[[axis]]
name = "axis{n}"
actuator = "actuator.toml"
[axis.perturbation]
friction_coefficient = 1.08
pretension = 0.95
"""
    return f'[bus]\nchannel = "{interface}"\n' + "".join(axis.format(n=n) for n in range(axes))
