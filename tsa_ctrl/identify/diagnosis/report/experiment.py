"""Propose the next experiment: the motion that would resolve the open questions, in words and as a set-point file.

The actuator follows a joint torque, and the motion depends on the load at the joint. The set-point file can therefore
vary only the torque: the speed of its reversals, its level, its sign and its rests. The words describe the changes that
a person must make in addition.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence

import numpy as np

from tsa_ctrl.identify.diagnosis.data.audit import Audit
from tsa_ctrl.identify.diagnosis.report.result import Cause, Experiment, Verdict
from tsa_ctrl.model.catalogue import CATALOGUE, SENSOR_ERROR
from tsa_ctrl.model.effects.specification import Kind, Motion
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import Model, TendonSheath

PERIOD = 0.01  # s between two rows of a set-point file
FREQUENCIES = (0.1, 0.25, 0.6, 1.5)  # Hz, frequencies of the reversals: they cover slow and fast motion
LEVELS = (0.25, 0.5, 1.0)  # relative to the RMS torque in the logs, which the actuator has already delivered
CYCLES = 3  # cycles at each frequency and level: enough to repeat each reversal
LONGEST = 12.0  # s, longest time at one frequency and level: it limits the length of the file
REPEAT = "repeat the very same motion ten times, so that the noise floor is measured and not estimated"
ELSEWHERE = "other speeds, loads and angles than in these logs: a formula that also holds there is a law of the drive"
# Four in each direction: with fewer, a difference between the directions cannot be distinguished from scatter
FEWEST_REVERSALS = 8


def advice(
    model: Model,
    verdict: Verdict,
    causes: Sequence[Cause],
    found: Audit,
    not_testable: Mapping[str, str],
    torque: float,
    formula: bool = False,
) -> Experiment:
    """Return the next experiment: the motion that separates most of the alternatives, with a set-point.

    If no cause has an alternative, an unexplained residual requires a repetition, or other operating points if a
    formula describes it. Otherwise the experiment is the motion that the logs lack.

    Args:
        model: the nominal model.
        verdict: verdict of the diagnosis.
        causes: identified causes.
        found: audit of the logs.
        not_testable: effects that the logs cannot test, with the reason.
        torque: RMS of the change of the measured torque, N*m.
        formula: True if a formula describes the residual.
    """
    pairs = [pair for cause in causes for pair in itertools.combinations((cause.effect, *cause.alternatives), 2)]
    if pairs:
        motion, parted = _parting_most(pairs)
        told = " or ".join(dict.fromkeys(name.replace("_", " ") for pair in parted for name in pair))
        text = f"{motion.value}: this would separate {told}"
    elif verdict in (Verdict.UNEXPLAINED, Verdict.PARTLY_EXPLAINED):
        text = ELSEWHERE if formula else REPEAT
    else:
        text = _gap(found, not_testable, model.kind)
    return _playable(text, _setpoint(torque))


def first_motion(model: Model) -> Experiment:
    """Return the experiment for logs that determine nothing.

    The RMS torque of the set-point is half the friction torque of the model file. A model without tendons or without
    friction gets no set-point.
    """
    text = "reversals at 0.1, 0.5 and 2 rad/s over the whole range, under torques of both signs, for a minute"
    if not isinstance(model, TendonSheath):
        return Experiment(text)
    friction = 2.0 * model.pretension * model.joint_pulley_radius * math.sinh(model.friction_angle)
    return _playable(text, _setpoint(0.5 * friction)) if friction > 0.0 else Experiment(text)


def _playable(text: str, torque: Array) -> Experiment:
    t = np.arange(len(torque)) * PERIOD
    return Experiment(text, tuple(t.tolist()), tuple(torque.tolist()))


def _parting_most(pairs: Sequence[tuple[str, str]]) -> tuple[Motion, list[tuple[str, str]]]:
    """Return the motion that separates most of these pairs, and the pairs that it separates.

    Of several equally good motions, the least costly one is returned.
    """
    parted = {motion: [pair for pair in pairs if motion in _parting(*pair)] for motion in Motion}
    return max(parted.items(), key=lambda entry: len(entry[1]))  # the members are in the order of cost


def parted_by(names: Sequence[str]) -> list[str]:
    """Return the motions that separate the pairs of a group, each motion once, as text."""
    pairs = itertools.combinations(names, 2)
    return list(dict.fromkeys(motion.value for first, second in pairs for motion in _parting(first, second)))


def _parting(first: str, second: str) -> tuple[Motion, ...]:
    """Return the motions that separate two effects, as listed in the catalogue for one of them.

    An error of the torque sensor follows the sign of the torque, not the direction. For any other pair without an
    entry, two motions that separate most pairs are returned.
    """
    if SENSOR_ERROR in (first, second):
        return (Motion.SIGNS,)
    for name, other in ((first, second), (second, first)):
        if name in CATALOGUE and (motions := CATALOGUE[name].parted_from(other)):
            return motions
    return Motion.SPEEDS, Motion.SIGNS


def _gap(found: Audit, not_testable: Mapping[str, str], kind: Kind) -> str:
    """Return the motion that the logs lack.

    This is the second direction, reversals, or the second sign of the load. If the logs have all of these, it is the
    motion that most of the untestable effects require.
    """
    if not found.both_directions:
        return "move in both directions"
    if found.reversals < FEWEST_REVERSALS:
        return Motion.SPEEDS.value
    if kind is not Kind.RIGID_DRIVE and not _both_signs(found):
        return Motion.SIGNS.value
    specs = [CATALOGUE[name] for name in not_testable]
    asked = [spec.asks for spec in specs if spec.asks and kind in spec.kinds]
    return max(Motion, key=asked.count).value if asked else Motion.SPEEDS.value


def _both_signs(found: Audit) -> bool:
    by_load = found.occupancy.sum(axis=0)
    middle = len(by_load) // 2
    return min(float(by_load[:middle].sum()), float(by_load[middle:].sum())) > 0.05


def _setpoint(torque: float) -> Array:
    """Return a joint torque, (n,) in N*m: sinusoids of both signs at several frequencies and levels.

    torque: RMS at the highest level, N*m. A rest follows each level.
    """
    pieces = [np.zeros(round(1.0 / PERIOD))]
    for level in LEVELS:
        for frequency in FREQUENCIES:
            seconds = min(CYCLES / frequency, LONGEST)
            cycles = max(1, round(seconds * frequency))
            t = np.arange(0.0, cycles / frequency, PERIOD)
            pieces.append(np.sqrt(2.0) * torque * level * np.sin(2.0 * np.pi * frequency * t))
        pieces.append(np.zeros(round(0.5 / PERIOD)))
    return np.concatenate(pieces)
