"""Test sign and gain on a locked joint: apply a small torque in both directions, and compare it with a sensor.

The joint is locked, so that the tendons slide only by their elongation. Once the motor torque is more than twice the
friction torque h away from a reversal, they slide along their whole length. The joint torque is then a straight line in
the motor torque:

    tau_J = g a tau_M - sigma b + c                 a: slope of the model, (3.53); g: the gain, 1 if everything is right

Load cells at the motor show g without the sheath: r_M (T3 - T1) = g tau_M.
"""

from __future__ import annotations

import dataclasses
import datetime
import math
import tempfile
from collections.abc import Callable, Mapping

import msgspec
import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.config import AxisSettings, Configuration
from tsa_ctrl.control.settings import SetPointSettings
from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.log.table import read_table
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.steady_sliding import sliding
from tsa_ctrl.readiness import Nodes, SignAndGain
from tsa_ctrl.safety.use_class import on_bench

Columns = Mapping[str, NDArray[np.float64]]
Say = Callable[[str], None]

NAMES = frozenset({"t", "tau_m", "tau_j", "tau_j_des", "tau_m_cmd", "q_j", "t1", "t3"})  # columns of a log
TOLERANCE = 0.1  # 1, allowed deviation of the gain
FREQUENCY = 0.25  # Hz, of the torque; slow enough that inertia and delays are negligible
SECONDS = 9.0  # s of torque: two periods
AMPLITUDE, LEAST = 2.5, 1.6  # multiples of the friction torque: the amplitude, and its minimum for a clear line
SLIDING = 2.2  # multiples of the friction torque since a reversal, above which the whole tendon slides
SHARE = 0.1  # share of the rated torque: the amplitude for tendons without friction
MOVED = 0.05  # rad by which a locked joint may move
CLEAR = 0.98  # minimum share of the variance that the line explains


def run_held(configuration: Configuration, say: Say = lambda line: None) -> tuple[dict[str, SignAndGain], Nodes]:
    """Run the test on the rig; return the result of each axis, and the nodes on the bus.

    Raises:
        BusError: the run failed, or sign or gain is wrong.
    """
    from tsa_ctrl.daemon.run import run

    with tempfile.TemporaryDirectory(prefix="tsa-held-") as folder:
        summary = run(held_configuration(configuration, folder), SECONDS, say, reset_faults=True)
        if summary.failed or summary.log is None:
            fault = next((event.text for event in summary.events if event.fault), summary.cause)
            raise BusError(f"the run on the held joint failed: {fault}; correct that, and start again")
        pairs = zip(configuration.file.axes, configuration.models, strict=True)
        found = {
            axis.name: sign_and_gain(axis.name, read_table(f"{summary.log}:{axis.name}", NAMES).columns, model)
            for axis, model in pairs
        }
    return found, summary.joints


def held_configuration(configuration: Configuration, folder: str) -> Configuration:
    """Return the configuration with a sine of torque at each motor, no compensation, and log and socket in `folder`.

    Raises:
        UsageError: limits.torque does not overcome the friction of the tendons.
    """
    replace = msgspec.structs.replace
    file = configuration.file
    pairs = zip(file.axes, configuration.models, strict=True)
    axes = tuple(_pulling(configuration, axis, model) for axis, model in pairs)
    changed = replace(
        file,
        axes=axes,
        controller=replace(file.controller, after_fault="exit"),
        log=replace(file.log, enabled=True, folder=folder),
        socket=replace(file.socket, path=f"{folder}/tsa.sock", group=None),
        safety=on_bench(file.safety),
    )
    return dataclasses.replace(configuration, file=changed)


def amplitude(configuration: Configuration, axis: AxisSettings, model: TendonSheath) -> float:
    """Return the amplitude of the motor torque for the test, N*m; raise UsageError if the limits are too low."""
    friction = abs(sliding(model).motor_half_loop)
    rated = axis.drive.rated_torque * axis.drive.gear_ratio
    most = min(axis.limits.torque, 2.0 * model.pretension * model.motor_pulley_radius)  # above it a tendon is slack
    if most < LEAST * friction:
        raise UsageError(
            f"{configuration.path}: axis '{axis.name}': the test on the held joint needs {LEAST * friction:.3g} N*m at "
            f"the motor to overcome the friction of the tendons, limits.torque and pretension allow {most:.3g} N*m; "
            "raise limits.torque or the pretension"
        )
    return min(most, max(AMPLITUDE * friction, SHARE * rated))


def _pulling(configuration: Configuration, axis: AxisSettings, model: TendonSheath) -> AxisSettings:
    replace = msgspec.structs.replace
    at_joint = amplitude(configuration, axis, model) * model.joint_pulley_radius / model.motor_pulley_radius
    return replace(
        axis,
        setpoint=SetPointSettings(kind="sine", amplitude=at_joint, frequency=FREQUENCY),
        law=replace(axis.law, compensation=0.0),
        estimator=replace(axis.estimator, use=False),
    )


def sign_and_gain(name: str, columns: Columns, model: TendonSheath) -> SignAndGain:
    """Return sign and gain of one axis from its log.

    Args:
        name: name of the axis.
        columns: columns `NAMES` of its log.
        model: model of the axis.

    Raises:
        BusError: sign or gain is wrong, or the log does not show them.
    """
    on = columns["tau_m_cmd"] != 0.0
    tau_m = columns["tau_m"][on]
    moved = _range(columns.get("q_j"), on)
    if moved > MOVED:
        raise BusError(
            f"axis '{name}': the joint moved by {moved:.3g} rad; hold it within {MOVED:g} rad, and start again"
        )
    tau_j = columns.get("tau_j")
    if tau_j is not None and np.isfinite(tau_j[on]).mean() > CLEAR:
        sensor = "joint torque sensor"
        measured, slope = tau_j[on], 0.5 * (sliding(model, 1.0).slope + sliding(model, -1.0).slope)
        friction = abs(sliding(model).motor_half_loop)
    elif all(name in columns and np.isfinite(columns[name][on]).mean() > CLEAR for name in ("t1", "t3")):
        sensor = "load cells"
        measured, slope, friction = model.motor_pulley_radius * (columns["t3"] - columns["t1"])[on], 1.0, 0.0
    else:
        raise BusError(f"axis '{name}': neither joint torque sensor nor load cells t1 and t3 sent values; check them")
    gain, clear = _line(tau_m, measured, np.gradient(columns["tau_j_des"][on]), SLIDING * friction)
    gain /= slope
    if clear < CLEAR:
        raise BusError(
            f"axis '{name}': the {sensor} follows the motor torque only by {100.0 * max(0.0, clear):.0f} %, at least "
            f"{100.0 * CLEAR:.0f} % are required; hold the joint fast, and check the sensor and the pretension"
        )
    if gain < 0.0:
        raise BusError(
            f"axis '{name}': the {sensor} shows the opposite sign of the motor torque (gain {gain:.2f}); correct its "
            "sign, or torque_sign and position_sign of the drive"
        )
    if abs(gain - 1.0) > TOLERANCE:
        raise BusError(
            f"axis '{name}': the {sensor} shows {gain:.2f} times the torque of the model, allowed are "
            f"{1.0 - TOLERANCE:g} to {1.0 + TOLERANCE:g}; check the gain of the sensor, the torque constant and rated "
            "torque of the motor, and the pulley radii"
        )
    now = datetime.datetime.now().astimezone().isoformat(timespec="seconds")
    return SignAndGain(date=now, gain=round(gain, 4), sensor=sensor)


def _line(
    tau_m: NDArray[np.float64], measured: NDArray[np.float64], slope: NDArray[np.float64], since: float
) -> tuple[float, float]:
    """Return the slope of `measured` over `tau_m`, and the share of the variance that the line explains.

    Only samples are used whose motor torque is at least `since` N*m away from its last reversal.
    """
    way = np.where(slope >= 0.0, 1.0, -1.0)
    begins = np.concatenate(([0], np.flatnonzero(np.diff(way)) + 1))
    last = np.repeat(tau_m[begins], np.diff(np.append(begins, tau_m.size)))
    reversed_once = np.arange(tau_m.size) >= (begins[1] if begins.size > 1 else tau_m.size)
    chosen = (np.abs(tau_m - last) >= since) & np.isfinite(measured) & reversed_once
    if np.count_nonzero(chosen) < 100 or np.ptp(tau_m[chosen]) == 0.0:
        return math.nan, 0.0
    a = np.column_stack([tau_m, way, np.ones_like(tau_m)])[chosen]
    y = measured[chosen]
    solution = np.linalg.lstsq(a, y, rcond=None)[0]
    total = float(np.var(y))
    return float(solution[0]), 1.0 - float(np.var(y - a @ solution)) / total if total > 0.0 else 0.0


def _range(values: NDArray[np.float64] | None, on: NDArray[np.bool_]) -> float:
    if values is None or not np.isfinite(values[on]).any():
        return 0.0
    return float(np.nanmax(values[on]) - np.nanmin(values[on]))
