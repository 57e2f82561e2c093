"""Design an excitation: a joint torque that makes the unknown parameters identifiable within the given limits.

Friction angle and pretension are identifiable from tau_J = slope tau_M - half_loop sigma if the joint slides in both
directions and the load varies within each direction. A joint that is moved from outside (by a wearer or a test bench)
needs a torque at frequencies that differ from this motion. A joint that the drive moves must move in both directions
within its limits of speed and travel. A probe with little torque determines which case applies.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.log.table import from_zero, read_waypoints
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.steady_sliding import sliding

FloatArray = NDArray[np.float64]

RATE = 200.0  # Hz of the set-point file; the controller interpolates
LONGEST = 600.0  # s, longest permitted set-point file
RAMP = 1.0  # s, duration of the ramp at each end of the torque
PROBE_FREQUENCIES = (0.45, 0.8)  # Hz
PROBE_SECONDS = 6.0  # s: two periods of the slowest sine of a probe, with its ramps
PROBE_SHARES = (0.2, 0.5, 0.9)  # of the torque limit, tried in this order until the joint moves
FREQUENCIES = (0.31, 0.53, 0.87, 1.19)  # Hz of the excitation: slow compared with sensor delays, many periods in 15 s
OTHER_FREQUENCIES = (0.41, 0.71, 1.03)  # Hz of the verification: a motion not used for the fit
VERIFICATION_SHARE = 0.8  # of the excitation's torque: inside the range of the excitation
OFF = 0.2  # 1, permitted error of the file's friction angle and pretension, for which both tendons must still pull
PULLING = 0.8  # of the joint torque at which a tendon goes slack with these errors
SHAKE_SECONDS = 8.0
MOVING = 0.05  # rad/s RMS; a slower joint counts as being at rest
MOVED_BY_TORQUE = 0.3  # share of the velocity's variance that the torque explains
HEADROOM = 0.7  # of the permitted speed and of the remaining travel that the scaled response may use
APART = 0.12  # least relative distance of a frequency from the motion's frequency and its harmonics


@dataclass(frozen=True)
class Bounds:
    """The limits of the excitation: joint torque (N*m), joint speed (rad/s) and joint travel (rad, or None)."""

    torque: float
    speed: float
    travel: tuple[float, float] | None = None


@dataclass(frozen=True)
class Waveform:
    """A joint torque to play: `t` (n) in s from 0, `tau_j_des` (n) in N*m, 0 at both ends."""

    t: FloatArray
    tau_j_des: FloatArray

    @property
    def seconds(self) -> float:
        return float(self.t[-1])

    @property
    def peak(self) -> float:
        """Return the largest magnitude of the torque, N*m."""
        return float(np.abs(self.tau_j_des).max())


@dataclass(frozen=True)
class Response:
    """The joint's motion during a probe."""

    peak_speed: float  # rad/s
    rms_speed: float  # rad/s
    angle: tuple[float, float] | None  # rad, least and largest joint angle
    frequency: float  # Hz, main frequency of the motion
    by_torque: float  # 1, share of the velocity's variance that the torque explains


@dataclass(frozen=True)
class Design:
    """An excitation, the motion that verifies its result, and the reasons for both."""

    excitation: Waveform
    verification: Waveform
    shake: Waveform  # the slow torque to which the fast sweeps of the motor are added
    reasons: tuple[str, ...]


def most_torque(model: TendonSheath, limit: float) -> float:
    """Return the joint torque (N*m) up to which both tendons pull, even if the parameters are wrong by `OFF`.

    Args:
        model: model of the given file.
        limit: limit of the motor torque, N*m.

    Raises:
        UsageError: The limit does not overcome the friction.
    """
    x = (1.0 + OFF) * model.friction_angle
    # The case with all bends at the joint, in which a tendon goes slack first, because the profile may be unknown yet.
    slack = 2.0 * (1.0 - OFF) * model.pretension * model.joint_pulley_radius * math.exp(-x)
    line = sliding(model, 1.0, x)
    friction = line.motor_half_loop
    least = min(PULLING * slack, line.slope * (limit - friction))
    if least <= 0.0:
        raise UsageError(
            f"{model.source or 'model'}: limits.torque {limit:g} N*m hardly overcomes the friction of the sheaths, "
            f"which takes up to {friction:.3g} N*m at the motor; raise limits.torque, or lower the pretension"
        )
    return least


def probe(bounds: Bounds, share: float, seconds: float) -> Waveform:
    """Return a slow torque with the peak `share` times the limit."""
    return multi_sine(PROBE_FREQUENCIES, share * bounds.torque, seconds)


def multi_sine(frequencies: tuple[float, ...], peak: float, seconds: float) -> Waveform:
    """Return a sum of sines of equal amplitude at `frequencies` (Hz), scaled to `peak` (N*m), with ramps at both ends.

    Schroeder's phases keep the crest factor low.
    """
    t = np.arange(0.0, seconds + 0.5 / RATE, 1.0 / RATE)
    count = len(frequencies)
    phases = [-math.pi * k * (k + 1) / count for k in range(count)]
    wave = np.sum([np.sin(2.0 * np.pi * f * t + p) for f, p in zip(frequencies, phases, strict=True)], axis=0)
    wave = wave * fading(t)
    return Waveform(t, peak * wave / max(float(np.abs(wave).max()), 1e-12))


def fading(t: FloatArray) -> FloatArray:
    """Return a factor (n,) at the times `t` (s) that rises from 0 to 1 within RAMP, and falls to 0 at the end."""
    edge = np.clip(np.minimum(t, t[-1] - t) / RAMP, 0.0, 1.0)
    return np.asarray(0.5 * (1.0 - np.cos(np.pi * edge)))


def from_file(path: Path) -> Waveform:
    """Return the joint torque of a set-point file (columns t in s, tau_j_des in N*m), with ramps at both ends.

    Raises:
        UsageError: The file cannot be played, is shorter than four ramps or longer than `LONGEST`, or has no torque.
    """
    columns = read_waypoints(path, ("tau_j_des",)).columns
    given = from_zero(columns["t"])
    if not 4.0 * RAMP <= given[-1] <= LONGEST or not np.any(columns["tau_j_des"]):
        raise UsageError(
            f"{path}: the file lasts {given[-1]:.3g} s with at most {np.abs(columns['tau_j_des']).max():.3g} N*m; give "
            f"{4.0 * RAMP:g} to {LONGEST:g} s with torque"
        )
    t = np.arange(0.0, given[-1], 1.0 / RATE)
    wave = np.interp(t, given, columns["tau_j_des"])
    return Waveform(t, wave * fading(t))


def playing(designed: Design, wave: Waveform) -> Design:
    """Return the design with `wave` as its excitation, scaled down to the torque that the design permits."""
    share = min(1.0, designed.excitation.peak / wave.peak)
    reason = f"the excitation is the given file at {share:.0%} of its torque ({share * wave.peak:.2g} N*m)"
    excitation = Waveform(wave.t, share * wave.tau_j_des)
    return dataclasses.replace(designed, excitation=excitation, reasons=(*designed.reasons, reason))


def response(run: Dataset) -> Response:
    """Evaluate the joint's motion during a probe."""
    omega, torque = run["omega_j"], run["tau_m"]
    period = run.period
    level = np.column_stack([torque, np.gradient(torque, period), np.cumsum(torque - torque.mean()) * period])
    level = (level - level.mean(axis=0)) / np.maximum(level.std(axis=0), 1e-12)
    centred = omega - omega.mean()
    fitted = level @ np.linalg.lstsq(level, centred, rcond=None)[0]
    variance = float(centred @ centred)
    spectrum = np.abs(np.fft.rfft(centred * np.hanning(centred.size)))
    frequencies = np.fft.rfftfreq(centred.size, period)
    slow = frequencies < 5.0
    angle = (float(run["q_j"].min()), float(run["q_j"].max())) if "q_j" in run else None
    return Response(
        peak_speed=float(np.quantile(np.abs(omega), 0.999)),
        rms_speed=float(np.sqrt(np.mean(np.square(omega)))),
        angle=angle,
        frequency=float(frequencies[slow][int(np.argmax(spectrum[slow]))]),
        by_torque=float(fitted @ fitted) / variance if variance > 0.0 else 0.0,
    )


def design(found: Response, probed: float, bounds: Bounds, seconds: float, verification_seconds: float) -> Design:
    """Return the excitation and the verification motion for the response to a probe.

    Args:
        found: response of the joint to the probe.
        probed: peak of the probe, N*m.
        bounds: permitted torque, speed and travel of the joint.
        seconds: duration of the excitation, s.
        verification_seconds: duration of the verification, s.

    Raises:
        UsageError: The joint hardly moves, is moved faster than permitted, or is at the end of its travel.
    """
    if found.rms_speed < MOVING:
        raise UsageError(
            f"tune: the joint hardly moves ({found.rms_speed:.3f} rad/s RMS at {probed:.2g} N*m), so friction cannot "
            "be measured; move it, release it, or allow more --torque"
        )
    reasons = []
    frequencies: tuple[float, ...] = FREQUENCIES
    others: tuple[float, ...] = OTHER_FREQUENCIES
    torque = bounds.torque
    if found.by_torque >= MOVED_BY_TORQUE:
        torque = min(torque, probed * HEADROOM * bounds.speed / max(found.peak_speed, 1e-9))
        reasons.append(
            f"the torque moves the joint ({found.peak_speed:.2g} rad/s at {probed:.2g} N*m): {torque:.2g} N*m keeps "
            f"it below {bounds.speed:.2g} rad/s"
        )
        if bounds.travel is not None and found.angle is not None:
            middle = 0.5 * (found.angle[0] + found.angle[1])
            reach = max(found.angle[1] - middle, middle - found.angle[0], 1e-6)
            room = min(bounds.travel[1] - middle, middle - bounds.travel[0])
            torque = min(torque, probed * HEADROOM * max(room, 0.0) / reach)
            reasons.append(f"{torque:.2g} N*m keeps the joint within its travel")
    else:
        if found.peak_speed > bounds.speed:
            raise UsageError(
                f"tune: the joint is moved at up to {found.peak_speed:.2g} rad/s; at most {bounds.speed:.2g} rad/s "
                "is allowed: slow the motion down, or raise --speed and limits.joint_speed"
            )
        frequencies = tuple(apart(f, found.frequency) for f in FREQUENCIES)
        others = tuple(apart(f, found.frequency) for f in OTHER_FREQUENCIES)
        reasons.append(
            f"the joint is moved from outside at {found.frequency:.2g} Hz: the load varies at "
            f"other frequencies, {', '.join(f'{f:.2g}' for f in frequencies)} Hz"
        )
    if torque <= 0.0:
        raise UsageError("tune: the joint is at the end of its travel; move it away from there, or widen --travel")
    return Design(
        multi_sine(frequencies, torque, seconds),
        multi_sine(others, VERIFICATION_SHARE * torque, verification_seconds),
        multi_sine(frequencies, VERIFICATION_SHARE * torque, SHAKE_SECONDS),
        tuple(reasons),
    )


def apart(frequency: float, motion: float) -> float:
    """Return `frequency` (Hz), shifted if it is too close to the frequency `motion` (Hz) or to one of its harmonics."""
    if motion <= 0.0:
        return frequency
    order = round(frequency / motion)
    if order < 1 or abs(frequency - order * motion) > APART * motion:
        return frequency
    return (order + math.copysign(2.0 * APART, frequency - order * motion)) * motion
