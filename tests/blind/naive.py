"""Baseline strategies that always look for effects. A diagnosis must be better than they are.

Four strategies use one bank of features: forward selection by BIC, the model with the best validation error, the
LASSO with cross-validation, and sequentially thresholded least squares. Each gets the same logs and nominal model as
the diagnosis, recalibrates first, and reports the effects of the features that it keeps.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numba import njit
from scipy.ndimage import uniform_filter1d
from scipy.optimize import minimize_scalar

from .recording import HiddenLog

Array = np.ndarray

SAMPLES = 4000  # of all logs together: more samples do not change the result of any strategy
SHARE_KEPT = 0.1  # of the residual's RMS: thresholded least squares removes smaller terms


@dataclass(frozen=True)
class Bank:
    """Standardised features, the effect of each feature, and the residual of the recalibrated plain model."""

    columns: Array  # (n, features), mean square 1
    names: tuple[str, ...]
    residual: Array


def name_effects(logs: list[HiddenLog], model: str) -> dict[str, list[str]]:
    """Return the effects that each strategy reports for these logs of a tendon-sheath actuator.

    `model` is the text of the nominal model file.
    """
    bank = feature_bank(logs, tomllib.loads(model))
    strategies: dict[str, Callable[[Bank], list[int]]] = {
        "bic": forward_bic,
        "validation": best_validation,
        "lasso": lasso,
        "stlsq": thresholded,
    }
    return {key: sorted({bank.names[k] for k in strategy(bank)}) for key, strategy in strategies.items()}


def forward_bic(bank: Bank) -> list[int]:
    """Return the indices of the features that greedy forward selection adds up to the minimum of BIC."""
    n = bank.residual.size
    path, sums = _forward_path(bank.columns, bank.residual, most=10)
    scores = [n * np.log(total / n) + k * np.log(n) for k, total in enumerate(sums)]
    return path[: int(np.argmin(scores))]


def best_validation(bank: Bank) -> list[int]:
    """Return the indices of the forward model with the smallest validation error.

    The models are fitted on the first 70 % of the samples and validated on the rest.
    """
    cut = int(0.7 * bank.residual.size)
    train, check = slice(0, cut), slice(cut, None)
    path, _ = _forward_path(bank.columns[train], bank.residual[train], most=10)
    errors = [float(np.mean(bank.residual[check] ** 2))]
    for k in range(1, len(path) + 1):
        chosen = bank.columns[:, path[:k]]
        beta = np.linalg.lstsq(chosen[train], bank.residual[train], rcond=None)[0]
        errors.append(float(np.mean((bank.residual[check] - chosen[check] @ beta) ** 2)))
    return path[: int(np.argmin(errors))]


def lasso(bank: Bank, folds: int = 5) -> list[int]:
    """Return the indices that L1-penalised least squares keeps.

    The penalty comes from cross-validation over contiguous folds.
    """
    x, y = bank.columns, bank.residual
    largest = float(np.max(np.abs(x.T @ y))) / y.size
    penalties = largest * np.logspace(0.0, -2.5, 20)
    edges = np.linspace(0, y.size, folds + 1).astype(int)
    errors = np.zeros((folds, penalties.size))
    for fold, (begin, end) in enumerate(pairwise(edges)):
        kept = np.r_[0:begin, end : y.size]
        betas = _descend(x[kept].T @ x[kept] / kept.size, x[kept].T @ y[kept] / kept.size, penalties)
        errors[fold] = np.mean((y[begin:end, None] - x[begin:end] @ betas.T) ** 2, axis=0)
    best = int(np.argmin(errors.mean(axis=0)))
    beta = _descend(x.T @ x / y.size, x.T @ y / y.size, penalties[: best + 1])[-1]
    return [int(k) for k in np.flatnonzero(beta)]


def thresholded(bank: Bank, rounds: int = 15) -> list[int]:
    """Return the indices that sequentially thresholded least squares keeps, as in sparse identification of dynamics."""
    active = np.arange(bank.columns.shape[1])
    limit = SHARE_KEPT * float(np.sqrt(np.mean(bank.residual**2)))
    for _ in range(rounds):
        x = bank.columns[:, active]
        gram = x.T @ x + 1e-3 * bank.residual.size * np.eye(active.size)
        beta = np.linalg.solve(gram, x.T @ bank.residual)
        large = np.abs(beta) > limit
        if large.all():
            break
        active = active[large]
        if active.size == 0:
            break
    return [int(k) for k in active]


def _forward_path(columns: Array, target: Array, most: int) -> tuple[list[int], list[float]]:
    """Return the indices in order of entry by orthogonal greedy selection, and the residual's sum of squares after
    each.

    The first sum is the one before the first entry.
    """
    work, left = columns.copy(), target.copy()
    path: list[int] = []
    sums = [float(left @ left)]
    for _ in range(min(most, columns.shape[1])):
        energy = np.einsum("ij,ij->j", work, work)
        gains = np.where(energy > 1e-6 * columns.shape[0], (work.T @ left) ** 2 / np.maximum(energy, 1e-12), 0.0)
        gains[path] = 0.0
        best = int(np.argmax(gains))
        if gains[best] <= 0.0:
            break
        direction = work[:, best] / np.sqrt(energy[best])
        left = left - direction * (direction @ left)
        work = work - np.outer(direction, direction @ work)
        path.append(best)
        sums.append(float(left @ left))
    return path, sums


@njit(cache=True)
def _descend(gram: Array, moment: Array, penalties: Array) -> Array:
    """Return the LASSO coefficients, one row per penalty.

    Coordinate descent on the normal equations starts each penalty at the solution of the one before.
    """
    beta = np.zeros(moment.size)
    out = np.empty((penalties.size, moment.size))
    for row in range(penalties.size):
        for _ in range(300):
            change = 0.0
            for k in range(beta.size):
                pull = moment[k] - np.dot(gram[k], beta) + gram[k, k] * beta[k]
                new = np.sign(pull) * max(abs(pull) - penalties[row], 0.0) / max(gram[k, k], 1e-12)
                change = max(change, abs(new - beta[k]))
                beta[k] = new
            if change < 1e-4 * max(np.max(np.abs(beta)), 1e-12):
                break
        out[row] = beta
    return out


def feature_bank(logs: list[HiddenLog], nominal: dict[str, dict[str, float]]) -> Bank:
    """Return the bank of features: one or a few columns for each effect that the logs' columns allow.

    The plain model is recalibrated first.
    """
    r_m, r_j = nominal["actuator"]["motor_pulley_radius"], nominal["actuator"]["joint_pulley_radius"]
    x0 = nominal["sheath"]["friction_coefficient"] * nominal["sheath"]["bending_angle"]
    tension0 = nominal["pretension"]["value"]
    stride = max(1, sum(log.columns["t"].size for log in logs) // SAMPLES)
    whole = [_motion(log) for log in logs]
    tau_m = np.concatenate([log.columns["tau_m"] for log in logs])
    tau_j = np.concatenate([log.columns["tau_j"] for log in logs])
    sigma = np.concatenate([_held_sign(omega) for omega, _, _ in whole])
    bend = np.concatenate(
        [log.columns.get("theta", np.full(log.columns["t"].size, nominal["sheath"]["bending_angle"])) for log in logs]
    )
    share = bend / nominal["sheath"]["bending_angle"]
    extra = _tension_per_bending(nominal) * (bend - nominal["sheath"]["bending_angle"])

    def plain(x: float, tension: float) -> Array:
        return r_j * (tau_m / r_m * np.cosh(x * share) - 2.0 * (tension + extra) * sigma * np.sinh(x * share))

    def fitted(x: float) -> tuple[float, Array]:
        force = plain(x, 0.0) - plain(x, 1.0)
        tension = float(force @ (plain(x, 0.0) - tau_j) / (force @ force))
        tension = float(np.clip(tension, tension0 / 1.25, 1.25 * tension0))
        return tension, tau_j - plain(x, tension)

    best = minimize_scalar(lambda x: float(np.sum(fitted(x)[1] ** 2)), bounds=(x0 / 1.25, 1.25 * x0), method="bounded")
    x = float(best.x)
    tension, residual = fitted(x)
    parts: list[Array] = []
    start = 0
    for log, (omega, acceleration, q) in zip(logs, whole, strict=True):
        part = slice(start, start + omega.size)
        start += omega.size
        base = plain(x, tension)[part]
        names, features = _features(log, omega, acceleration, q, sigma[part], base, tau_m[part], tension, r_m)
        parts.append(features)
    columns = np.concatenate(parts)[::stride]
    scales = np.sqrt(np.mean(columns**2, axis=0))
    kept = np.flatnonzero(scales > 1e-12)
    return Bank(columns[:, kept] / scales[kept], tuple(names[k] for k in kept), residual[::stride])


def _tension_per_bending(nominal: dict[str, dict[str, float]]) -> float:
    tendon, sheath = nominal["tendon"], nominal["sheath"]
    compliance = tendon["unstrained_length"] / tendon["axial_stiffness"]
    if "series_stiffness" in tendon:
        compliance += 1.0 / tendon["series_stiffness"]
    return (sheath.get("contact_offset", 0.0) + 0.5 * tendon["diameter"]) / compliance


def _motion(log: HiddenLog) -> tuple[Array, Array, Array]:
    """Return velocity, acceleration and angle of the joint, measured or derived."""
    step = float(log.columns["t"][1] - log.columns["t"][0])
    width = max(3, round(0.02 / step)) | 1

    def smooth(values: Array) -> Array:
        return uniform_filter1d(uniform_filter1d(values, width), width)

    omega = log.columns.get("omega_j")
    if omega is None:
        omega = np.gradient(smooth(log.columns["q_j"]), step)
    q = log.columns.get("q_j", np.cumsum(omega) * step)
    return omega, np.gradient(smooth(omega), step), q


def _held_sign(omega: Array) -> Array:
    sign = np.sign(omega)
    index = np.where(sign != 0.0, np.arange(sign.size), -1)
    index = np.maximum.accumulate(index)
    return np.where(index >= 0, sign[np.maximum(index, 0)], 1.0)


def _features(
    log: HiddenLog,
    omega: Array,
    acceleration: Array,
    q: Array,
    sigma: Array,
    base: Array,
    tau_m: Array,
    tension: float,
    r_m: float,
) -> tuple[list[str], Array]:
    """Return the names and columns of features, to which each effect of the catalogue is roughly linear."""
    t = log.columns["t"] - log.columns["t"][0]
    step, fast = float(t[1] - t[0]), float(np.quantile(np.abs(omega), 0.98))
    over = np.maximum(np.abs(tau_m) - 2.0 * tension * r_m, 0.0)
    out = [
        ("viscous_friction", omega),
        ("direction_asymmetric_friction", np.abs(omega)),
        ("torque_offset", np.ones_like(t)),
        ("inertia", acceleration),
        ("motor_side_friction", sigma),
        ("torque_constant_error", tau_m),
        ("load_dependent_friction", sigma * np.abs(base)),
        ("sheath_asymmetry", sigma * base),
        ("tension_dependent_friction", sigma * tau_m**2),
        ("tendon_slack", sigma * over),
        ("velocity_lag", np.gradient(sigma)),
    ]
    out += [("stribeck_friction", sigma * np.exp(-((omega / (share * fast)) ** 2))) for share in (0.05, 0.12, 0.3)]
    out += [("pretension_relaxation", -sigma * np.expm1(-t / (share * t[-1]))) for share in (0.1, 0.4, 1.5)]
    for seconds in (0.004, 0.012, 0.03):
        shift = max(1, round(seconds / step))
        out.append(("transport_delay", np.concatenate([np.full(shift, base[0]), base[:-shift]]) - base))
    path = log.columns.get("q_m", q)
    turns = np.concatenate([[0], np.flatnonzero(np.diff(sigma)) + 1])
    since = np.abs(path - path[turns[np.searchsorted(turns, np.arange(t.size), side="right") - 1]])
    out += [("presliding_hysteresis", sigma * np.exp(-since / (share * np.ptp(path)))) for share in (0.01, 0.03, 0.1)]
    if "q_j" in log.columns:
        out += [("gravity_load", np.sin(q)), ("gravity_load", np.cos(q)), ("joint_stiffness", q)]
        out += [("configuration_dependent_bending", sigma * q), ("configuration_dependent_bending", q * tau_m)]
        out += [("pulley_eccentricity", np.sin(q) * base), ("pulley_eccentricity", np.cos(q) * base)]
        out += [("backlash", -base * (since < share * np.ptp(path))) for share in (0.01, 0.04)]
    if "q_m" in log.columns:
        for cycles in (2, 3, 4, 6, 7, 11, 12, 14, 18, 24):
            out += [("torque_ripple", np.sin(cycles * path)), ("torque_ripple", np.cos(cycles * path))]
    if "temperature" in log.columns:
        out.append(("thermal_friction_drift", sigma * (log.columns["temperature"] - 25.0)))
    if "theta" in log.columns:
        bend = log.columns["theta"] - log.columns["theta"].mean()
        out += [("stiffness_nonlinearity", sigma * bend**2), ("elongation_coupling", tau_m * bend)]
    return [name for name, _ in out], np.stack([column for _, column in out], axis=1)
