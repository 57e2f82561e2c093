"""The motion that friction in a sheath follows: the band of it to which the measured torque answers.

An encoder may show motion at 50 Hz that is not noise: a motor that sticks and jumps. But the sheath's friction turns
over along its whole length, and at the joint it does not turn at once when the motor jumps. A smoother cannot detect
this, because it looks for motion. So the torque is asked: friction that builds up over a displacement, with the rest
of
the torque fitted linearly, follows the derived angle in a band narrower by an octave at a time, until the residual
grows. That band is taken if it leaves less than the data's own one, in more blocks of time than by chance; if friction
follows the sharp motion, or does not show it, the data stay. Held-out samples do not count.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from tsa_ctrl.identify.diagnosis.data.frame import Frame
from tsa_ctrl.identify.diagnosis.data.prepare import narrowed
from tsa_ctrl.identify.diagnosis.data.split import Split
from tsa_ctrl.model.effects.memory import PreslidingHysteresis
from tsa_ctrl.model.effects.search import geometric
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import Model, TendonSheath

SURE = 3.0  # t of 23 degrees of freedom: 0.3 % by chance; of 17 blind logs without such friction the largest had 1.9
DISTANCES = 24  # of presliding: 1.34 apart, so that the nearest is off by 16 %, and its friction by a tenth, at most
SHORTEST, LONGEST = 0.0006, 0.5  # of half the range of an angle: the distances that presliding is looked for at


def along_gross_motion(data: Split, model: Model) -> Split:
    """Return the same samples with derived angles and velocities limited to the band to which the torque responds.

    The motion of a plain drive is not changed, because its friction acts at the encoder. A recorded velocity is not
    changed either.
    """
    frame = data.frame
    band = _widest(frame)
    if not isinstance(model, TendonSheath) or band <= 0.0 or len(np.unique(frame.blocks[frame.train])) < 2:
        return data
    own = best = _left(frame)
    while True:
        band *= 0.5
        slower = dataclasses.replace(frame, runs=tuple(narrowed(run, band) for run in frame.runs))
        left = _left(slower)
        if not float(np.mean(np.log(best / left))) > 0.0:
            break
        frame, best = slower, left
    fallen = np.log(own / best)
    deviation = float(np.std(fallen, ddof=1)) / math.sqrt(len(fallen))
    return dataclasses.replace(data, frame=frame) if float(np.mean(fallen)) > SURE * deviation else data


def _widest(frame: Frame) -> float:
    """Hz, the highest cut-off of a derived motion; 0 where none is."""
    cutoffs = [0.0]
    for run in frame.runs:
        for angle, velocity in (("q_j", "omega_j"), ("q_m", "omega_m")):
            low_pass = run.raw.motion.smoothed(angle).smooth if velocity in run.raw.derived else None
            cutoffs.append(0.0 if low_pass is None else low_pass.cutoff)
    return max(cutoffs)


def _left(frame: Frame) -> Array:
    """Return the mean square of the torque residual with the best presliding in each block, (N*m)^2."""
    used = frame.train
    blocks = np.unique(frame.blocks[used], return_inverse=True)[1]
    target = frame.target[used]
    always = [
        np.ones(len(frame)),
        frame.column("tau_m"),
        frame.stack([np.abs(run.signals.tau_m) for run in frame.runs]),
    ]
    always.append(frame.stack([run.angle for run in frame.runs]))  # a spring

    best, least = np.ones(1), math.inf
    for effect in _presliding(frame):
        columns = np.column_stack([*always, *_friction(frame, effect)])[used]
        rest = target - columns @ np.linalg.lstsq(columns, target, rcond=None)[0]
        if (whole := float(rest @ rest)) < least:
            best, least = np.bincount(blocks, rest**2) / np.bincount(blocks), whole
    return np.asarray(np.maximum(best, np.finfo(np.float64).tiny))


def _presliding(frame: Frame) -> list[PreslidingHysteresis]:
    """Return presliding effects with trial distances along each angle that every run has."""
    out = []
    for name, follows in (("q_m", "motor"), ("q_j", "joint")):
        if frame.has(name):
            reach = max(0.5 * float(np.ptp(getattr(run.signals, name))) for run in frame.runs)
            out += [
                PreslidingHysteresis(d, 1, follows) for d in geometric(SHORTEST * reach, LONGEST * reach, DISTANCES)
            ]
    return out


def _friction(frame: Frame, effect: PreslidingHysteresis) -> tuple[Array, Array]:
    """Return the friction terms of (3.55): the state z, and z times the motor torque, as friction may depend on it."""
    states = []
    for run in frame.runs:
        path = effect.path(run.signals)
        states.append(effect.state(run.signals.legs(path), effect.start(path, run.signals.t, run.signals.omega_j)))
    loaded = [z * run.signals.tau_m for z, run in zip(states, frame.runs, strict=True)]
    return frame.stack(states), frame.stack(loaded)
