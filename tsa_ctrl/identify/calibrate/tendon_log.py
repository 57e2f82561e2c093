"""Prepare a log for the tendon model of the observer, and predict elongation and joint torque of the log."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.model.curvature import centred
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.stretch import profile_of
from tsa_ctrl.observer import tendons
from tsa_ctrl.observer.stretch import pairs_of

FloatArray = NDArray[np.float64]

TURNED = 0.05  # permitted relative difference of the motion of both pulleys: their radii are known to a few per cent
AGAINST = -0.5  # correlation of elongation and motor torque that shows a wrong sign; correct signs yield about 0.9
JUMP = 5.0  # times the `OFTEN`th largest change between rows: no motion is this much faster only once
OFTEN = 10  # rows: a motion repeats its highest speed in every cycle, while a jump takes only one or two rows
LEAST = 0.2  # share of the elongation at the pretension: counts, backlash and noise are smaller
AROUND = 20  # rows on either side of a jump over which it must persist


@dataclass(frozen=True)
class TendonLog:
    """Columns of one log that the tendon model requires, (n,) each."""

    name: str
    tau_m: FloatArray
    acceleration: FloatArray  # rad/s^2, of the motor
    way: FloatArray  # m, travel of the joint pulley since the previous row
    stretch: FloatArray  # m
    tau_j: FloatArray | None
    period: float


def taken(log: Dataset, model: TendonSheath) -> TendonLog:
    """Return the columns that the tendon model requires.

    Raises:
        UsageError: columns contradict each other, or one is missing.
    """
    label = log.label or log.name
    q_m, q_j = log["q_m"], log["q_j"]
    r_m, r_j = model.motor_pulley_radius, model.joint_pulley_radius
    way = r_j * q_j
    stretch = r_m * q_m - way
    least = LEAST * model.pretension / model.tendon_stiffness
    jumped = jump(stretch, least)
    if jumped is not None:
        row, size = jumped
        raise UsageError(
            f"{label}: r_M q_M - r_J q_J of the columns q_m and q_j jumps by {size:.3g} m at {log['t'][row]:.4g} s: a "
            "pulley slipped, or an encoder lost counts or restarted; give the log up to there, or from there on"
        )
    if np.ptp(way) > 10.0 * model.pretension / model.tendon_stiffness:
        turned = float(np.polyfit(way, r_m * q_m, 1)[0])
        if abs(turned - 1.0) > TURNED:
            what = "one of them has the wrong sign" if turned < 0.0 else "counts per turn or a pulley's radius is wrong"
            raise UsageError(
                f"{label}: columns q_m and q_j contradict each other: r_M q_M makes {turned:.3g} times the way of "
                f"r_J q_J, which may be {1.0 - TURNED:g} to {1.0 + TURNED:g}; {what}"
            )
    torque = log["tau_m"]
    if np.ptp(stretch) > least and np.ptp(torque) > 0.0 and float(np.corrcoef(stretch, torque)[0, 1]) < AGAINST:
        raise UsageError(
            f"{label}: columns tau_m, q_m and q_j contradict each other: r_M q_M - r_J q_J falls where the motor's "
            "torque rises; tau_m, or both angles, have the wrong sign"
        )
    omega = log.columns.get("omega_m")
    if omega is None:
        omega = np.gradient(q_m, log.period)
    acceleration = np.diff(omega, prepend=omega[0]) / log.period
    return TendonLog(
        log.name,
        torque,
        acceleration,
        np.diff(way, prepend=way[0]),
        stretch,
        log.columns.get("tau_j"),
        log.period,
    )


def jump(stretch: FloatArray, least: float) -> tuple[int, float] | None:
    """Return row and size (m) of a lasting step of the zero, or None without one; `least`: size of the smallest, m."""
    steps = np.diff(stretch)
    if steps.size < 2 * AROUND:
        return None
    row = int(np.argmax(np.abs(steps)))
    often = float(np.partition(np.abs(steps), -OFTEN)[-OFTEN])
    before, after = stretch[max(0, row + 1 - AROUND) : row + 1], stretch[row + 1 : row + 1 + AROUND]
    lasts = abs(float(np.median(after) - np.median(before)))
    size = float(steps[row])
    return (row + 1, size) if abs(size) > max(least, JUMP * often) and lasts > 0.5 * abs(size) else None


def varied(model: TendonSheath, stiffer: float, centre: float, more: float) -> TendonSheath:
    """Return the model with another stiffness, centre of the bends and friction angle.

    Args:
        stiffer: logarithm of the factor of the stiffness.
        centre: centre of the bends, as a share of the length.
        more: logarithm of the factor of the friction angle.
    """
    factor = math.exp(stiffer)
    profile = profile_of(model)
    series = model.series_stiffness
    changed = dataclasses.replace(
        model.recalibrated(model.friction_angle * math.exp(more)),
        axial_stiffness=factor * model.axial_stiffness,
        series_stiffness=None if series is None else factor * series,
    )
    if abs(centre - profile.centre) < 1e-9:
        return changed
    if "elongation_coupling" in model.effects:
        points = centred(profile, centre).points
        return changed.with_effects({**model.effects, "elongation_coupling": {"curvature_profile": points}})
    return dataclasses.replace(changed, bending_centre=centre)


def foretold(
    log: TendonLog, model: TendonSheath, motor_inertia: float
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return the predicted elongation (m) and joint torque (N*m) without their zeros, (n,) each, and a mask (n,).

    The mask is True at samples after both tendons have slid along their whole length, if the torque is finite there.
    """
    pair = pairs_of(model)[0].copy()
    tendons.grip(pair, model.friction_angle)
    difference = (log.tau_m - motor_inertia * log.acceleration) / model.motor_pulley_radius
    stretch, end, slid = tendons.follow(pair, difference, log.way)
    return stretch, model.joint_pulley_radius * end, (slid > 0.0) & np.isfinite(end)
