"""Detect a channel with a reversed sign, which makes the transmission of a log appear to create energy.

While the tendons slide, the motor torque balances the joint torque, the friction, and the torques of springs, weight
and inertia. Friction always opposes the motion:

    R tau_M = a tau_J + F sigma + k q + J domega/dt + c,    R = r_J / r_M,    a > 0,    F > 0

Springs, weights and inertia return the energy that they store. They are fitted as well (q, sin q, cos q, domega/dt, 1),
so that F contains only friction, which may change with wrap angle and temperature. A reversed tau_M changes the signs
of a and F, a reversed tau_J the sign of a, and a reversed omega the sign of F. A log is rejected only if a sign is
certain, judged by the scatter between blocks of time and by the size of the residual.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.redundancy import BAND, compare, judge
from tsa_ctrl.identify.three_errors import UNKNOWN
from tsa_ctrl.identify.torque_scale import FRICTION_FACTOR, most_friction, torque_scale
from tsa_ctrl.identify.units import in_other_units
from tsa_ctrl.model.parameters import GearedDrive, Model, TendonSheath
from tsa_ctrl.model.predict import predict
from tsa_ctrl.model.signals import last_reversal, low_pass
from tsa_ctrl.model.steady_sliding import reversal_travel
from tsa_ctrl.model.steady_sliding import sliding as steady_sliding

Array = NDArray[np.float64]

BLOCKS = 12  # blocks of time, the clusters of the standard errors: t with 11 degrees of freedom is 2.2
# Standard errors at which a sign is certain. A good log must not be rejected; with 12 blocks one in 2,500 exceeds this.
CERTAIN = 5.0
CLEAR = 0.5  # least size of a term over the residual's RMS: a smaller one may be an error of the fit
CARRIES = 0.2  # share of the motor torque's deviation that the joint torque must explain before its sign is judged
MOVES = 0.01  # rad, standard deviation of an angle; the integral of velocity noise stays below it
RELATED = 0.5  # least correlation of an angle with the integral of its velocity
# Most samples of a fit, 50,000 for each of 12 blocks: of a longer log, only every second, third ... sample is used.
# A fit of all samples of an hour at 1 kHz would require 0.6 GB, more than any other part of a diagnosis.
MOST = 600_000
FOLLOWS = 0.5  # least correlation of measured and simulated torque; it is 0.9 or more if they belong together
CHANGES = 0.3  # least change relative to the simulated torque: with less, the load is constant
FEWEST = 200  # least number of samples for a correlation
VARIES = 0.15  # share of the friction torque: friction varies by a tenth with speed, position and time
UNRELATED = 1.4  # mean square of the differences over the variance: 2 for white noise, 0 for a smooth signal
FEWEST_MEANS = 20  # least number of means: it determines their spread to a sixth
THROUGH = 1.0  # joint travel after a reversal, in units of the travel in which the reversal runs through the sheath
SURE = 3.0  # standard errors by which a friction torque must lie outside: one log in 400 does so by chance
SLIDING = 0.1  # share of the velocity's 95th percentile; slower samples may stick


@dataclass(frozen=True)
class _Signs:
    """Hold the signs of a and F, or 0 if they are uncertain, and F with its standard error `doubt`, N*m."""

    gain: int
    friction: int
    friction_torque: float
    doubt: float


def check_energy(dataset: Dataset, model: Model) -> None:
    """Raise UsageError, with the name of the channel, if a sign in the log makes its transmission create energy.

    Logs that are too short or that contain too little motion in both directions are not checked.
    """
    if isinstance(model, TendonSheath):
        _check_kinematics(dataset)
        if "tau_j" in dataset:
            _check_transmission(dataset, model)
    else:
        _check_drive(dataset, geared=isinstance(model, GearedDrive))


def _check_kinematics(dataset: Dataset) -> None:
    """Raise UsageError if an angle and its recorded velocity have opposite signs or are not the same motion."""
    for angle, velocity in (("q_j", "omega_j"), ("q_m", "omega_m")):
        if angle in dataset and velocity in dataset and velocity not in dataset.derived:
            rate = np.gradient(dataset[angle], dataset.period)
            if _opposed(rate, dataset[velocity]):
                raise UsageError(
                    f"{dataset.label}: column {velocity} runs against d{angle}/dt: one of the two is reversed; turn "
                    "its sign"
                )
            if _unrelated(dataset[angle], dataset[velocity], dataset.period):
                raise UsageError(
                    f"{dataset.label}: column {velocity} is not the velocity of {angle} (its integral does not follow "
                    f"{angle}): are two columns swapped? Rename them, or leave {velocity} out"
                )


def _unrelated(angle: Array, velocity: Array, period: float) -> bool:
    """Return True if an angle and the integral of its velocity clearly are not the same motion."""
    line = np.linspace(-1.0, 1.0, len(angle))
    turned, integral = (y - np.mean(y) for y in (angle, np.cumsum(velocity) * period))
    turned, integral = (y - line * float(line @ y) / float(line @ line) for y in (turned, integral))
    sizes = float(np.std(turned)), float(np.std(integral))
    return min(sizes) > MOVES and float(np.mean(turned * integral)) < RELATED * sizes[0] * sizes[1]


def _check_transmission(dataset: Dataset, model: TendonSheath) -> None:
    omega = dataset["omega_j"]
    sliding = _sliding(omega)
    tau_m = dataset["tau_m"] * (model.joint_pulley_radius / model.motor_pulley_radius)
    found = _signs(dataset, tau_m, omega, sliding, dataset["tau_j"])
    if found is None:
        return
    gain, friction = found.gain, found.friction
    velocity = "omega_j" if "omega_j" not in dataset.derived else "q_j"
    against = "omega_m" in dataset and _opposed(omega[sliding], dataset["omega_m"][sliding])
    motor_velocity = "omega_m" if "omega_m" not in dataset.derived else "q_m"
    if gain < 0:
        if friction == 0:
            return
        channel = "tau_j" if friction > 0 else "tau_m"
    elif friction < 0:
        if gain > 0:
            raise UsageError(
                f"{dataset.label}: column {velocity} is reversed, or columns tau_m and tau_j are swapped: as recorded "
                "the transmission creates energy (allowed: tau_m omega_m > 0 is work put in, tau_j omega_j > 0 work "
                "given out); turn the velocity's sign, or rename the two columns"
            )
        channel = velocity if against else f"tau_m or {velocity}"
    elif against:
        channel = motor_velocity if friction > 0 else f"{motor_velocity} or {velocity}"
    else:
        return
    raise UsageError(
        f"{dataset.label}: column {channel} is reversed: as recorded the transmission creates energy (allowed: tau_m "
        "omega_m > 0 is work put in, tau_j omega_j > 0 work given out, omega_m and omega_j of one sign); turn its "
        "sign, unless two columns are swapped"
    )


def foreign_torque(dataset: Dataset, model: Model) -> str:
    """Return the reason why the torques of a log cannot belong to its motion or to this model; empty without one.

    The measured joint torque is compared with the simulated one. Apart from motion and weight, it must follow the
    simulated torque. Its friction torque F must not be negative, nor exceed FRICTION_FACTOR times the largest value
    that [uncertainty] allows. A friction torque is rejected only if its whole interval is outside this range. The size
    of the measured torque has a similar upper limit (`torque_scale`).
    """
    if not isinstance(model, TendonSheath) or "tau_j" not in dataset or model.friction_angle <= 0.0:
        return ""
    for name in ("tau_m", "tau_j"):
        if float(np.ptp(dataset[name])) == 0.0:
            return f"column {name} does not change at all: is the torque recorded?"
    omega, tau_j = dataset["omega_j"], dataset["tau_j"]
    tau_m = dataset["tau_m"] * (model.joint_pulley_radius / model.motor_pulley_radius)
    sliding = _sliding(omega) & _has_direction(omega, dataset.period)
    other = "; is a column of another log or of another drive, is it noise, or are two columns swapped?"
    if is_noise(tau_j):
        return f"column tau_j is noise: its neighbouring samples have nothing in common{other}"
    measured = _signs(dataset, tau_m, omega, sliding, tau_j)
    if measured is None:
        return torque_scale(dataset, model)
    expected = predict(model, dataset.signals())
    pair = low_pass(expected, dataset.period, BAND), low_pass(tau_j, dataset.period, BAND)
    try:
        judge("", "simulated tau_j", "tau_j", compare(*pair, dataset.period), math.inf, signed=False)
    except UsageError as error:
        return str(error).removeprefix(": ")
    correlation = _following(dataset, model, expected, sliding)
    if correlation < FOLLOWS:
        return (
            f"column tau_j does not follow the joint torque that tau_m gives by the model (correlation "
            f"{correlation:.2f}, at least {FOLLOWS:g} is needed){other}"
        )
    simulated = _signs(dataset, tau_m, omega, sliding, expected)
    if simulated is None or not simulated.friction_torque > 0.0:
        return torque_scale(dataset, model)
    spare = FRICTION_FACTOR * most_friction(model)
    factor = measured.friction_torque / simulated.friction_torque
    doubt = SURE * measured.doubt / simulated.friction_torque
    found = f"the friction torque (half the hysteresis width) in tau_m against tau_j is {max(factor, 0.0):.3g} times"
    if factor - doubt > spare:
        return (
            f"{found} the model's, {factor * FRICTION_FACTOR / spare:.3g} times what [uncertainty] allows; torques may "
            f"be {in_other_units(factor / most_friction(model), factor * most_friction(model))}: convert them to N*m, "
            "or give this drive's model"
        )
    # A joint that the torque moves shows only an eighth of its friction here, so only a wrong sign is rejected.
    if factor + doubt < 0.0:
        return f"{found} the model's: friction does not follow the direction of the motion{other}"
    return torque_scale(dataset, model)


def _following(dataset: Dataset, model: TendonSheath, expected: Array, sliding: NDArray[np.bool_]) -> float:
    """Return the correlation of the measured with the simulated joint torque, apart from direction, weight and inertia.

    Both are low-passed at BAND. A sample counts only if the last reversal has run through the whole sheath. The result
    is nan if the measured torque hardly changes compared with the simulated one. The load is then constant, and the
    simulation shows only the ripple of the motor torque. The result is also nan if the simulated torque varies by less
    than the share VARIES of the largest friction that [uncertainty] allows.
    """
    omega, thin = dataset["omega_j"], max(1, len(expected) // MOST)
    angle = dataset["q_j"] if "q_j" in dataset else np.cumsum(omega) * dataset.period
    acceleration = np.gradient(low_pass(omega, dataset.period, BAND), dataset.period)
    apart = [np.sign(omega), angle, np.sin(angle), np.cos(angle), acceleration, np.ones_like(omega)]
    torques = [low_pass(values, dataset.period, BAND) for values in (expected, dataset["tau_j"])]
    path = np.cumsum(np.abs(omega)) * dataset.period
    through = reversal_travel(model)
    here = np.flatnonzero(sliding & (path - path[last_reversal(omega)] > THROUGH * through))[::thin]
    if len(here) < FEWEST:
        return math.nan
    columns = np.column_stack(apart)[here]
    columns /= np.maximum(np.max(np.abs(columns), axis=0), 1e-12)
    simulated, measured = (
        values[here] - columns @ np.linalg.lstsq(columns, values[here], rcond=1e-9)[0] for values in torques
    )
    sizes = float(np.linalg.norm(simulated)), float(np.linalg.norm(measured))
    varies = abs(steady_sliding(model).half_loop) * most_friction(model) * math.sqrt(len(here)) * VARIES
    if sizes[0] <= varies or sizes[1] < CHANGES * sizes[0]:
        return math.nan
    return float(measured @ simulated) / (sizes[0] * sizes[1])


def is_noise(column: Array) -> bool:
    """Return True if neighbouring samples are uncorrelated, and so are neighbouring means over a hundred samples."""
    coarse = column[: len(column) // 100 * 100].reshape(-1, 100).mean(axis=1)
    series = [column, coarse] if len(coarse) >= FEWEST_MEANS else [column]
    return all(float(np.mean(np.diff(y) ** 2)) > UNRELATED * float(np.var(y)) > 0.0 for y in series)


def _check_drive(dataset: Dataset, geared: bool) -> None:
    """Raise UsageError if the friction of a drive creates energy, or if a gear reverses the torque.

    A load may drive the motor through a gear, so only the measured joint torque then determines the sign of the
    friction.
    """
    _check_kinematics(dataset)
    if geared and "tau_j" in dataset and _gear_reverses(dataset):
        raise UsageError(
            f"{dataset.label}: column tau_m or tau_j is reversed: as recorded the joint torque falls when the motor "
            "torque rises; turn the sign of one, unless two columns are swapped"
        )
    if "omega_m" not in dataset or (geared and "tau_j" not in dataset):
        return
    omega = dataset["omega_m"]
    found = _signs(dataset, dataset["tau_m"], omega, _sliding(omega), dataset["tau_j"] if geared else None)
    if found is not None and found.friction < 0:
        velocity = "omega_m" if "omega_m" not in dataset.derived else "q_m"
        raise UsageError(
            f"{dataset.label}: column tau_m or {velocity} is reversed: as recorded the drive's friction creates energy "
            "(allowed: tau_m omega_m > 0 is work put in); turn its sign"
        )


def _gear_reverses(dataset: Dataset) -> bool:
    """Return True if the joint torque of a gear surely falls with the motor torque, apart from motion.

    Friction and inertia of motor and gear act between both torques, springs and weights of the joint do not. A locked
    joint is therefore sufficient.
    """
    velocity = next((name for name in ("omega_j", "omega_m") if name in dataset), None)
    omega = np.zeros(len(dataset["tau_m"])) if velocity is None else dataset[velocity]
    acceleration = np.gradient(omega, dataset.period)
    thin = max(1, len(omega) // MOST)
    columns = [column[::thin] for column in (dataset["tau_j"], np.sign(omega), omega, acceleration)]
    _, _, sign = _terms(columns, dataset["tau_m"][::thin], np.ones(len(columns[0]), dtype=np.bool_))
    return bool(sign[0] < 0.0)


def _sliding(omega: Array) -> NDArray[np.bool_]:
    return np.abs(omega) > SLIDING * float(np.percentile(np.abs(omega), 95.0))


def _has_direction(omega: Array, period: float) -> NDArray[np.bool_]:
    """Return a mask of the samples whose low-passed velocity clearly exceeds the velocity's own content above BAND.

    Only these have a known direction. Friction changes its sign with the direction, so samples with a random direction
    show less friction than there is.
    """
    smooth = low_pass(omega, period, BAND)
    return np.abs(smooth) > UNKNOWN * float(np.std(omega - smooth))


def _opposed(x: Array, y: Array) -> bool:
    """Return True if two velocities are clearly the same motion with opposite signs."""
    scale = float(np.linalg.norm(x)) * float(np.linalg.norm(y))
    return scale > 0.0 and float(x @ y) < -0.8 * scale


def _signs(
    dataset: Dataset, tau_m: Array, omega: Array, sliding: NDArray[np.bool_], tau_j: Array | None
) -> _Signs | None:
    """Return the signs of a and F, or None if the log does not determine them."""
    thin = max(1, len(omega) // MOST)
    sigma, tau_m, sliding = np.sign(omega)[::thin], tau_m[::thin], sliding[::thin]
    if sliding.sum() < 100 or abs(float(np.mean(sigma[sliding]))) > 0.9:
        return None
    column = "q_m" if tau_j is None else "q_j"
    angle = (dataset[column] if column in dataset else np.cumsum(omega) * dataset.period)[::thin]
    acceleration = np.gradient(omega, dataset.period)[::thin]
    torque = [] if tau_j is None else [tau_j[::thin]]
    stored = [angle, np.sin(angle), np.cos(angle), acceleration]
    changing = [dataset[name][::thin] for name in ("theta", "temperature") if name in dataset]
    varying = [sigma * (values - np.mean(values[sliding])) for values in changing]
    value, error, sign = _terms([sigma, *torque, *stored, *varying], tau_m, sliding)
    if not math.isfinite(error[0]):
        return None
    gain = 0
    if torque and abs(value[1]) * float(np.std(torque[0][sliding])) > CARRIES * float(np.std(tau_m[sliding])):
        gain = int(sign[1])
    return _Signs(gain, int(sign[0]), float(value[0]), float(error[0]))


def _terms(columns: list[Array], y: Array, where: NDArray[np.bool_]) -> tuple[Array, Array, Array]:
    """Fit `columns` and a constant to `y`, and return values, standard errors and signs of the columns.

    A sign is 0 unless it is certain. The standard error of a constant column is infinite.
    """
    table = np.column_stack(columns)[where]
    table = table - table.mean(axis=0)
    scale = table.std(axis=0)
    useful = scale > 0.0
    table = table[:, useful] / scale[useful]
    y = y[where] - float(np.mean(y[where]))
    coefficients, *_ = np.linalg.lstsq(table, y, rcond=1e-9)
    residual = y - table @ coefficients
    rms = float(np.sqrt(np.mean(residual**2)))
    errors = _clustered_error(table, residual, np.flatnonzero(where) * BLOCKS // len(where))
    clear = (np.abs(coefficients) > CERTAIN * errors) & (np.abs(coefficients) > CLEAR * rms)
    value, error, sign = np.zeros(len(columns)), np.full(len(columns), math.inf), np.zeros(len(columns))
    value[useful], error[useful] = coefficients / scale[useful], errors / scale[useful]
    sign[useful] = np.where(clear, np.sign(coefficients), 0.0)
    return value, error, sign


def _clustered_error(columns: Array, residual: Array, block: NDArray[np.int64]) -> Array:
    """Return standard errors valid for residuals that are correlated within a block (sandwich, blocks as clusters)."""
    bread = np.linalg.pinv(columns.T @ columns, rcond=1e-9)
    scores = np.stack([columns[block == b].T @ residual[block == b] for b in range(BLOCKS)])
    return np.asarray(np.sqrt(np.diag(bread @ (scores.T @ scores) @ bread)), dtype=np.float64)
