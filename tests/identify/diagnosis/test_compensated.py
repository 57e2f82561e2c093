"""Logs of a drive that compensates friction: the motor torque has a step at each reversal, and noise.

The logs are written here from (3.55), not by the simulator. Filters of the motor torque respond to its steps, and its
noise near them cannot be separated, so both looked like lags, Stribeck friction or structure of the residual.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.identify.diagnosis.nominal import model
from tsa_ctrl.identify import diagnose
from tsa_ctrl.identify.diagnosis.report.result import Verdict

VISCOUS = 0.05  # N*m*s/rad


def log(seed: int, noise: float, viscous: float, steps: bool) -> dict[str, np.ndarray]:
    """Return a log of 30 s with white noise (N*m RMS) on both torques; without `steps` the joint torque has them."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 30.0, 1.0 / rng.choice([200.0, 500.0]))
    sizes, speeds, phase = (
        rng.uniform([0.2, 0.1], [0.6, 0.3]),
        rng.uniform([0.8, 2.2], [1.8, 4.0]),
        rng.uniform(0.0, 6.0),
    )
    q = sizes[0] * np.sin(speeds[0] * t) + sizes[1] * np.sin(speeds[1] * t + phase)
    omega = sizes[0] * speeds[0] * np.cos(speeds[0] * t) + sizes[1] * speeds[1] * np.cos(speeds[1] * t + phase)
    smooth = 0.6 * np.sin(rng.uniform(1.5, 3.0) * t + 1.0) + 0.2 * np.sin(0.7 * t)
    x, friction = 0.1 * 2.6, np.sign(omega) * 2.0 * 45.0 * 0.025 * np.sinh(0.1 * 2.6)
    if steps:
        tau_j, tau_m = smooth, 0.8 * (smooth + friction) / np.cosh(x)
    else:
        tau_j, tau_m = smooth * np.cosh(x) / 0.8 - friction, smooth
    tau_j = tau_j - viscous * omega + noise * rng.standard_normal(t.size)
    return {"t": t, "tau_m": tau_m + noise * rng.standard_normal(t.size), "q_j": q, "omega_j": omega, "tau_j": tau_j}


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "noise"), [(1, 0.0), (1, 5e-4), (4, 2e-2), *((s, 5e-3) for s in (1, 2))])
def test_an_exact_model_has_no_error(seed: int, noise: float) -> None:
    found = diagnose([log(seed, noise, 0.0, True)], model())
    assert (found.causes, found.verdict) == ((), Verdict.CONSISTENT), found.sentence


@pytest.mark.slow
@pytest.mark.parametrize("steps", [True, False])
@pytest.mark.parametrize(("seed", "noise"), [(1, 0.0), (1, 5e-4), pytest.param(5, 5e-3, marks=pytest.mark.soak)])
def test_viscous_friction_is_the_only_cause(seed: int, noise: float, steps: bool) -> None:
    found = diagnose([log(seed, noise, VISCOUS, steps)], model())
    assert [each.effect for each in found.causes] == ["viscous_friction"], found.sentence
    coefficient = found.causes[0].parameters["coefficient"]
    assert not isinstance(coefficient, str)
    if noise == 0.0:
        assert coefficient.value == pytest.approx(VISCOUS, rel=1e-4)
    else:
        assert coefficient.low <= VISCOUS <= coefficient.high
    assert found.verdict is Verdict.EXPLAINED, found.sentence
