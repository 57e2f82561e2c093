"""Hold the signals of one log as input of the model: columns of equal length, in SI units.

Derivatives have zero phase. A causal filter would shift them relative to the torque. The identification would then
find a delay or a velocity lag that the machine does not have.
"""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.monotonic_segments import MonotonicSegments

DERIVATIVE_CUTOFF = 20.0  # Hz, 3 dB of the zero-phase low-pass; joints move below 5 Hz
_RUN_IN = 3.0  # periods of the cutoff by which both ends are extended; the remaining transient is below 1e-5
_LARGEST = 8_000_000  # bytes, largest cached segments of a path: an hour at 1 kHz must need less than a gigabyte
_SHORTEST_FILTERED = 64  # samples; below this the filter's run-in is longer than the log


@dataclass(frozen=True, kw_only=True)
class Signals:
    """Hold the columns of a log, float64, shape (n,); None for a column that the log does not have.

    t in s, strictly increasing; tau_m in N*m; omega in rad/s; q and theta in rad; temperature in °C;
    accelerations in rad/s^2. Raises UsageError if a column differs from t in its shape.
    """

    t: Array
    tau_m: Array
    omega_j: Array
    q_j: Array | None = None
    q_m: Array | None = None
    omega_m: Array | None = None
    theta: Array | None = None
    temperature: Array | None = None
    acceleration_j: Array | None = None
    acceleration_m: Array | None = None
    theta_difference: Array | None = None  # rad, half of Theta_a - Theta_b, for tendons with different routings
    joints: Mapping[str, Array] = field(default_factory=dict)  # rad, q_j.NAME of joints that may bend the sheath

    def __post_init__(self) -> None:
        for entry in dataclasses.fields(self):
            if entry.name == "joints":
                joints = {name: self._checked(f"q_j.{name}", angle) for name, angle in self.joints.items()}
                object.__setattr__(self, "joints", joints)
            elif (column := getattr(self, entry.name)) is not None:
                object.__setattr__(self, entry.name, self._checked(entry.name, column))
        if len(self.t) == 0:
            raise UsageError("signals: no samples; give a log with at least one row")

    def _checked(self, name: str, values: Array) -> Array:
        column = np.ascontiguousarray(values, dtype=np.float64)
        if column.ndim != 1 or len(column) != len(self.t):
            raise UsageError(
                f"signals: column '{name}' has shape {column.shape} where t has {self.t.shape}; "
                "give columns of one length"
            )
        return column

    def __len__(self) -> int:
        return len(self.t)

    def __contains__(self, column: str) -> bool:
        """Return True if the log has this column, q_j.NAME included."""
        joint = column.removeprefix("q_j.")
        return joint in self.joints if joint != column else getattr(self, column) is not None

    def means(self, factor: int) -> Signals:
        """Return the means of `factor` samples each, without the incomplete group at the end."""

        def mean(y: Array) -> Array:
            whole = len(y) // factor * factor
            return np.asarray(y[:whole].reshape(-1, factor).mean(axis=1))

        columns = {entry.name: getattr(self, entry.name) for entry in dataclasses.fields(self)}
        joints = {name: mean(angle) for name, angle in columns.pop("joints").items()}
        return Signals(**{name: mean(y) for name, y in columns.items() if y is not None}, joints=joints)

    @cached_property
    def memo(self) -> dict[Hashable, Array]:
        """Return the cache for results of predictions; its keys are the arguments other than the signals."""
        return {}

    def legs(self, path: Array) -> MonotonicSegments:
        """Return the monotonic segments of a path, cached because a search requests them for many distances.

        The cache has room for two paths of a short log.
        """
        known = next((legs for legs in self._legs if legs.path is path), None)
        if known is None:
            known = MonotonicSegments.of(path)
            if known.nbytes < _LARGEST:
                self._legs.append(known)
        return known

    @cached_property
    def _legs(self) -> deque[MonotonicSegments]:
        return deque(maxlen=2)

    @property
    def period(self) -> float:
        """Return the mean sampling period, s; 1 for a single sample."""
        return float(self.t[-1] - self.t[0]) / (len(self) - 1) if len(self) > 1 else 1.0

    @cached_property
    def acceleration(self) -> Array:
        """Return the joint acceleration, rad/s^2: the column, or else derived from omega_j with zero phase."""
        return zero_phase_derivative(self.omega_j, self.period) if self.acceleration_j is None else self.acceleration_j

    @cached_property
    def motor_velocity(self) -> Array | None:
        """Return the motor velocity, rad/s: omega_m, or else derived from q_m with zero phase, or else None."""
        if self.omega_m is not None:
            return self.omega_m
        return None if self.q_m is None else zero_phase_derivative(self.q_m, self.period)

    @cached_property
    def motor_acceleration(self) -> Array | None:
        """Return the motor acceleration, rad/s^2: the column, or else derived with zero phase; None without motion."""
        if self.acceleration_m is not None:
            return self.acceleration_m
        velocity = self.motor_velocity
        return None if velocity is None else zero_phase_derivative(velocity, self.period)


def last_reversal(omega: Array) -> NDArray[np.intp]:
    """Return the sample at which the present direction began, shape (n,); 0 before the first reversal."""
    flips = np.concatenate([[True], np.diff(hold_direction(omega)) != 0.0])
    return np.maximum.accumulate(np.where(flips, np.arange(len(omega)), 0))


def hold_direction(omega: Array) -> Array:
    """Return sigma, shape (n,): sign(omega), or the last non-zero sign at omega = 0.

    Before the first motion sigma is the first non-zero sign. In a log without motion it is 0, the middle of the
    friction band.
    """
    sigma = np.sign(omega)
    moving = sigma != 0.0
    if moving.all():
        return sigma
    if not moving.any():
        return sigma
    last = np.maximum.accumulate(np.where(moving, np.arange(len(sigma)), int(np.argmax(moving))))
    held: Array = sigma[last]
    return held


def low_pass(y: Array, period: float, cutoff: float = DERIVATIVE_CUTOFF) -> Array:
    """Return the signal after a zero-phase low-pass with the gain 1/(1 + (f/cutoff)^4).

    This is the gain of a Butterworth filter of second order that runs in both directions. `cutoff` is in Hz and limited
    to 0.2 of the rate. A log that is too short for the filter's run-in is returned unfiltered. The spectrum is used,
    because the import of scipy's filters takes longer than a whole prediction.
    """
    n, cutoff = len(y), min(cutoff, 0.2 / period)
    if n < _SHORTEST_FILTERED:
        return y
    run_in = min(n - 1, math.ceil(_RUN_IN / (cutoff * period)))
    padded = np.concatenate([2.0 * y[0] - y[run_in:0:-1], y, 2.0 * y[-1] - y[-2 : -run_in - 2 : -1]])
    line = np.linspace(padded[0], padded[-1], len(padded))  # subtracted so that both ends are equal
    size = fast_size(len(padded))
    padded -= line
    line = line[run_in : run_in + n].copy()
    spectrum = np.fft.rfft(padded, size)
    del padded  # an hour at 1 kHz is 30 MB, and its spectrum 34
    spectrum *= 1.0 / (1.0 + (np.fft.rfftfreq(size, period) / cutoff) ** 4)
    line += np.fft.irfft(spectrum, size)[run_in : run_in + n]
    return line


def fast_size(n: int) -> int:
    """Return the smallest 2^a, 3*2^a or 5*2^a that is at least n, for which the FFT is fast."""
    return min(factor << max(0, math.ceil(math.log2(n / factor))) for factor in (1, 3, 5))


def zero_phase_derivative(y: Array, period: float, cutoff: float = DERIVATIVE_CUTOFF) -> Array:
    """Return dy/dt, shape (n,): central differences of the zero-phase low-passed signal; 0 for a single sample."""
    if len(y) < 2:
        return np.zeros_like(y)
    return np.asarray(np.gradient(low_pass(y, period, cutoff), period), dtype=np.float64)
