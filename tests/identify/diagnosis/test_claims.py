"""Verdicts and causes on logs that are synthesised from the equations, without the package's model."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.blind.cases import finish, none_case, single_case
from tests.identify.diagnosis.nominal import MODEL, diagnosed, model, named
from tsa_ctrl.identify import diagnose
from tsa_ctrl.identify.diagnosis.report.result import Verdict

R_J, R_M, X, PRETENSION = 0.025, 0.02, 0.26, 45.0
NOISE = 0.012  # N*m
RATE, SECONDS = 250.0, 24.0

Array = NDArray[np.float64]
Columns = dict[str, Array]


def coloured(rng: np.random.Generator, count: int) -> Array:
    """Return (count,) samples of noise with RMS 1 and a memory of 16 ms."""
    out = np.convolve(rng.normal(size=count + 60), np.exp(-np.arange(61) / 4.0), "valid")
    return np.asarray(out / out.std())


def log(seed: int, flaw: str = "") -> Columns:
    """Return a log with three sines of the joint angle and four of the motor torque.

    `flaw` is the fault of the drive that reports the torque, or of the joint torque sensor.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(round(SECONDS * RATE)) / RATE
    swings = zip(rng.uniform(0.2, 0.5, 3), rng.uniform(0.0, 6.28, 3), strict=True)
    q = np.sum([0.6 / (1 + k) * np.sin(6.28 * f * t + phase) for k, (f, phase) in enumerate(swings)], axis=0)
    omega = np.gradient(q, t)
    loads = zip(rng.uniform(0.2, 0.4, 4), rng.uniform(0.1, 0.9, 4), rng.uniform(0.0, 6.28, 4), strict=True)
    tau_m = np.sum([size * np.sin(6.28 * f * t + phase) for size, f, phase in loads], axis=0)
    acting, told = tau_m, tau_m
    if flaw == "the winding warms up":
        acting = tau_m * (1.0 + 0.12 * np.expm1(-t / 10.0))
    elif flaw == "the voltage is limited":
        most = np.maximum(0.85 - 0.25 * np.abs(omega), 0.05)
        acting = np.where(tau_m * omega > 0.0, np.clip(tau_m, -most, most), tau_m)
    elif flaw == "small torques are reported as 0":
        told = np.where(np.abs(tau_m) < 0.12, 0.0, tau_m)
    half = acting / (2.0 * R_M)
    tau_j = R_J * ((PRETENSION + half) * np.exp(-np.sign(omega) * X) - (PRETENSION - half) * np.exp(np.sign(omega) * X))
    told = told + rng.normal(0.0, 0.002, len(t))
    omega = omega + rng.normal(0.0, 0.003, len(t))
    return {"t": t, "tau_m": told, "omega_j": omega, "q_j": q, "tau_j": tau_j + NOISE * coloured(rng, len(t))}


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.soak), pytest.param(2, marks=pytest.mark.soak)])
@pytest.mark.parametrize(
    "flaw", ["the winding warms up", "the voltage is limited", "small torques are reported as 0", ""]
)
def test_only_a_flat_error_is_consistent(flaw: str, seed: int) -> None:
    found = diagnose({"log": log(seed, flaw)}, model())
    assert (found.verdict is Verdict.CONSISTENT) == (not flaw), found.unexplained
    assert found.verdict is not Verdict.EXPLAINED


@pytest.mark.parametrize("effect", ["", "velocity_lag", "stribeck_friction"])
@pytest.mark.parametrize("seeds", [2, pytest.param(20, marks=pytest.mark.soak)])
def test_one_rig_has_one_answer_or_its_group_whatever_its_noise(effect: str, seeds: int) -> None:
    drawn = single_case(effect, 7000, True) if effect else none_case("rich", 7000, True)
    assert drawn.bench is not None
    answers = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        truth = drawn.truth
        case = finish(rng, drawn.family, drawn.name, seed, drawn.bench, truth.effects, truth.noise, "rich")
        answers.append(named(diagnosed(case)))
    if effect:
        assert all(len(names) == 1 and effect in names[0] for names in answers), answers
    else:
        assert answers == [[]] * seeds


def sensor(flaw: str, tau: Array, forces: Array) -> Array:
    """Return the reading of a faulty torque sensor, N*m, for a joint torque in N*m and a sum of tendon forces in N."""
    peak, size = float(np.max(np.abs(tau))), float(np.std(tau))
    if flaw.startswith("gain"):
        return np.where(tau > 0.0, tau, float(flaw.split()[1]) * tau)
    readings = {
        "soft limit": 1.5 * peak * np.tanh(tau / (1.5 * peak)),
        "curved bridge": tau + 0.1 * tau**2 / peak,
        "dead zone": np.sign(tau) * np.maximum(np.abs(tau) - 0.1 * size, 0.0),
        "axial force": tau + 0.05 * R_J * forces,
    }
    return readings[flaw]


def sensor_log(seed: int, flaw: str, rubs: float, steady: bool) -> Columns:
    """Return a log of a faulty torque sensor on a rig with friction angle `rubs`; `steady` motion has one speed."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(SECONDS * RATE)) / RATE
    swings = zip(rng.uniform(0.2, 0.5, 3), rng.uniform(0.0, 6.28, 3), strict=True)
    q = np.sum([0.6 / (1 + k) * np.sin(6.28 * f * t + phase) for k, (f, phase) in enumerate(swings)], axis=0)
    if steady:
        q = np.convolve(np.pad(2.0 * np.abs(0.22 * t % 1.0 - 0.5), 25, mode="edge"), np.full(51, 1.0 / 51.0), "valid")
    omega = np.gradient(q, t)
    loads = zip(rng.uniform(0.2, 0.4, 4), rng.uniform(0.1, 0.9, 4), rng.uniform(0.0, 6.28, 4), strict=True)
    tau_m = np.sum([size * np.sin(6.28 * f * t + phase) for size, f, phase in loads], axis=0)
    half, sigma = tau_m / (2.0 * R_M), np.sign(omega)
    a, b = (PRETENSION - half) * np.exp(sigma * rubs), (PRETENSION + half) * np.exp(-sigma * rubs)
    tau_j = sensor(flaw, R_J * (b - a), a + b) + 0.01 * coloured(rng, len(t))
    measured = {"tau_m": tau_m + rng.normal(0.0, 0.003, len(t)), "omega_j": omega + rng.normal(0.0, 0.003, len(t))}
    return {"t": t, **measured, "q_j": q, "tau_j": tau_j}


@pytest.mark.parametrize("flaw", ["gain 0.85", "gain 1.1", "soft limit", "curved bridge", "dead zone", "axial force"])
@pytest.mark.parametrize(("rubs", "steady"), [(0.26, False), (0.5, True), (0.75, False)])
def test_an_error_of_the_torque_sensor_is_never_named_as_a_certain_cause(flaw: str, rubs: float, steady: bool) -> None:
    """The catalogue does not contain these errors. A cause then has alternatives, or none is named."""
    rig = model(MODEL.replace("friction_coefficient = 0.1", f"friction_coefficient = {rubs / 2.6}"))
    found = diagnose({"log": sensor_log(3, flaw, rubs, steady)}, rig)
    assert found.causes or found.verdict is not Verdict.EXPLAINED
    assert all(cause.alternatives for cause in found.causes), found.sentence
