"""Prepare logs for the fits: signals, admission of samples, blocks of time, and known changes of the pretension."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import TooStillError, UsageError
from tsa_ctrl.identify import admit as admissible
from tsa_ctrl.identify.calibrate.regression import block_labels, choose_lag, lagged
from tsa_ctrl.identify.dataset import Dataset, check_distinct, matches
from tsa_ctrl.identify.energy import foreign_torque
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.signals import Signals, hold_direction

# Select the samples for a calibration independently of the fit.
#
# Samples that slide in a known direction are admitted. Standstill and the surroundings of each reversal are rejected,
# because a noisy velocity does not determine sigma there, and the friction has not yet built up (presliding).

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

NOISE_FACTOR = 5.0  # times the velocity noise: the sign of a slower velocity is not certain
SPEED_FRACTION = 0.05  # fraction of the 95th percentile of the speed: slower motion counts as standstill
STROKE_FRACTION = 0.15  # fraction of a stroke rejected after a reversal, where friction may still be building up
GUARD_TIME = 0.03  # s rejected on each side of a reversal because of sensor delays
STUCK = 20  # consecutive steps of 0 of a torque that otherwise changes with nearly every sample
OFTEN_SAME = 0.25  # largest share of other steps of 0
MIN_SECONDS = 1.0  # s, least admitted motion in each direction: twice the correlation time of noise (LAG_LIMIT)
# Least ratio of the motor torque's spread within a direction to its noise: below it, the slope is off by over a fifth
MIN_LOAD_TO_NOISE = 2.0


@dataclass(frozen=True)
class Admission:
    """The admitted samples of one log: `mask` (n), `direction` sigma (n), and the reasons for rejected samples."""

    mask: BoolArray
    direction: FloatArray
    refused: tuple[str, ...]
    seconds: float
    seconds_forward: float
    seconds_backward: float
    reversals: int


def noise_deviation(x: FloatArray) -> float:
    """Return the standard deviation of the noise of a signal, robustly from third differences (variance factor 20)."""
    if x.size < 8:
        return 0.0
    d = np.diff(x, 3)
    scale = float(np.median(np.abs(d - np.median(d))) / 0.6745 / np.sqrt(20.0))
    if scale > 0.0:
        return scale
    return float(np.std(d) / np.sqrt(20.0))  # a coarse quantiser: most differences are 0


def admit(t: FloatArray, omega: FloatArray) -> Admission:
    """Admit the samples of one log at which the joint certainly slides.

    No sample of a log without motion is admitted; `require` then raises an error.

    Args:
        t: time at a constant rate, (n,) in s.
        omega: joint velocity, (n,) in rad/s.
    """
    period = float(t[-1] - t[0]) / max(1, t.size - 1)
    fast = float(np.quantile(np.abs(omega), 0.95))
    threshold = max(NOISE_FACTOR * noise_deviation(omega), SPEED_FRACTION * fast, 1e-9)
    direction = np.where(omega > threshold, 1.0, np.where(omega < -threshold, -1.0, 0.0))
    moving = np.flatnonzero(direction)
    if moving.size == 0:
        nothing = np.zeros(t.size, dtype=np.bool_)
        return Admission(nothing, direction, ("standstill",), 0.0, 0.0, 0.0, 0)
    held = hold_direction(direction)
    switches = np.flatnonzero(np.diff(held)) + 1
    mask = direction != 0.0
    guard = max(1, round(GUARD_TIME / period))
    travel = np.cumsum(np.abs(omega)) * period
    edges = np.concatenate([[0], switches, [t.size]])
    strokes = travel[edges[1:] - 1] - travel[edges[:-1]]
    typical = float(np.median(strokes[1:-1])) if strokes.size > 2 else float(np.max(strokes))
    for start in switches:
        mask[max(0, start - guard) : start + guard] = False
        stop = int(np.searchsorted(travel, travel[start] + STROKE_FRACTION * typical))
        mask[start:stop] = False
    refused = []
    if np.any(direction == 0.0):
        refused.append("standstill")
    if switches.size:
        refused.append("reversals")
    forward = float(np.sum(mask & (held > 0)) * period)
    backward = float(np.sum(mask & (held < 0)) * period)
    return Admission(mask, held, tuple(refused), forward + backward, forward, backward, int(switches.size))


def require(admissions: list[Admission], tau_m: list[FloatArray], where: str) -> None:
    """Raise TooStillError if the data cannot identify friction torque and slope.

    The message names the quantity that varies too little.
    """
    forward = sum(a.seconds_forward for a in admissions)
    backward = sum(a.seconds_backward for a in admissions)
    if forward + backward == 0.0:
        raise TooStillError(
            f"{where}: the joint hardly moves, so friction cannot be seen; record motion in both directions"
        )
    for name, seconds in (("forward", forward), ("backward", backward)):
        if seconds < MIN_SECONDS:
            raise TooStillError(
                f"{where}: only {seconds:.2f} s of steady {name} motion, at least {MIN_SECONDS:g} s are needed in each "
                "direction; record longer or wider strokes both ways"
            )
    spread, noise = [], []
    for a, torque in zip(admissions, tau_m, strict=True):
        noise.append(noise_deviation(torque))
        for sign in (1.0, -1.0):
            part = torque[a.mask & (a.direction == sign)]
            if part.size:
                spread.append(float(np.std(part)))
    if max(spread) < MIN_LOAD_TO_NOISE * float(np.median(noise)) or max(spread) == 0.0:
        raise TooStillError(
            f"{where}: the motor torque varies by {max(spread):.2g} N*m within a direction of motion, hardly above its "
            f"noise of {float(np.median(noise)):.2g} N*m, so the slope cannot be seen; record with a load that varies"
        )


LAG_LIMIT = 0.5  # s: noise of the motor torque is uncorrelated beyond this lag
VARIED_FRACTION = 0.05  # relative change: a smaller one of bending angle or pretension is the same configuration


@dataclass(frozen=True)
class PreparedLog:
    """One log prepared for the fits; `tensioner` is a known change of the pretension in N."""

    name: str
    signals: Signals
    tau_j: FloatArray
    tensions: FloatArray | None  # measured (T1 + T3)/2, N
    admission: Admission
    labels: NDArray[np.int64]
    tensioner: float
    chosen: NDArray[np.bool_]  # samples of this log in the present set

    @property
    def mask(self) -> NDArray[np.bool_]:
        """Return the mask (n,) of the admitted samples in the present set."""
        return self.admission.mask & self.chosen

    def instrument(self, lag: float) -> FloatArray:
        """Return the instrument (n) of the motor torque, N*m: its mean `lag` s earlier and later."""
        return lagged(self.signals.tau_m, round(lag / self.signals.period))

    def restricted(self, chosen: NDArray[np.bool_]) -> PreparedLog:
        """Return the log with only the `chosen` samples in its set; effects with memory still use the whole motion."""
        return dataclasses.replace(self, chosen=self.chosen & chosen)


def prepare(logs: Sequence[Dataset], model: TendonSheath, tensioner: Mapping[str, float]) -> list[PreparedLog]:
    """Return the logs that have admitted samples, prepared for the fits.

    Args:
        tensioner: changes of T_p0 (N) by pattern of the logs' names.

    Raises:
        UsageError: no log, a pattern without a match, two logs with the same data or the same name, or logs that cannot
            be used with the model.
    """
    if not logs:
        raise UsageError("calibrate: no log given; name at least one")
    for pattern in tensioner:
        if not any(matches(d.name, pattern) for d in logs):
            raise UsageError(
                f"calibrate: tensioner '{pattern}' matches no log; logs are {', '.join(d.name for d in logs)}"
            )
    check_distinct("calibrate", logs)
    logs = [log.completed_for(model) for log in logs]
    admissions, prepared = [], []
    labels = block_labels([d.columns["t"].size for d in logs])
    for dataset, label in zip(logs, labels, strict=True):
        admissible.admit(dataset, model, "tau_j")
        signals = dataset.signals()
        admission = admit(signals.t, signals.omega_j)
        for name in ("tau_m", "tau_j"):
            admission = _without_stuck(admission, dataset.columns[name], name)
        admissions.append(admission)
        change = sum(value for pattern, value in tensioner.items() if matches(dataset.name, pattern))
        columns = dataset.columns
        tensions = 0.5 * (columns["t1"] + columns["t3"]) if "t1" in columns and "t3" in columns else None
        everything = np.ones(signals.t.size, dtype=np.bool_)
        prepared.append(
            PreparedLog(dataset.name, signals, columns["tau_j"], tensions, admission, label, change, everything)
        )
    where = logs[0].name if len(logs) == 1 else f"{len(logs)} logs"
    require(admissions, [p.signals.tau_m for p in prepared], where)
    for dataset in logs:
        foreign = foreign_torque(dataset, model)
        if foreign:
            raise UsageError(f"{dataset.label or dataset.name}: {foreign}")
    return [p for p in prepared if p.mask.any()]


def _without_stuck(admission: Admission, values: FloatArray, name: str) -> Admission:
    """Return the admission without the samples in which a torque is stuck: saturated, or repeated by a lost sensor.

    A noisy torque never repeats a value for STUCK samples. A log without noise may do so, and then does it often.
    """
    same = np.concatenate([[False], np.diff(values) == 0.0])
    edges = np.flatnonzero(np.diff(np.concatenate([[0], same, [0]])))
    stuck = np.zeros(values.size, dtype=np.bool_)
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        stuck[max(first - 1, 0) : end] = end - first >= STUCK
    mask = admission.mask & ~stuck
    count = int(np.count_nonzero(admission.mask & stuck))
    if not count or not mask.any() or np.count_nonzero(same & ~stuck) > OFTEN_SAME * np.count_nonzero(~stuck):
        return admission
    period = admission.seconds / np.count_nonzero(admission.mask)
    forward, backward = (period * np.count_nonzero(mask & (sign * admission.direction > 0.0)) for sign in (1.0, -1.0))
    return dataclasses.replace(
        admission,
        mask=mask,
        refused=(*admission.refused, f"stuck {name} ({count} samples)"),
        seconds=forward + backward,
        seconds_forward=forward,
        seconds_backward=backward,
    )


def varied(logs: list[PreparedLog], model: TendonSheath) -> bool:
    """Return True if wrap angle or pretension varied by known amounts."""
    changes = [log.tensioner for log in logs]
    if max(changes) - min(changes) > VARIED_FRACTION * model.pretension:
        return True
    theta = np.concatenate(
        [np.zeros(0)] + [log.signals.theta[log.mask] for log in logs if log.signals.theta is not None]
    )
    return theta.size > 0 and float(np.ptp(theta)) > VARIED_FRACTION * model.bending_angle


def instrument_lag(logs: list[PreparedLog]) -> float:
    """Return the lag in s beyond which the noise of the motor torque is uncorrelated in every log."""
    lags = []
    for log in logs:
        x = np.column_stack([log.signals.tau_m, log.admission.direction, np.ones(log.tau_j.size)])
        if log.signals.theta is not None:
            x = np.column_stack([x, x * (log.signals.theta - log.signals.theta.mean())[:, None]])
        b = np.linalg.lstsq(x[log.mask], log.tau_j[log.mask], rcond=None)[0]
        residual = np.where(log.mask, log.tau_j - x @ b, 0.0)
        period = log.signals.period
        lags.append(period * choose_lag(log.signals.tau_m, residual, max(2, round(LAG_LIMIT / period))))
    return max(lags)


def offsets(logs: list[PreparedLog]) -> list[FloatArray]:
    """Return for each of m logs the regressors (n, m) of its offset: 1 in the log's own column, 0 in the others.

    The zero of a sensor may change between logs, but not within one.
    """
    return [np.broadcast_to(row, (log.tau_j.size, len(logs))) for row, log in zip(np.eye(len(logs)), logs, strict=True)]


def stack(parts: list[FloatArray], logs: list[PreparedLog]) -> FloatArray:
    """Return the admitted samples of all logs in one array; `parts`: one array per log."""
    return np.concatenate([part[log.mask] for part, log in zip(parts, logs, strict=True)])
