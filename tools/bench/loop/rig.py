"""Controller files for the measuring tools: one to eight axes at the highest rate that the bus carries."""

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
[axis.encoder]
node_id = {encoder}
[axis.torque_sensor]
node_id = {sensor}
[axis.setpoint]
kind = "sine"
amplitude = 0.3
frequency = 0.5
[axis.limits]
torque = 2.0
"""


def controller_text(folder: str | Path, interface: str, axes: int, rate: float = 0.0) -> str:
    """Return the TOML of a controller whose files are in `folder`; `rate` 0 is the highest that the bus carries."""
    shutil.copy(CONFIG / "actuator.toml", folder)
    text = f"""
[controller]
rate = {rate or RATES[axes]}
[bus]
channel = "{interface}"
[realtime]
allow_without = true
[log]
folder = "logs"
[socket]
path = "{folder}/tsa.sock"
"""
    return text + "".join(AXIS.format(n=n, drive=1 + n, encoder=32 + n, sensor=64 + n) for n in range(axes))
