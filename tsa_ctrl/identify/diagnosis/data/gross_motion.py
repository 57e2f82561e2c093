"""Limit derived motion to the band to which the measured torque responds, because the friction of a sheath follows it.

An encoder may show motion at 50 Hz that is not noise, for example a motor that sticks and jumps. However, the friction
of the sheath reverses along its whole length, so at the joint it does not reverse at once when the motor jumps. A
smoother cannot detect this, because it only separates motion from noise. The band is therefore determined from the
torque. Friction that builds up over a displacement follows the derived angle, and the other parts of the torque are
fitted linearly. The band of the angle is halved until the residual grows. The best band is used if its residual is
smaller than with the data's own band, by more than the scatter between blocks of time explains. Otherwise the data are
not changed. Held-out samples do not count.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from tsa_ctrl.identify.diagnosis.criteria import BEYOND
from tsa_ctrl.identify.diagnosis.data.frame import Frame
from tsa_ctrl.identify.diagnosis.data.prepare import narrowed
from tsa_ctrl.identify.diagnosis.data.split import Split
from tsa_ctrl.model.effects.memory import PreslidingHysteresis
from tsa_ctrl.model.effects.search import geometric
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import Model, TendonSheath

# Number of presliding distances: their ratio is 1.34, so that the nearest one is off by 16 % and its friction by a
# tenth at most
DISTANCES = 24
SHORTEST, LONGEST = 0.0006, 0.5  # range of the presliding distances, as shares of half the range of an angle


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
    return dataclasses.replace(data, frame=frame) if float(np.mean(fallen)) > BEYOND * deviation else data


def _widest(frame: Frame) -> float:
    """Return the highest cut-off of a derived motion in Hz, or 0 if no motion is derived."""
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
    """Return the friction terms of (3.55): the state z, and z times the motor torque, on which friction may depend."""
    states = []
    for run in frame.runs:
        path = effect.path(run.signals)
        states.append(effect.state(run.signals.legs(path), effect.start(path, run.signals.t, run.signals.omega_j)))
    loaded = [z * run.signals.tau_m for z, run in zip(states, frame.runs, strict=True)]
    return frame.stack(states), frame.stack(loaded)
