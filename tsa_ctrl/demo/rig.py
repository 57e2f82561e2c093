"""Build the demo's files: a plant with parameters that differ from the controller's, and controllers to compare."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from tsa_ctrl.bus.wire.link import can_interfaces, make_vcan, set_up
from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.table import from_zero, read_waypoints
from tsa_ctrl.model.parameters import TendonSheath, save_model

# Desired joint torque and joint motion of the demo, built in or from a file.

FloatArray = NDArray[np.float64]

PERIOD = 1.6  # s of one gait cycle
RATE = 200.0  # Hz of the built-in tables
SINE_PERIOD, SINE_TORQUE = 2.0, 0.5  # s, N*m: small enough that every load stays within its travel
# Typical level walking from the literature: knee flexion in degrees, and an assisting torque of a small actuator in
# N*m. Each pair is (fraction of the gait cycle, value).
KNEE_ANGLE = (
    (0.00, 5.0), (0.07, 12.0), (0.15, 18.0), (0.25, 14.0), (0.40, 5.0),
    (0.50, 11.0), (0.60, 35.0), (0.72, 61.0), (0.85, 34.0), (0.95, 6.0),
)  # fmt: skip
KNEE_TORQUE = (
    (0.00, -0.25), (0.08, 0.35), (0.17, 0.90), (0.28, 0.35), (0.40, -0.35),
    (0.50, -0.10), (0.58, 0.30), (0.72, 0.05), (0.85, -0.30), (0.94, -0.40),
)  # fmt: skip


@dataclass(frozen=True)
class Play:
    """A repeating motion: `t` (n) in s from 0, `tau_j_des` (n) in N*m, and `q_j` (n) in rad of a prescribed joint."""

    t: FloatArray
    tau_j_des: FloatArray
    q_j: FloatArray
    seconds: float = 11.0  # of torque in a run
    shown: float = 3.2  # s in the picture

    def write_setpoint(self, path: Path) -> None:
        """Write the CSV set-point file of the controller."""
        _write(path, "t,tau_j_des", self.t, self.tau_j_des)

    def write_motion(self, path: Path) -> None:
        """Write the CSV motion file of the plant."""
        _write(path, "t,q_j", self.t, self.q_j)


def _write(path: Path, header: str, *columns: FloatArray) -> None:
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="", fmt="%.9g")


def gait() -> Play:
    """Return one cycle of the built-in gait."""
    t = np.arange(0.0, PERIOD + 0.5 / RATE, 1.0 / RATE)
    return Play(t, cycle(KNEE_TORQUE)(t / PERIOD % 1.0), np.radians(cycle(KNEE_ANGLE)(t / PERIOD % 1.0)))


def play_for(load: str) -> Play:
    """Return the gait if the load prescribes the joint's motion, or a sine of torque if the torque moves the joint."""
    if load in ("imposed", "held"):
        return gait()
    t = np.arange(0.0, SINE_PERIOD + 0.5 / RATE, 1.0 / RATE)
    wanted = SINE_TORQUE * np.sin(2.0 * np.pi * t / SINE_PERIOD)
    if load == "wearer":  # the scripted hand motion takes 12 s
        return Play(t, wanted, np.zeros_like(t), seconds=14.0, shown=12.0)
    return Play(t, wanted, np.zeros_like(t), shown=2.0 * SINE_PERIOD)


def cycle(points: tuple[tuple[float, float], ...]) -> CubicSpline:
    """Return the periodic curve through points of (share of the cycle, value)."""
    table = np.array([*points, (1.0, points[0][1])])
    return CubicSpline(table[:, 0], table[:, 1], bc_type="periodic")


def from_file(path: Path, most_torque: float) -> Play:
    """Return a motion from a CSV with the columns t, tau_j_des and optionally q_j (default: the built-in gait).

    Raises:
        UsageError: the file is invalid or a torque exceeds `most_torque` N*m; the message has column and row.
    """
    table = read_waypoints(path, ("tau_j_des",), ("q_j",))
    t, wanted = from_zero(table.columns["t"]), table.columns["tau_j_des"]
    high = int(np.argmax(np.abs(wanted)))
    if abs(wanted[high]) > most_torque:
        raise UsageError(
            f"{path}: column 'tau_j_des', {table.place(high)}: {wanted[high]:.3g} N*m exceeds the demo's "
            f"limit of {most_torque:.2g} N*m; scale the column down"
        )
    angle = table.columns.get("q_j")
    angle = np.radians(cycle(KNEE_ANGLE)(t / PERIOD % 1.0)) if angle is None else angle
    return Play(t, wanted, angle, shown=min(12.0, 2.0 * float(t[-1])))


@dataclass(frozen=True)
class BusChoice:
    """A python-can interface and channel, or virtual time; `name` is the text shown to the user."""

    interface: str
    channel: str
    virtual: bool = False  # no bus is used; interface and channel are written to the files for a later run on a bus

    @property
    def name(self) -> str:
        if self.virtual:
            return "virtual time"
        return self.channel if self.interface == "socketcan" else f"{self.interface} {self.channel}"


VIRTUAL = BusChoice("socketcan", "vcan0", virtual=True)


def choose(asked: str | None = None, say: Callable[[str], None] = lambda line: None) -> BusChoice:
    """Return the requested bus (a CAN interface, or INTERFACE:CHANNEL), otherwise the best available one.

    The order of preference is an existing vcan, a new vcan, local sockets. A vcan that is down is brought up. Without
    the permission for that, `say` receives a message and another bus is used.

    Raises:
        UsageError: the requested CAN interface does not exist or is down.
    """
    there = can_interfaces()
    up = [name for name, link in there.items() if link.up]
    if asked is not None:
        if ":" in asked:
            interface, _, channel = asked.partition(":")
            return BusChoice(interface, channel)
        if asked in there and asked not in up:
            raise UsageError(f"demo: CAN interface {asked} is down; bring it up (ip link set {asked} up) or omit --bus")
        if asked not in there:
            names = ", ".join(up) or "none"
            raise UsageError(
                f"demo: no CAN interface {asked}; interfaces that are up: {names}; choose one of them or omit --bus"
            )
        return BusChoice("socketcan", asked)
    named = os.environ.get("TSA_VCAN")
    virtual = sorted((name for name, link in there.items() if link.kind == "vcan"), key=lambda name: name != named)
    for name in sorted(virtual, key=lambda name: name not in up):
        try:
            if name not in up:
                set_up(name, True)
        except OSError as error:
            reason = error.strerror or error
            say(
                f"demo: {name} is down and cannot be brought up ({reason}); run ip link set {name} up; the demo "
                "continues without it"
            )
        else:
            return BusChoice("socketcan", name)
    if not virtual:
        try:
            make_vcan("vcan0")
        except OSError:  # no permission, or a kernel without vcan: the fallback below needs neither
            pass
        else:
            return BusChoice("socketcan", "vcan0")
    if named is not None and named.startswith("datagram:"):
        return BusChoice("datagram", named.removeprefix("datagram:"))
    return BusChoice("datagram", f"demo-{os.getpid()}")  # two demos must not receive each other's frames


MOST_TORQUE = 1.1  # N*m at the joint: within the model's domain at the pretension below
FADE_IN = 1.0  # s
MOTOR_INERTIA = 1e-4  # kg*m^2, the simulated motor's value; for a real motor, see its data sheet

NOMINAL = TendonSheath(
    motor_pulley_radius=0.020,
    joint_pulley_radius=0.025,
    axial_stiffness=60e3,
    unstrained_length=1.2,
    diameter=0.6e-3,
    contact_offset=0.4e-3,
    friction_coefficient=0.10,
    bending_angle=2.6,
    pretension=45.0,
    bending_centre=0.5,
    source="nominal.toml",
)
TRUTH = {"friction_coefficient": 1.08, "pretension": 0.95, "axial_stiffness": 0.93}  # true value / nominal value

Tables = dict[str, Any]


def plant(
    bus: BusChoice, tendon: str, axis: Mapping[str, Mapping[str, Any]] | None = None, load: str = "imposed"
) -> Tables:
    """Return the plant's configuration; `tendon` is the kind of tendon, `axis` changes or adds tables of the axis."""
    tables: Tables = {
        "name": "joint",
        "actuator": "nominal.toml",
        "perturbation": dict(TRUTH),
        "tendon": {"kind": tendon, "curvature": "uniform"},
        "joint": {"load": load},
        "motion": {"kind": "file", "file": "motion.csv", "repeat": True},
    }
    for name, values in (axis or {}).items():
        tables[name] = {**tables.get(name, {}), **values}
    return {
        "bus": {"interface": bus.interface, "channel": bus.channel},
        # The motion starts at the first enable, so that it is the same in every run.
        "physics": {"start": "first_enable", "priority": 90},
        "axis": [tables],
    }


def controller(
    bus: BusChoice, name: str, rate: float, model: str, compensation: float, estimator: Mapping[str, Any] | None = None
) -> Tables:
    """Return a controller's configuration for a loaded machine without real-time permissions.

    It tolerates stalls of 10 ms and more. `estimator` is the table [axis.estimator]; missing keys have their defaults.
    """
    law: Tables = {"compensation": compensation, "fade_in": FADE_IN}
    if compensation > 0.0:  # otherwise the command is tau_J* r_M/r_J, without a term for motor inertia
        law["motor_inertia"] = MOTOR_INERTIA
    return {
        "controller": {"name": "demo", "rate": rate, "settle_cycles": 20, "after_fault": "exit"},
        "bus": {
            "interface": bus.interface,
            "channel": bus.channel,
            "supervision": {"tolerated_misses": 50, "tolerated_drops": 50, "lost_share": 0.5},
        },
        "realtime": {"allow_without": True},
        "log": {"folder": "."},
        "socket": {"path": f"{name}.sock"},
        "axis": [
            {
                "name": "joint",
                "model": model,
                "drive": {
                    "node_id": 1,
                    "max_torque": 3.0,
                    "host_timeout": 0.5,
                    "rpdo_timeout": 0.2,
                    "heartbeat_timeout": 1.0,
                },
                "encoder": {"node_id": 32, "heartbeat_timeout": 1.0},
                "torque_sensor": {"node_id": 64, "heartbeat_timeout": 1.0},
                "setpoint": {"kind": "file", "file": "setpoint.csv", "loop": True},
                "law": law,
                "estimator": dict(estimator or {}),
                "limits": {"torque": 2.5},
            }
        ],
    }


def write(folder: Path, play: Play, plant_tables: Tables, controllers: Mapping[str, Tables]) -> None:
    """Write nominal model, set-point, motion, `plant.toml` and one `controller-NAME.toml` for each controller."""
    save_model(NOMINAL, folder / "nominal.toml")
    play.write_setpoint(folder / "setpoint.csv")
    play.write_motion(folder / "motion.csv")
    (folder / "plant.toml").write_text(tomlkit.dumps(plant_tables), encoding="utf-8")
    for name, tables in controllers.items():
        (folder / f"controller-{name}.toml").write_text(tomlkit.dumps(tables), encoding="utf-8")
