"""The next experiment: which motion would settle what these logs leave open, in words and as a set-point file.

The actuator follows a joint torque; the motion comes from what the joint is connected to. So the file sweeps what a
torque can sweep (speed of reversals, level, sign, rest), and the words say what a person must change beside it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from tsa_ctrl.identify.diagnosis.data.audit import Audit
from tsa_ctrl.identify.diagnosis.report.result import Cause, Experiment, Verdict
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import Model, RigidDrive

PERIOD = 0.01  # s between two rows of a set-point file
FREQUENCIES = (0.1, 0.25, 0.6, 1.5)  # Hz, of the reversals
LEVELS = (0.25, 0.5, 1.0)  # of the torque seen in the logs
CYCLES = 3  # at each frequency and level
LONGEST = 12.0  # s at one frequency and level

_SPEEDS = "reversals at several speeds (0.1 to 2 rad/s) over the same range"
_BENDING = "repeat the same motion at two or more known bending angles (column theta) or known pretensions"
_GAIN = "hang a known weight on the joint and hold it, to certify the torque's gain"
_SIGNS = "load the joint with torques of both signs and of several levels"
_RANGE = "move over the whole range of the joint"
_WARM = "heat and cool the drive while it moves, and log its temperature"

# What parts two effects; the pairs are those of the catalogue's table of twins.
_PARTS: Sequence[tuple[frozenset[str], tuple[str, ...]]] = (
    (
        frozenset({"transport_delay", "presliding_hysteresis", "velocity_lag", "backlash", "stribeck_friction"}),
        (_SPEEDS,),
    ),
    (
        frozenset({"viscous_friction", "direction_asymmetric_friction", "sheath_asymmetry"}),
        (f"{_SPEEDS}, in both directions",),
    ),
    (frozenset({"direction_asymmetric_friction", "torque_offset"}), (f"{_SPEEDS}, in both directions",)),
    (frozenset({"viscous_friction", "motor_side_friction", "parameter_error", "stribeck_friction"}), (_SPEEDS,)),
    (
        frozenset({"load_dependent_friction", "sheath_asymmetry", "tendon_slack", "tension_dependent_friction"}),
        (_SIGNS,),
    ),
    (frozenset({"thermal_friction_drift", "pretension_relaxation"}), (_WARM,)),
    (frozenset({"gravity_load", "joint_stiffness", "torque_offset", "configuration_dependent_bending"}), (_RANGE,)),
    (frozenset({"inertia", "joint_stiffness", "gravity_load"}), (f"{_RANGE}, at two frequencies of motion at least",)),
    (
        frozenset({"elongation_coupling", "torque_constant_error", "tension_dependent_friction"}),
        (_BENDING, _GAIN),
    ),
    (frozenset({"torque_constant_error", "parameter_error"}), (_GAIN,)),
    (
        frozenset({"motor_side_friction", "stiffness_nonlinearity", "parameter_error", "pretension_relaxation"}),
        (_BENDING,),
    ),
)


def advice(
    model: Model,
    verdict: Verdict,
    causes: Sequence[Cause],
    found: Audit,
    not_testable: Mapping[str, str],
    torque: float,
) -> Experiment:
    """What to record next, always with a set-point that excites what a torque can excite.

    torque: RMS of the measured torque's change, N*m.
    """
    groups = [(cause.effect, *cause.alternatives) for cause in causes if cause.alternatives]
    wanted = [text for group in groups for text in parted_by(group)]
    if verdict in (Verdict.UNEXPLAINED, Verdict.PARTLY_EXPLAINED):
        wanted.append("repeat the very same motion ten times, so that the noise floor is measured and not estimated")
    if not wanted:
        wanted = _gaps(found, not_testable, rigid=isinstance(model, RigidDrive))
    what = "; ".join(
        text for text in dict.fromkeys(wanted) if not any(text in other for other in wanted if other != text)
    )
    told = " or ".join(dict.fromkeys(name.replace("_", " ") for group in groups for name in group))
    text = f"{what}: this would tell {told}" if groups else what
    return _playable(text, _setpoint(torque))


def first_motion(model: Model) -> Experiment:
    """What to record when the logs tell nothing, under torques as large as the model file's friction."""
    text = "reversals at 0.1, 0.5 and 2 rad/s over the whole range, under torques of both signs, for a minute"
    if isinstance(model, RigidDrive):
        return Experiment(text)
    friction = 2.0 * model.pretension * model.joint_pulley_radius * math.sinh(model.friction_angle)
    return _playable(text, _setpoint(0.5 * friction)) if friction > 0.0 else Experiment(text)


def _playable(text: str, torque: Array) -> Experiment:
    t = np.arange(len(torque)) * PERIOD
    return Experiment(text, tuple(t.tolist()), tuple(torque.tolist()))


def parted_by(names: Sequence[str]) -> list[str]:
    """What parts each pair of a group."""
    out: list[str] = []
    for i, first in enumerate(names):
        for second in names[i + 1 :]:
            texts = [text for members, text in _PARTS if {first, second} <= members]
            out += texts[0] if texts else (_SPEEDS, _SIGNS)
    return list(dict.fromkeys(out))


def _gaps(found: Audit, not_testable: Mapping[str, str], rigid: bool) -> list[str]:
    """What the logs do not excite."""
    wanted = []
    if not found.both_directions:
        wanted.append("move in both directions")
    if found.reversals < 8:
        wanted.append(_SPEEDS)
    if not rigid and not _both_signs(found):
        wanted.append(_SIGNS)
    if "thermal_friction_drift" in not_testable:
        wanted.append(_WARM)
    if not rigid and "stiffness_nonlinearity" in not_testable:
        wanted.append(_BENDING)
    return wanted or [_SPEEDS]


def _both_signs(found: Audit) -> bool:
    by_load = found.occupancy.sum(axis=0)
    middle = len(by_load) // 2
    return min(float(by_load[:middle].sum()), float(by_load[middle:].sum())) > 0.05


def _setpoint(torque: float) -> Array:
    """Reversals of the joint torque (N*m) at several speeds and levels, about both signs, with rests between."""
    pieces = [np.zeros(round(1.0 / PERIOD))]
    for level in LEVELS:
        for frequency in FREQUENCIES:
            seconds = min(CYCLES / frequency, LONGEST)
            cycles = max(1, round(seconds * frequency))
            t = np.arange(0.0, cycles / frequency, PERIOD)
            pieces.append(np.sqrt(2.0) * torque * level * np.sin(2.0 * np.pi * frequency * t))
        pieces.append(np.zeros(round(0.5 / PERIOD)))
    return np.concatenate(pieces)
