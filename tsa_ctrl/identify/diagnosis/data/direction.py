"""Estimate the direction of slow motion, a hidden state, from the torque where noise hides the velocity's sign.

The two states, forward and backward, change rarely. The evidence at each moment is the velocity, and the torque
compared with a linear fit to the certain samples. A forward and a backward sweep compute the probability of the
direction from the whole log. Only intervals in which the velocity alone is undecided for long are changed.

If the odds are large and the torque fits the direction, it counts as known. The reversals themselves are an exception:
they were placed by the torque and do not show its delay. Held-out errors omit all these intervals. If the torque fits
neither direction, friction is somewhere within its band, and the direction remains unknown. A plain drive at rest is
always in this state, and so is a joint whose tendons stick. These intervals are neither fitted nor counted.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from tsa_ctrl.identify.diagnosis.criteria import CERTAIN, FEWEST, REVERSAL, VELOCITY_BAND
from tsa_ctrl.identify.diagnosis.data.frame import Frame, Run
from tsa_ctrl.identify.diagnosis.data.split import Split
from tsa_ctrl.identify.three_errors import UNKNOWN
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import Model, RigidDrive
from tsa_ctrl.model.signals import hold_direction

Mask = NDArray[np.bool_]


def intervals(mask: Mask) -> Iterator[tuple[int, int]]:
    """Yield the first index and the end of each run of True in `mask`, (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def long(mask: Mask, least: int) -> Mask:
    """Return `mask` (n,) without runs of True that have fewer than `least` samples.

    scipy.ndimage has opening and closing operations for this, but its import takes longer than reading a log.
    """
    out = np.zeros(len(mask), dtype=np.bool_)
    for start, stop in intervals(mask):
        out[start:stop] = stop - start >= least
    return out


def joined(mask: Mask, window: int) -> Mask:
    """Return `mask` (n,) with gaps of fewer than `window` samples filled, and False in half a window at both ends."""
    inside = mask.copy()
    edges = np.flatnonzero(np.diff(mask))
    gaps = edges[0 if mask[0] else 1 :]  # begins with a change from True to False
    for start, stop in zip(gaps[::2], gaps[1::2], strict=False):
        if stop - start < window:
            inside[start + 1 : stop + 1] = True
    inside[: window // 2] = False
    inside[len(mask) - (window - 1) // 2 :] = False
    return inside


TURNS = 1.0  # s, approximate time between reversals; it enters as a logarithm: a factor of 3 changes the log odds by 1
SURE = 50.0  # log odds of a direction that the velocity shows
KNOWN = math.log(1000.0)  # log odds above which a direction is known: a sample in a thousand may be wrong
FITS = 2.0  # standard deviations, RMS over REVERSAL or over a rest, by which the torque of a direction may be off


def with_hidden_direction(data: Split, model: Model) -> Split:
    """Return the data with the estimated direction where noise hides it; masks exclude intervals that stay hidden."""
    rigid = isinstance(model, RigidDrive)
    hidden = [_hidden(run, rigid) for run in data.frame.runs]
    slow = hidden if rigid else [each | _long_rest(run) for run, each in zip(data.frame.runs, hidden, strict=True)]
    slid = _at_score_rate(data.frame, slow)
    if slid.all() or int((slid & data.frame.train).sum()) < FEWEST or not bool((slid & data.held).any()):
        return data
    if rigid:
        return _masked(data, hidden)
    found = _odds(data.frame, hidden, slid & data.frame.train)
    sticks = [_sticks(each, off) for each, (_, off) in zip(slow, found, strict=True)]
    hidden = [each & ~stuck for each, stuck in zip(hidden, sticks, strict=True)]
    runs = tuple(_directed(run, each, *of) for run, each, of in zip(data.frame.runs, hidden, found, strict=True))
    shown = _at_score_rate(data.frame, hidden)
    data = dataclasses.replace(data, frame=dataclasses.replace(data.frame, runs=runs), held=data.held & shown)
    return _masked(data, sticks)


def _at_score_rate(frame: Frame, hidden: Sequence[NDArray[np.bool_]]) -> NDArray[np.bool_]:
    """Return True (m,) for the score samples that contain no hidden sample; `hidden`: (n,) for each run."""
    return np.asarray(frame.stack([each.astype(float) for each in hidden]) == 0.0)


def _masked(data: Split, hidden: Sequence[NDArray[np.bool_]]) -> Split:
    """Return the split without these samples, (n,) for each run: their friction is unknown."""
    slid = _at_score_rate(data.frame, hidden)
    runs = tuple(
        dataclasses.replace(run, hidden=run.hidden + float(np.mean(each)))
        for run, each in zip(data.frame.runs, hidden, strict=True)
    )
    frame = dataclasses.replace(data.frame, runs=runs, train=data.frame.train & slid)
    masks = {name: getattr(data, name) & slid for name in ("fit", "held", "shipped")}
    return dataclasses.replace(data, frame=frame, **masks)


def _long_rest(run: Run) -> NDArray[np.bool_]:
    """Return True (n,) in long stretches in which an encoder shows that the joint rests."""
    return long(run.signals.omega_j == 0.0, max(1, round(REVERSAL / run.signals.period)))


def _sticks(slow: NDArray[np.bool_], off: Array) -> NDArray[np.bool_]:
    """Return True (n,) in the stretches of `slow` (n,) in which the torque fits neither direction: the joint sticks.

    off: deviation of the torque from that of the likelier direction, (n,), in standard deviations.
    """
    out = np.zeros(len(slow), dtype=np.bool_)
    for start, stop in intervals(slow):
        out[start:stop] = float(np.mean(np.square(off[start:stop]))) > FITS**2
    return out


def _hidden(run: Run, rigid: bool) -> NDArray[np.bool_]:
    """Return a mask (n,) at the compute rate of long intervals without a known direction.

    For tendons only a recorded velocity is considered, because an encoder shows a rest. The friction of a plain drive
    at rest is always unknown.
    """
    omega = run.signals.omega_j
    slow = np.abs(omega) <= UNKNOWN * run.velocity_error
    if not rigid:
        slow &= omega != 0.0
        if "omega_j" in run.raw.derived:
            return np.zeros(len(omega), dtype=np.bool_)
    least = max(1, round(REVERSAL / run.signals.period))
    around = np.pad(long(slow, least), least, mode="edge")  # a log that begins with slow motion was slow before it
    hidden = joined(around, least)[least:-least]
    return hidden & ~_creeping(run, hidden) if rigid else hidden


def _creeping(run: Run, hidden: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask (n,) of hidden intervals with visible slow motion: the median speed exceeds that of noise."""
    omega, error = run.signals.omega_j, max(run.velocity_noise, np.finfo(np.float64).tiny)
    out = np.zeros(len(hidden), dtype=np.bool_)
    for start, stop in intervals(hidden):
        # The noise of a low-passed velocity is independent after half a period of its band.
        count = (stop - start) * min(1.0, 2.0 * VELOCITY_BAND * run.signals.period)
        out[start:stop] = abs(float(np.median(omega[start:stop]))) > CERTAIN * error * math.sqrt(0.5 * math.pi / count)
    return out


def _odds(frame: Frame, hidden: Sequence[NDArray[np.bool_]], sure: NDArray[np.bool_]) -> list[tuple[Array, Array]]:
    """Return for each run the log odds of forward motion and the residual of the torque, (n,) each.

    The residual is in standard deviations and holds for the likelier direction. `sure`: score samples to fit, none of
    them hidden.
    """
    features = [_features(run, hold_direction(run.signals.omega_j)) for run in frame.runs]
    columns, target = frame.stack(features)[sure], frame.target[sure]
    factors = np.linalg.lstsq(columns, target, rcond=None)[0]
    rest = target - columns @ factors
    variance = max(float(np.mean(rest**2)), np.finfo(np.float64).tiny)
    alike = _correlated(rest / math.sqrt(variance))  # number of score samples with the information of one
    out = []
    for run, each in zip(frame.runs, hidden, strict=True):
        s = run.signals
        forward, backward = (run.target - _features(run, np.full(len(s), sign)) @ factors for sign in (1.0, -1.0))
        by_torque = (backward**2 - forward**2) / (2.0 * variance * alike * run.bin)
        speed = s.omega_j / max(run.velocity_noise, np.finfo(np.float64).tiny)
        by_velocity = (log_ndtr(speed) - log_ndtr(-speed)) * min(1.0, 2.0 * VELOCITY_BAND * s.period)
        evidence = np.where(each, by_torque + by_velocity, SURE * np.sign(s.omega_j))
        odds = _smoothed(evidence, s.period / TURNS)
        out.append((odds, np.where(odds > 0.0, forward, backward) / math.sqrt(variance)))
    return out


def _features(run: Run, sigma: Array) -> Array:
    """Return the components of a tendon-sheath's torque, (n, k).

    They are the terms of (3.55), with friction that may depend on the load, and a spring.
    """
    tau_m = run.signals.tau_m
    return np.column_stack([np.ones(len(sigma)), tau_m, sigma, sigma * np.abs(tau_m), np.abs(tau_m), run.angle])


def _correlated(y: Array) -> float:
    """Return the correlation length of a series in samples: the sum of the autocorrelation up to its first zero."""
    spectrum = np.abs(np.fft.rfft(y, 2 * len(y))) ** 2
    correlation = np.fft.irfft(spectrum)[: len(y)] / max(float(np.sum(y**2)), np.finfo(np.float64).tiny)
    crossed = np.flatnonzero(correlation <= 0.0)
    return float(max(1.0, 2.0 * correlation[: int(crossed[0]) if len(crossed) else len(y)].sum() - 1.0))


def _smoothed(evidence: Array, turn: float) -> Array:
    """Return the log odds (n,) of the first of two states from the evidence (n,) of each sample.

    `turn`: probability of a change of state per sample.
    """
    after, before = _swept(evidence, turn), _swept(evidence[::-1], turn)[::-1]
    return after + before - evidence


def _swept(evidence: Array, turn: float) -> Array:
    out, odds = np.empty(len(evidence)), 0.0
    for at, own in enumerate(evidence.tolist()):
        rising = math.exp(min(odds, 700.0))
        odds = own + math.log(((1.0 - turn) * rising + turn) / (turn * rising + 1.0 - turn))
        out[at] = odds
    return out


def _directed(run: Run, hidden: NDArray[np.bool_], odds: Array, off: Array) -> Run:
    """Return the run with the likelier direction in hidden intervals, and a smaller velocity error if it is certain."""
    if not hidden.any():
        return run
    from scipy.ndimage import binary_dilation, uniform_filter1d  # slow to import

    omega = np.where(hidden, np.copysign(np.abs(run.signals.omega_j), odds), run.signals.omega_j)
    factor = run.full_bin // run.bin
    whole = run.full.omega_j.copy()
    fine, sign = np.repeat(hidden, factor), np.repeat(odds, factor)
    whole[: len(fine)] = np.where(fine, np.copysign(np.abs(whole[: len(fine)]), sign), whole[: len(fine)])
    near = max(1, round(REVERSAL / run.signals.period))
    turns = np.append(np.diff(np.sign(odds)) != 0.0, False)
    fits = uniform_filter1d(off**2, near) < FITS**2
    known = hidden & (np.abs(odds) > KNOWN) & fits & ~binary_dilation(turns, np.ones(2 * near + 1, dtype=np.bool_))
    size = np.abs(omega)
    unsure = np.where(hidden, np.maximum(run.velocity_error, size), run.velocity_error)
    error = np.where(known, np.minimum(run.velocity_error, size / (1.01 * UNKNOWN)), unsure)
    told = 1.0 / (1.0 + np.exp(-np.minimum(np.abs(odds[hidden]), 700.0)))
    return dataclasses.replace(
        run,
        signals=dataclasses.replace(run.signals, omega_j=omega),
        full=dataclasses.replace(run.full, omega_j=whole),
        velocity_error=error,
        hidden=float(np.mean(hidden)),
        told=float(np.mean(told)),
    )
