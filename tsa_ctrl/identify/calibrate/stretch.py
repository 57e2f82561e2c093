"""Estimate stiffness, curvature profile and zero of the tendons from q_m, q_j and tau_m; tau_j is optional.

The tendon model of the observer (`tsa_ctrl.observer.tendons`) predicts the elongation s from motor torque and joint
angle of the log. The Gauss-Newton method finds the parameters with the least error of the elongation, and of the joint
torque if it was measured:

    ln of the stiffness   (one factor for E A and a series spring; while all slides, s over tau_M has slope 1/(2 k_t))
    s_c                   (centre of the bends; then the whole curvature profile, `find_course`)
    ln x                  (at the model's pretension; s differs between both directions by x T_p (1 - s_c)/k_t)
    J_M, and the zero of s of each log

Without a joint torque sensor the two directions show only x T_p (1 - s_c). Only the shape of s during a reversal would
separate s_c from x, but it also depends on the true curvature profile. s_c is therefore kept, with the file's
uncertainty. Intervals follow from blocks of time (`regression`). They also contain the error of modelling the tendon as
a chain of a few contacts with constant T_p (`MODEL`).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import TooStillError, UsageError
from tsa_ctrl.identify.calibrate.pretension_range import reached, remark
from tsa_ctrl.identify.calibrate.regression import block_labels, solve
from tsa_ctrl.identify.calibrate.tendon_log import TendonLog, foretold, taken, varied
from tsa_ctrl.identify.dataset import Dataset, check_distinct
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.model.curvature import Points, Profile
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.steady_sliding import sliding
from tsa_ctrl.model.stretch import MOST_CENTRE, profile_of
from tsa_ctrl.outputs import json_types

FloatArray = NDArray[np.float64]

ROUNDS = 12  # most iterations of the Gauss-Newton method; a small change usually ends it earlier
STEPS = (0.01, 0.01, 0.02, 1e-5)  # steps of ln k, s_c, ln x, J_M for derivatives: they exceed single contacts
MOST = (0.3, 0.1, 0.3, 2e-4)  # largest change of the same parameters in one iteration, so that the search converges
# 95 % error of the same parameters due to the chain of contacts. With it added to the scatter of the blocks, the
# intervals contain the true values on rigs with errors of up to 20 % in friction, pretension and stiffness
# (bench/stretch).
MODEL = (0.006, 0.006, 0.03, 5e-6)
COURSE_FOUND = 0.002  # the same for s_c if the log determined the curvature profile: the error is 0.0013 at most
WIDEST = (0.25, 0.15)  # 95 % half widths of ln k and s_c above which the log does not determine them
LEAST_SLID = 1.0  # s, least time after the tendons have slid along their whole length
CENTRES = (0.01, 0.97)  # range of s_c: at either end one of the two compliances is 0 and has no logarithm


@dataclass(frozen=True)
class StretchFit:
    """The estimates from the tendon elongation; `model` contains them all.

    `centre` is None without a joint torque sensor.
    """

    axial_stiffness: Quantity  # N; a series spring is scaled by the same factor
    centre: Quantity | None  # s_c of the sheath's bends, 1
    friction_angle: Quantity  # 1, at the model's pretension
    half_loop_torque: Quantity  # N*m at the joint: the product of friction angle and pretension
    motor_inertia: Quantity  # kg*m^2
    zeros: dict[str, Quantity]  # m, zero of r_M q_M - r_J q_J, by log
    rms: float  # m, RMS error of the predicted elongation
    notes: tuple[str, ...]
    model: TendonSheath

    @property
    def quantities(self) -> dict[str, Quantity]:
        """Return the estimated quantities by their public names."""
        found = {
            "axial_stiffness": self.axial_stiffness,
            "motor_inertia": self.motor_inertia,
            "half_loop_torque": self.half_loop_torque,
        }
        return found if self.centre is None else {**found, "bending_centre": self.centre}

    def to_dict(self) -> dict[str, object]:
        """Return the object "stretch" of `tsa calibrate --json`."""
        found: dict[str, object] = json_types(
            {
                **self.quantities,
                "friction_angle": self.friction_angle,
                "zero": self.zeros,
                "rms": {"value": self.rms, "unit": "m"},
                "notes": self.notes,
            }
        )
        return found


_Part = tuple[FloatArray, FloatArray, NDArray[np.int64]]  # regressors, residuals, block labels
Foretold = tuple[FloatArray, FloatArray, NDArray[np.bool_]]  # elongation, joint torque and mask, as `foretold` returns


def fit_stretch(logs: Sequence[Dataset], model: TendonSheath) -> StretchFit:
    """Return the parameters fitted to all logs together.

    Raises:
        UsageError: the model has no friction or no pretension, columns contradict each other, two logs have the same
            data or name, or the logs do not determine a parameter. The message states the remedy.
    """
    if not (model.friction_angle > 0.0 and model.pretension > 0.0):
        raise UsageError(f"{model.source or 'model'}: friction angle and pretension must be above 0 to be calibrated")
    check_distinct("calibrate", logs)
    seen = [taken(log, model) for log in logs]
    count = len(seen)
    # ln k, s_c, ln x, J_M; then the zeros of all elongations, and the zeros of all torque sensors
    centre = min(CENTRES[1], max(CENTRES[0], profile_of(model).centre))
    p = np.array([0.0, centre, 0.0, 0.0, *(log.stretch[0] for log in seen), *np.zeros(count)])
    sensor = all(log.tau_j is not None for log in seen)
    half, rms = _search(seen, model, p, sensor, _names(logs))
    if sensor and "elongation_coupling" not in model.effects and p[1] <= MOST_CENTRE:
        model = find_course(seen, _variant(model, p), float(p[3]))
        p[:3] = 0.0, profile_of(model).centre, 0.0
        half, rms = _search(seen, model, p, sensor, _names(logs), COURSE_FOUND)
    return _result(seen, model, p, half, rms, sensor)


def _search(
    logs: list[TendonLog], model: TendonSheath, p: FloatArray, sensor: bool, names: str, of_centre: float = MODEL[1]
) -> tuple[dict[int, float], float]:
    """Search by the Gauss-Newton method from the parameters `p`, which are changed in place.

    Returns:
        The half width of the interval of each free parameter by its index in `p`, and the RMS error of the elongation
        (m).

    Raises:
        TooStillError: the logs do not determine the parameters.
    """
    count = len(logs)
    free = [0, 1, 2, 3, *range(4, 4 + 2 * count)] if sensor else [0, 2, 3, *range(4, 4 + count)]
    step = np.array([*STEPS, *np.full(count, 1e-6), *np.full(count, 1e-3)])
    most = np.array([*MOST, *np.full(count, 1e-3), *np.full(count, 1.0)])
    labels = block_labels([log.stretch.size for log in logs])
    for _ in range(ROUNDS):
        rows, rest, blocks, rms = _linear(logs, model, p, free, step, sensor, labels)
        try:
            estimate = solve(rows, rows, rest, blocks)
        except np.linalg.LinAlgError:
            raise TooStillError(f"{names}: {_CURE}") from None
        change = np.clip(estimate.value, -most[free], most[free])
        p[free] += change
        p[1] = min(CENTRES[1], max(CENTRES[0], p[1]))
        if np.all(np.abs(change) < 0.01 * step[free]):
            break
    half = {place: 0.5 * float(np.subtract(*estimate.interval(i)[::-1])) for i, place in enumerate(free)}
    for place, floor in enumerate((MODEL[0], of_centre, *MODEL[2:])):
        if place in half:
            half[place] = math.hypot(half[place], floor)
    if not half[0] < WIDEST[0] or not half.get(1, 0.0) < WIDEST[1]:
        raise TooStillError(f"{names}: {_CURE}")
    return half, rms


def told(logs: Sequence[Dataset], found: StretchFit) -> list[Dataset]:
    """Return the logs with tau_j (N*m) estimated from the tendon elongation, from its first known sample on."""
    p = np.array([0.0, profile_of(found.model).centre, 0.0, found.motor_inertia.value])
    out = []
    for log in logs:
        _, torque, known = _foretold(taken(log, found.model), found.model, p)
        first = int(np.argmax(known))
        columns = {name: values[first:] for name, values in log.columns.items() if name != "tau_j"}
        finite = np.flatnonzero(np.isfinite(torque[first:]))
        columns["tau_j"] = np.interp(np.arange(len(torque) - first), finite, torque[first:][finite])
        out.append(dataclasses.replace(Dataset.from_arrays(columns, log.name), sha256=log.sha256))
    return out


_CURE = (
    "the tendon elongation does not show their stiffness here; record motion in both directions, with reversals, under "
    "a load that varies, and with a torque sensor for the place of the bends"
)


def _names(logs: Sequence[Dataset]) -> str:
    return logs[0].label or logs[0].name if len(logs) == 1 else f"{len(logs)} logs"


def _variant(model: TendonSheath, p: FloatArray) -> TendonSheath:
    """Return the model with the stiffness, the centre of the bends and the friction angle of `p`."""
    return varied(model, float(p[0]), float(p[1]), float(p[2]))


def _foretold(log: TendonLog, model: TendonSheath, p: FloatArray) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    return foretold(log, _variant(model, p), float(p[3]))


def _linear(
    logs: list[TendonLog],
    model: TendonSheath,
    p: FloatArray,
    free: list[int],
    step: FloatArray,
    sensor: bool,
    labels: list[NDArray[np.int64]],
) -> tuple[FloatArray, FloatArray, NDArray[np.int64], float]:
    """Return regressors, residuals and block labels of one iteration, and the RMS error of the elongation (m).

    Regressors and residuals of each channel are divided by the RMS error of that channel.
    """
    count = len(logs)
    parts: tuple[list[_Part], list[_Part]] = ([], [])  # of the elongation, of the joint torque
    for n, log in enumerate(logs):
        stretch, torque, known = _foretold(log, model, p)
        if float(np.count_nonzero(known)) * log.period < LEAST_SLID:
            raise TooStillError(
                f"{log.name}: the tendons did not slide all along in both directions; move the joint both ways, or "
                "give a held joint more torque than the friction takes"
            )

        def at(q: FloatArray, log: TendonLog = log) -> Foretold:
            return _foretold(log, model, q)

        columns = _derivatives(at, log, p, [place for place in free if place < 4], step)
        columns[0, :, 4 + n] = columns[1, :, 4 + count + n] = 1.0
        rests = [log.stretch - stretch - p[4 + n]]
        if log.tau_j is not None and sensor:
            rests.append(log.tau_j - torque - p[4 + count + n])
        for channel, rest in enumerate(rests):
            parts[channel].append((columns[channel][known][:, free], rest[known], labels[n][known]))
    rows, residuals, deviations = zip(*(_scaled(part) for part in parts if part), strict=True)
    whole, bad = np.concatenate(rows), np.concatenate(residuals)
    blocks = np.concatenate([each[2] for part in parts for each in part])
    finite = np.isfinite(whole).all(axis=1) & np.isfinite(bad)
    return whole[finite], bad[finite], blocks[finite], deviations[0]


def _derivatives(
    at: Callable[[FloatArray], Foretold], log: TendonLog, p: FloatArray, places: Sequence[int], step: FloatArray
) -> FloatArray:
    """Return the derivatives (2, n, size of p) of elongation and joint torque with respect to the parameters `places`.

    The derivatives with respect to the other parameters are 0.
    """
    columns = np.zeros((2, log.stretch.size, p.size))
    for place in places:
        up, down = p.copy(), p.copy()
        up[place] += step[place]
        down[place] -= step[place]
        a, b = at(up), at(down)
        for channel in range(2):
            columns[channel, :, place] = (a[channel] - b[channel]) / (2.0 * step[place])
    return columns


def _scaled(part: Sequence[_Part]) -> tuple[FloatArray, FloatArray, float]:
    """Return regressors and residuals of one channel over all logs, divided by the RMS residual, and this RMS value."""
    rest = np.concatenate([each[1] for each in part])
    deviation = float(np.sqrt(np.mean(np.square(rest))))
    return np.concatenate([each[0] for each in part]) / deviation, rest / deviation, deviation


def _result(
    logs: list[TendonLog], model: TendonSheath, p: FloatArray, half: dict[int, float], rms: float, sensor: bool
) -> StretchFit:
    found = _variant(model, p)
    stiffness, x, centre = found.axial_stiffness, found.friction_angle, float(p[1])
    notes = []
    place = None
    if sensor:
        place = Quantity(centre, max(0.0, centre - half[1]), min(1.0, centre + half[1]), "1")
        if centre > MOST_CENTRE:
            notes.append(
                f"the bends lie at {centre:.2f} of the sheath (0 motor, 1 joint): beyond {MOST_CENTRE:g} the stretch "
                "does not tell the joint torque; a joint torque sensor does"
            )
    else:
        notes.append(
            f"without a joint torque sensor the place of the bends (s_c {centre:.2f}, from the file) is not parted "
            "from the friction; one log with the sensor does that"
        )
    uncertainty = math.expm1(half[0])
    loops = [sliding(found, 1.0, x * math.exp(side * half[2])).half_loop for side in (0.0, -1.0, 1.0)]
    model = dataclasses.replace(
        found,
        axial_stiffness_uncertainty=uncertainty,
        bending_centre_uncertainty=half[1] if sensor else model.bending_centre_uncertainty,
    )
    tension = remark(model, reached(log.tau_m for log in logs))
    if tension:
        notes.append(tension)
    return StretchFit(
        axial_stiffness=Quantity(stiffness, stiffness * math.exp(-half[0]), stiffness * math.exp(half[0]), "N"),
        centre=place,
        friction_angle=Quantity(x, x * math.exp(-half[2]), x * math.exp(half[2]), "1"),
        half_loop_torque=Quantity(loops[0], loops[1], loops[2], "N*m"),
        motor_inertia=Quantity(float(p[3]), float(p[3] - half[3]), float(p[3] + half[3]), "kg*m^2"),
        zeros={
            log.name: Quantity(z, z - half[4 + n], z + half[4 + n], "m")
            for n, (log, z) in enumerate(zip(logs, p[4 : 4 + len(logs)].tolist(), strict=True))
        },
        rms=rms,
        notes=tuple(notes),
        model=model,
    )


# Estimate the curvature profile from logs with a joint torque sensor.
#
# Sliding reveals only the centre of the bends. A reversal reveals the rest: its slip front runs from the motor through
# one bend after another, and meanwhile its position determines elongation and joint torque. The profile is described by
# the positions of `PLACES` equal shares of the bending. The Gauss-Newton method finds these positions, stiffness,
# friction and motor inertia with the least error of elongation and joint torque. If the log contains no information,
# the positions of the given profile are kept. Modelling two bends with a straight piece between them as one even bend
# causes an error of up to 20 mN*m RMS of 300 mN*m on simulated rigs.

PLACES = 6  # number of positions; 8 do not improve the result on simulated rigs
SHARES = (np.arange(PLACES) + 0.5) / PLACES  # cumulative shares of the bending, at the middle of equal parts
SPREAD = 0.1  # prior standard deviation of a position, as a share of the length
ALIKE_FOR = 0.1  # s, correlation time of the tendon model's error: samples within it count as one
ENOUGH = 2e-3  # share of the length: the search ends when all positions move by less
# Steps of ln k, ln x, J_M and the positions for derivatives: they exceed single contacts
COURSE_STEPS = np.array([0.01, 0.02, 1e-5, *np.full(PLACES, 0.01)])
# Largest change of the same parameters in one iteration, so that the search converges
COURSE_MOST = np.array([0.1, 0.1, 1e-4, *np.full(PLACES, 0.08)])
DIGITS = 4  # decimals of a position, more than the logs determine


def course_of(places: FloatArray) -> Points:
    """Return the profile through these positions (shares of the length), extended by half a share at each end."""
    low = max(0.0, places[0] - 0.5 * (places[1] - places[0]))
    high = min(1.0, places[-1] + 0.5 * (places[-1] - places[-2]))
    points = [(0.0, 0.0), (low, 0.0), *zip(places, SHARES, strict=True), (high, 1.0), (1.0, 1.0)]
    return tuple(dict.fromkeys((round(float(u), DIGITS), round(float(b), DIGITS)) for u, b in points))


def find_course(logs: Sequence[TendonLog], model: TendonSheath, motor_inertia: float) -> TendonSheath:
    """Return the model with the estimated `bending_course`, stiffness and friction.

    If the centre of the estimated bends is outside the permitted range, the given model is returned.

    Args:
        motor_inertia: kg*m^2, start value of J_M.
    """
    even = np.array(profile_of(model).points)
    begin = np.interp(SHARES, even[:, 1] + 1e-12 * np.arange(len(even)), even[:, 0])
    p = np.concatenate(([0.0, 0.0, motor_inertia], begin))
    held = np.eye(PLACES) - 1.0 / PLACES  # no prior on the centre, because the whole log determines it
    for _ in range(ROUNDS):
        rows, rest = _linear_in_course(logs, model, p)
        seconds = sum(log.stretch.size * log.period for log in logs)
        weight = math.sqrt(ALIKE_FOR * rest.size / seconds) / SPREAD
        prior = np.zeros((PLACES, rows.shape[1]))
        prior[:, 3 : 3 + PLACES] = weight * held
        rest = np.concatenate((rest, prior[:, 3 : 3 + PLACES] @ (begin - p[3:])))
        found = np.linalg.lstsq(np.concatenate((rows, prior)), rest, rcond=None)[0][: p.size]
        change = np.clip(found, -COURSE_MOST, COURSE_MOST)
        p += change
        p[3:] = np.clip(np.maximum.accumulate(p[3:]), 0.0, 1.0)
        if np.max(np.abs(change[3:])) < ENOUGH:
            break
    return _with_course(model, p)


def _with_course(model: TendonSheath, p: FloatArray) -> TendonSheath:
    course = Profile(course_of(np.clip(p[3:], 0.0, 1.0)))
    if not CENTRES[0] < course.centre < CENTRES[1]:
        return model
    bent = dataclasses.replace(model, bending_course=course.points, bending_centre=course.centre)
    return varied(bent, float(p[0]), course.centre, float(p[1]))


def _linear_in_course(logs: Sequence[TendonLog], model: TendonSheath, p: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return regressors and residuals of one iteration; the last columns are for the zeros of the two channels.

    Regressors and residuals of elongation and joint torque are each divided by the RMS error of the channel.
    """
    labels = block_labels([log.stretch.size for log in logs])
    parts: tuple[list[_Part], list[_Part]] = ([], [])
    for number, log in enumerate(logs):
        assert log.tau_j is not None

        def at(q: FloatArray, log: TendonLog = log) -> Foretold:
            return foretold(log, _with_course(model, q), float(q[2]))

        *first, known = at(p)
        derivatives = _derivatives(at, log, p, range(p.size), COURSE_STEPS)
        columns = np.concatenate([derivatives, np.zeros((2, log.stretch.size, 2 * len(logs)))], axis=2)
        for channel, measured in enumerate((log.stretch, log.tau_j)):
            columns[channel, :, p.size + 2 * number + channel] = 1.0
            rest = measured - first[channel]
            kept = known & np.isfinite(rest) & np.isfinite(columns[channel]).all(axis=1)
            parts[channel].append((columns[channel][kept], rest[kept] - np.median(rest[kept]), labels[number][kept]))
    lines, residuals, _ = zip(*(_scaled(part) for part in parts), strict=True)
    return np.concatenate(lines), np.concatenate(residuals)
