"""Audit the logs before any fit: suspicious signals, covered speeds and torques, and excitation of the drive."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tsa_ctrl.identify.dataset import notes_of
from tsa_ctrl.identify.diagnosis.criteria import FEWEST
from tsa_ctrl.identify.diagnosis.data.frame import Frame, Run
from tsa_ctrl.identify.energy import is_noise
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.signals import hold_direction

SHORTEST = 3.0  # s: a slow reversal with the motion before and after it
CLEAR = 6.0  # times the velocity noise: faster motion is not noise
LEAST_CLEAR, LEAST_MOVING = 0.05, 0.02  # least shares of the time; SHORTEST s in all are also sufficient
# Share of the samples of a torque that repeat the previous one: a larger share was held, because noise changes the last
# digit
STUCK = 0.5
FEWEST_HELD = 20  # fewest samples at the largest value that indicate a limit rather than chance
HELD, MOVED = 0.3, 0.05  # s, and share of the range: the torque of a moving joint changes earlier
BINS = 8  # bins of the picture: few enough to read at a glance; no verdict depends on them


@dataclass(frozen=True)
class Audit:
    """Result of an audit of the logs.

    `insufficient` is the reason why the logs cannot be diagnosed, or empty if they can. `suspicions` are possible
    faults of the data.
    """

    seconds: float
    rate: float
    moving: float  # share of the time
    reversals: int
    both_directions: bool
    occupancy: Array  # (BINS, BINS) share of samples over (velocity, motor torque)
    speed_edges: Array
    load_edges: Array
    notes: tuple[str, ...]
    suspicions: tuple[str, ...]
    insufficient: str


def audit(frame: Frame, notes: Sequence[str] = (), needs_motion: bool = True) -> Audit:
    """Return the occupancy and excitation of the logs.

    Args:
        frame: the logs.
        notes: notes on previous changes of the logs.
        needs_motion: False for a gear, because a locked joint also shows its gain, offset and saturation.
    """
    omega = np.concatenate([run.signals.omega_j for run in frame.runs])
    tau_m = np.concatenate([run.signals.tau_m for run in frame.runs])
    # Each log has its own noise: an additional noisy log must not hide the motion of the others.
    noise = np.concatenate([np.full(len(run.signals), run.velocity_noise) for run in frame.runs])
    fast = float(np.quantile(np.abs(omega), 0.95)) if len(omega) else 0.0
    moving = np.abs(omega) > np.maximum(np.maximum(0.05 * fast, 4.0 * noise), 1e-9)
    clear = float(np.mean(np.abs(omega) > CLEAR * noise)) if len(omega) else 0.0
    reversals = sum(
        int(np.count_nonzero(np.diff(_steady(run.signals.omega_j, run.velocity_noise)))) for run in frame.runs
    )
    forward, backward = float(np.mean(moving & (omega > 0.0))), float(np.mean(moving & (omega < 0.0)))
    speed_edges = np.linspace(-1.05 * max(fast, 1e-9), 1.05 * max(fast, 1e-9), BINS + 1)
    top = max(float(np.quantile(np.abs(tau_m), 0.99)), 1e-9) * 1.05
    load_edges = np.linspace(-top, top, BINS + 1)
    occupancy = np.histogram2d(omega, tau_m, bins=(speed_edges, load_edges))[0] / max(len(omega), 1)
    return Audit(
        seconds=frame.seconds,
        rate=frame.runs[0].raw.rate,
        moving=float(np.mean(moving)),
        reversals=reversals,
        both_directions=min(forward, backward) > 0.02,
        occupancy=occupancy,
        speed_edges=speed_edges,
        load_edges=load_edges,
        notes=(*notes, *notes_of([run.raw for run in frame.runs]), *_narrowed(frame), *_hidden(frame)),
        suspicions=_suspicions(frame),
        insufficient=_insufficient(float(np.mean(moving)), fast, clear, frame, needs_motion),
    )


def _narrowed(frame: Frame) -> tuple[str, ...]:
    """Return a note on the band to which derived motion was limited; empty without a limit."""
    band = min(run.band for run in frame.runs)
    if not np.isfinite(band):
        return ()
    return (
        f"friction follows the motion up to {band:.2g} Hz: angles and velocities derived from them are narrowed to "
        "that, because the joint torque does not respond to faster motion",
    )


def _hidden(frame: Frame) -> tuple[str, ...]:
    """Return a note on the share of time with a hidden direction and on its treatment; empty without any."""
    lengths = np.array([len(run.signals) for run in frame.runs], dtype=np.float64)
    shares = np.array([run.hidden for run in frame.runs])
    share = float(shares @ lengths / lengths.sum())
    if share <= 0.0:
        return ()
    start = f"for {share:.1%} of the time the velocity shows no direction:"
    if np.isnan([run.told for run in frame.runs]).all():
        return (f"{start} friction at rest is anything within its band, and nothing is learned there",)
    told = float(np.nansum([run.told * run.hidden * len(run.signals) for run in frame.runs]) / (shares @ lengths))
    return (
        f"{start} there it is the one that velocity and torque make likelier (with a probability of {told:.1%} on "
        "average), and held-out errors leave it out",
    )


def _steady(omega: Array, noise: float) -> Array:
    """Return the direction of motion, with the velocity noise as hysteresis."""
    return hold_direction(np.where(np.abs(omega) > 3.0 * noise, omega, 0.0))


def _insufficient(moving: float, fast: float, clear: float, frame: Frame, needs_motion: bool) -> str:
    """Return the reason why these logs cannot be diagnosed, or an empty string.

    If a part of a log is sufficient, additional standstill does not make it insufficient.

    Args:
        moving: share of the time in which the joint moves.
        fast: 95th percentile of the speed, rad/s.
        clear: share of the time in which the speed clearly exceeds its noise.
        frame: the logs.
        needs_motion: True if the joint must move.
    """
    if frame.seconds < SHORTEST or len(frame) < FEWEST:
        return f"the logs hold {frame.seconds:.2g} s; at least {SHORTEST:g} s are needed"
    if _is_constant([run.target for run in frame.runs]):
        return "the measured torque does not change at all: is the sensor connected?"
    if _is_constant([run.signals.tau_m for run in frame.runs]):
        return "tau_m does not change at all: is the drive's torque recorded?"
    if is_noise(np.concatenate([run.full_target for run in frame.runs])):
        return "the measured torque is a constant with noise: its neighbouring samples have nothing in common"
    if _is_constant([run.signals.omega_j for run in frame.runs]) and fast > 0.0:
        return "the velocity does not change at all: is it recorded?"
    if not needs_motion:
        return ""
    if fast <= 0.0 and clear * frame.seconds < SHORTEST:
        return "the joint does not move: friction shows only in motion"
    clear_needed, moving_needed = (min(least, SHORTEST / frame.seconds) for least in (LEAST_CLEAR, LEAST_MOVING))
    if clear < clear_needed:
        noise = max(run.velocity_noise for run in frame.runs)
        return (
            f"the joint hardly moves: its speed stands {CLEAR:g} times out of the velocity's noise of "
            f"{noise:.3g} rad/s in {clear:.1%} of the time, {clear_needed:.1%} are needed; "
            f"95 % of the time it is below {fast:.3g} rad/s"
        )
    if moving < moving_needed:
        return f"the joint hardly moves: in {moving:.1%} of the time, {moving_needed:.1%} are needed"
    return ""


def _held_in_motion(run: Run, column: Array) -> tuple[float, float, float] | None:
    """Return start (s), length (s) and value of the longest constant torque during which the joint moves."""
    edges = np.concatenate([[0], np.flatnonzero(np.diff(column) != 0.0) + 1, [len(column)]])
    path = np.concatenate([[0.0], np.cumsum(np.abs(run.full.omega_j))]) * run.full.period
    lengths = np.diff(edges)
    moved = path[edges[1:]] - path[edges[:-1]]
    far = MOVED * float(np.ptp(np.cumsum(run.full.omega_j))) * run.full.period
    held = np.where((lengths * run.full.period > HELD) & (moved > far), lengths, 0)
    longest = int(np.argmax(held))
    if held[longest] == 0:
        return None
    start = int(edges[longest])
    return float(run.full.t[start]), float(held[longest]) * run.full.period, float(column[start])


def _is_constant(columns: Sequence[Array]) -> bool:
    return all(float(np.ptp(column)) == 0.0 for column in columns)


def _suspicions(frame: Frame) -> tuple[str, ...]:
    out = []
    for run in frame.runs:
        for name in ("tau_j", "tau_m"):
            if name not in run.raw:
                continue
            column = run.raw[name]
            repeated = np.diff(column) == 0.0
            if float(np.mean(repeated)) > STUCK and len(np.unique(column)) > 0.05 * len(column):
                out.append(f"{run.name}: {name} repeats its last value in {np.mean(repeated):.0%} of the samples")
            if float(np.ptp(column)) == 0.0:
                continue
            if rest := _held_in_motion(run, column):
                start, seconds, value = rest
                out.append(
                    f"{run.name}: {name} stays at {value:.3g} N·m for {seconds:.2g} s from t = {start:.4g} s on while "
                    "the joint moves: was it recorded there?"
                )
            if is_noise(column):
                out.append(f"{run.name}: {name} is a constant with noise: is the torque recorded?")
            top = np.max(np.abs(column))
            held = float(np.mean(np.abs(column) > 0.9999 * top))
            if held > 0.01 and held * len(column) > FEWEST_HELD:
                out.append(f"{run.name}: {name} stays at its largest value {top:.3g} N·m for {held:.1%} of the time")
    return tuple(out)
