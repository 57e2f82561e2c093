"""The demo's files: a plant whose parameters are NOT the controller's, controllers with and without compensation."""

from __future__ import annotations

from pathlib import Path

from tsa_ctrl.demo.bus_choice import BusChoice
from tsa_ctrl.demo.motion import Play

MOST_TORQUE = 1.1  # N*m at the joint: within the tendons' domain at the pretension below

NOMINAL = """\
[actuator]
motor_pulley_radius = 0.020      # m
joint_pulley_radius = 0.025      # m

[tendon]
axial_stiffness = 60e3           # N
unstrained_length = 1.2          # m
diameter = 0.6e-3                # m

[sheath]
friction_coefficient = 0.10      # 1
bending_angle = 2.6              # rad
contact_offset = 0.4e-3          # m

[pretension]
value = 45.0                     # N
"""

PLANT = """\
[bus]
interface = "{interface}"
channel = "{channel}"

[physics]
start = "first_enable"           # the same motion in every run
priority = 90                    # above the controller's: a real machine does not wait for it either

[[axis]]
name = "joint"
actuator = "nominal.toml"

[axis.perturbation]              # the truth is not nominal
friction_coefficient = 1.08
pretension = 0.95
axial_stiffness = 0.9

[axis.tendon]
kind = "{tendon}"
curvature = "uniform"

[axis.motion]
kind = "file"
file = "motion.csv"
repeat = true
"""

CONTROLLER = """\
[controller]
name = "demo"
rate = {rate}
settle_cycles = 20               # a busy machine may not give 100 in a row
after_fault = "exit"

[bus]
interface = "{interface}"
channel = "{channel}"

[bus.supervision]
tolerated_misses = 50            # a busy machine stalls plant or daemon for 10 ms and more
tolerated_drops = 50

[realtime]
allow_without = true             # a demonstration may run without real-time rights

[log]
folder = "."

[socket]
path = "{socket}"

[[axis]]
name = "joint"
model = "{model}"

[axis.drive]
node_id = 1
max_torque = 3.0
host_timeout = 0.5               # for the same reason
rpdo_timeout = 0.2
heartbeat_timeout = 1.0

[axis.encoder]
node_id = 32
heartbeat_timeout = 1.0

[axis.torque_sensor]
node_id = 64
heartbeat_timeout = 1.0

[axis.setpoint]
kind = "file"
file = "setpoint.csv"
loop = true

[axis.law]
compensation = {compensation}
fade_in = {fade_in}

[axis.limits]
torque = 2.5
"""

FADE_IN = 1.0  # s


def write(
    folder: Path, bus: BusChoice, play: Play, rate: float, tendon: str, models: dict[str, tuple[str, float]]
) -> None:
    """Write the nominal model, the plant and one controller per entry of `models`.

    `models`: name -> (model file, compensation factor).
    """
    (folder / "nominal.toml").write_text(NOMINAL, encoding="utf-8")
    play.write_setpoint(folder / "setpoint.csv")
    play.write_motion(folder / "motion.csv")
    plant = PLANT.format(interface=bus.interface, channel=bus.channel, tendon=tendon)
    (folder / "plant.toml").write_text(plant, encoding="utf-8")
    for name, (model, compensation) in models.items():
        text = CONTROLLER.format(
            interface=bus.interface,
            channel=bus.channel,
            rate=rate,
            socket=f"{name}.sock",
            model=model,
            compensation=compensation,
            fade_in=FADE_IN,
        )
        (folder / f"controller-{name}.toml").write_text(text, encoding="utf-8")
