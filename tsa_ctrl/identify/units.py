"""Reject logs in wrong units, such as milliseconds, newton-millimetres, degrees or kelvin.

Each check rejects a log only if no drive of this kind could have produced its numbers. The limits exceed real values by
a factor of ten or more. Comparing two columns, such as an angle and its velocity, is more sensitive than any limit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.signals import JOINT_ANGLE

Array = NDArray[np.float64]

FASTEST = 50e3  # Hz, sampling rate: a faster log has its time in the wrong unit
SLOWEST = 2.0  # Hz: a log at 1 or 2 kHz appears this slow or slower if its time is in ms
SLOW = 12.0  # Hz: a log at 10 kHz appears this slow if its time is in ms, but steady motion may be logged at this rate
LONGEST_SLOW = 3000.0  # s: a usable log of 3 s appears this long or longer if its time is in ms
LARGEST: dict[str, tuple[float, str, str]] = {  # absolute limit, unit, probable reason of a larger value
    **dict.fromkeys(("tau_m", "tau_j", "tau_j_des", "tau_m_cmd"), (500.0, "N*m", "N*mm, N*cm or kgf*cm")),
    "omega_m": (3000.0, "rad/s", "degrees per second or rpm"),
    "theta": (50.0, "rad", "degrees"),
    "t1": (2e4, "N", "mN"),
    "t3": (2e4, "N", "mN"),
    "temperature": (200.0, "degC", "kelvin"),
}
# Limit for joints that tendons move; a joint behind a gear may turn faster
FASTEST_JOINT: Mapping[str, tuple[float, str, str]] = {"omega_j": (100.0, "rad/s", "degrees per second or rpm")}
WIDEST_SWING = 20.0  # rad: if a joint moves back and forth over a larger range, its angle is in degrees
WIDEST_BEND = 2.0 * np.pi  # rad, the same of a joint that may bend the sheath: no limb turns once around
INVERSE = 0.05  # relative distance from 1 / ratio below which the two ends' columns count as swapped
TORQUES = (  # number of units in one N*m
    (1000.0, "N*mm, mN*m or per mille of the rated torque"),
    (141.6, "ozf*in"),
    (100.0, "N*cm"),
    (10.197, "kgf*cm"),
    (8.851, "lbf*in"),
    (0.10197, "kgf*m"),
)
# Largest and smallest ratio of two torques relative to the ratio of the pulleys; the largest one is cosh of a friction
# angle of 1.3
CAPSTAN, ATTENUATED = 2.0, 0.8
MOST_GAIN = 50.0  # largest ratio of two torques relative to that of the pulleys, with friction and wrong calibration


def check_rate(label: str, period: float, seconds: float, strict: bool = False) -> None:
    """Raise UsageError if the sampling period (s) of a log of `seconds` (s) cannot be right.

    `strict`: True to reject slow sampling as well.
    """
    rate = 1.0 / period
    slow = rate < SLOW and (strict or seconds > LONGEST_SLOW)
    if SLOWEST <= rate <= FASTEST and not slow:
        return
    hint = "milliseconds or microseconds" if rate < SLOW else "minutes or hours"
    least = SLOW if slow and rate >= SLOWEST else SLOWEST
    where = "" if least == SLOWEST or strict else f" of a log of {seconds:.4g} s"
    cut = "" if not where else f", or cut the log into pieces of {LONGEST_SLOW:g} s if it is right"
    raise UsageError(
        f"{label}: column t has a step of {period:g} s ({rate:g} Hz), which cannot be right{where} (allowed are "
        f"{least:g} to {FASTEST:g} Hz); t seems to be in {hint}: convert it to s{cut}"
    )


def check_sizes(
    label: str,
    columns: Mapping[str, Array],
    place: Callable[[int], str],
    largest: Mapping[str, tuple[float, str, str]] = LARGEST,
) -> None:
    """Raise UsageError if a value exceeds the limit of its column; `place` names the row of the largest value."""
    for name, (limit, unit, hint) in largest.items():
        if name not in columns:
            continue
        row = int(np.argmax(np.abs(columns[name])))
        value = float(columns[name][row])
        if abs(value) > limit:
            raise UsageError(
                f"{label}: column {name}, {place(row)}: {value:g} {unit} cannot be right (allowed are up "
                f"to {limit:g}); it seems to be in {hint}: convert it to {unit}"
            )


def check_joint(label: str, columns: Mapping[str, Array]) -> None:
    """Raise UsageError if a joint moves faster or further than tendons can move it, or bend with it."""
    check_sizes(label, columns, lambda row: f"t = {columns['t'][row]:.6g} s", FASTEST_JOINT)
    widest = {name: WIDEST_BEND for name in columns if name.startswith(JOINT_ANGLE)}
    if "omega_j" not in columns or float(np.max(np.abs(columns["omega_j"]))) > WIDEST_SWING:
        widest["q_j"] = WIDEST_SWING
    for name, most in widest.items():
        q = columns.get(name)
        swing = 0.0 if q is None else float(np.ptp(q))
        if q is not None and swing > most and float(np.sum(np.abs(np.diff(q)))) > 1.5 * swing:
            raise UsageError(
                f"{label}: column {name} swings over {swing:.4g} rad, back and forth, which cannot be right (allowed "
                f"is up to {most:.3g}); it seems to be in degrees: convert it to rad"
            )


def in_other_units(low: float, high: float) -> str:
    """Return the units in which a number is between `low` and `high` times too large, with their factors."""
    fitting = [f"{unit} (a factor of {factor:.4g})" for factor, unit in TORQUES if low <= factor <= high]
    return "in " + " or ".join(fitting) if fitting else f"too large by a factor of {low:.3g} or more"


def check_ratios(
    label: str, columns: Mapping[str, Array], motor_pulley_radius: float, joint_pulley_radius: float
) -> None:
    """Raise UsageError if the two ends of the transmission disagree by more than their pulleys can explain.

    Radii are in m. Ends that do not move or change together are not checked.
    """
    ratio = joint_pulley_radius / motor_pulley_radius
    if "tau_j" in columns:
        sigma = np.sign(columns["omega_j"])  # friction shifts the torques by direction and hides their ratio
        slope = _slope(_levelled(columns["tau_m"], sigma), _levelled(columns["tau_j"], sigma))
        if slope is not None and not 1.0 / MOST_GAIN < abs(slope) / ratio < MOST_GAIN:
            over = abs(slope) / ratio
            name, unit = (
                ("tau_j", in_other_units(over / CAPSTAN, over / ATTENUATED))
                if over > 1.0
                else ("tau_m", in_other_units(ATTENUATED / over, CAPSTAN / over))
            )
            raise UsageError(
                f"{label}: column tau_j is {slope:.3g} times tau_m where the pulleys give {ratio:.3g}, which cannot be "
                f"right; {name} seems to be {unit}: convert it to N*m"
            )
    for motor, joint in (("q_m", "q_j"), ("omega_m", "omega_j")):
        if motor in columns and joint in columns:
            slope = _slope(_levelled(columns[joint]), _levelled(columns[motor]))
            if slope is not None and not 0.8 < ratio**2 < 1.25 and abs(slope * ratio - 1.0) < INVERSE:
                raise UsageError(
                    f"{label}: column {motor} is {slope:.3g} times {joint} where the pulleys give {ratio:.3g}; {motor} "
                    f"and {joint} seem to be swapped, or the radii in the model file: exchange them"
                )


def _levelled(values: Array, sigma: Array | None = None) -> Array:
    """Return `values` minus their mean, separately for each direction."""
    if sigma is None:
        return values - np.mean(values)
    level = np.zeros_like(values)
    for direction in (-1.0, 0.0, 1.0):
        here = sigma == direction
        if here.any():
            level[here] = np.mean(values[here])
    return values - level


def _slope(x: Array, y: Array) -> float | None:
    """Return the least-squares slope of y over x; None if the two are not the same motion."""
    xx, yy, xy = float(x @ x), float(y @ y), float(x @ y)
    if xx == 0.0 or yy == 0.0 or xy * xy < 0.8 * xx * yy:
        return None
    return xy / xx
