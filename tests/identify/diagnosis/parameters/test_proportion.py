"""x and T_p of the model that a diagnosis writes keep the file's proportion, and an active bound is reported."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.identify.diagnosis.nominal import T, model
from tsa_ctrl.identify import Diagnosis, diagnose
from tsa_ctrl.identify.diagnosis.report.words import remarks
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import TendonSheath

X, PRETENSION, R_J, R_M = 0.26, 45.0, 0.025, 0.02


def diagnosed(x: float, pretension: float, gain: float = 1.0) -> tuple[Diagnosis, TendonSheath]:
    """Return the diagnosis of a log by (3.55) in one configuration, and the model that it writes.

    `gain` scales the slope alone.
    """
    rng = np.random.default_rng(3)
    omega = np.cos(2.0 * np.pi * 0.4 * T)
    tau_m = 0.4 * np.sin(2.0 * np.pi * 0.17 * T) + 0.1
    tau_j = R_J * (gain * tau_m / R_M * math.cosh(x) - 2.0 * pretension * np.sign(omega) * math.sinh(x))
    columns = {
        "t": T,
        "tau_m": tau_m + 1e-3 * rng.normal(size=T.size),
        "omega_j": omega,
        "tau_j": tau_j + 0.05 * rng.normal(size=T.size),
    }
    result = diagnose([columns], model())
    assert isinstance(result.model, TendonSheath)
    return result, result.model


def half_loop(x: float, pretension: float) -> float:
    return 2.0 * pretension * R_J * math.sinh(x)


@pytest.mark.slow
def test_an_interval_includes_the_direction_that_the_logs_do_not_determine() -> None:
    """One configuration does not separate the torque gain from x: 1 % of gain equals several per cent of x.

    The interval of the gain had a width of 0.001, at a value that the bound of x determined.
    """
    result, _ = diagnosed(X, PRETENSION, gain=1.15)
    (cause,) = result.causes
    assert cause.effect == "torque_constant_error"
    error = cause.parameters["relative_error"]
    assert isinstance(error, Quantity)
    assert error.low < 0.15 < error.high
    assert 0.01 < error.high - error.low < 0.08
    assert not result.at_bounds


@pytest.mark.slow
def test_a_slope_that_is_slightly_off_does_not_drive_the_pretension_to_its_bound() -> None:
    """The torque channel reads 1.2 % low. Plain least squares would compensate for it with x, and for x with T_p."""
    result, written = diagnosed(0.28, 42.75, gain=0.988)
    assert written.pretension / PRETENSION == pytest.approx(written.friction_angle / X, rel=1e-6)
    assert half_loop(written.friction_angle, written.pretension) == pytest.approx(half_loop(0.28, 42.75), rel=0.02)
    assert not result.at_bounds
    assert "bound" not in " ".join(remarks(result))
    assert {"friction_angle", "pretension"}.isdisjoint(result.parameter_errors)


@pytest.mark.slow
def test_a_bound_that_holds_x_and_pretension_is_said() -> None:
    """The torque channel reads 8 % high. Recalibration compensates for it with x, as far as T_p may fall."""
    result, written = diagnosed(X, PRETENSION, gain=1.08)
    assert set(result.at_bounds) == {"pretension"}
    assert written.pretension == pytest.approx(0.8 * PRETENSION, rel=1e-4)
    said = " ".join(remarks(result))
    assert "The pretension of the model that is written, 36 N, is at its bound" in said
    assert "allows 36 to 56.25 N" in said
    assert result.to_dict()["at_bounds"]["pretension"]["low"] == pytest.approx(36.0)


@pytest.mark.slow
def test_errors_in_reversals_do_not_hide_an_error_while_sliding() -> None:
    """The friction reverses within 10 ms, and the sheaths of the tendons differ: x(1 + k/2) and x(1 - k/2)."""
    rng = np.random.default_rng(8)
    x, asymmetry, noise = 0.95 * X, -0.75, 6e-3
    omega = 2.0 * np.cos(2.0 * np.pi * 0.9 * T)
    direction = np.sign(omega)
    tau_m = 0.5 * np.sin(2.0 * np.pi * 0.17 * T) + 0.2

    def torque(x: float, pretension: float, asymmetry: float) -> Array:
        first = (pretension + tau_m / (2.0 * R_M)) * np.exp(-direction * x * (1.0 - 0.5 * asymmetry))
        second = (pretension - tau_m / (2.0 * R_M)) * np.exp(direction * x * (1.0 + 0.5 * asymmetry))
        return np.asarray(R_J * (first - second))

    sharp = torque(x, 1.06 * PRETENSION, asymmetry)
    columns = {"t": T, "tau_m": tau_m, "omega_j": omega, "tau_j": np.convolve(sharp, np.ones(5) / 5.0, mode="same")}
    columns["tau_j"] += noise * rng.normal(size=T.size)
    result = diagnose([columns], model())
    written = result.model
    assert isinstance(written, TendonSheath)
    found = float(written.effects["sheath_asymmetry"]["relative_difference"])
    reversal = np.convolve(np.diff(direction, prepend=direction[0]) != 0.0, np.ones(31), mode="same") > 0.5
    sliding = ~reversal & (T > 0.1) & (T[-1] - 0.1 > T)
    residual = columns["tau_j"] - torque(written.friction_angle, written.pretension, found)
    assert float(np.sqrt(np.mean(residual[sliding] ** 2))) < 1.06 * noise
