"""An identified cause must beat every simpler prediction on held-out data.

Otherwise the diagnosis reports this.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from tsa_ctrl.identify import diagnose
from tsa_ctrl.identify.diagnosis.parameters.held_out import HeldOut, straight
from tsa_ctrl.identify.diagnosis.refusals import InsufficientError, refuse_useless
from tsa_ctrl.identify.diagnosis.report.result import Verdict
from tsa_ctrl.identify.diagnosis.report.words import remarks
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import RigidDrive

RATE = 200.0
DRIVE = RigidDrive(coulomb_friction=0.3, viscous_friction=0.1)


def _log(seed: int, coulomb: float, seconds: float = 16.0) -> dict[str, Array]:
    """Return a synthetic log of a plain drive with Coulomb friction, viscous friction and noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * RATE)) / RATE
    omega = 2.0 * np.sin(2.0 * np.pi * (0.2 + 0.05 * seed) * t) + 1.0 * np.sin(2.0 * np.pi * 0.73 * t)
    tau_m = coulomb * np.sign(omega) + 0.1 * omega + 0.01 * rng.standard_normal(len(t))
    return {"t": t, "tau_m": tau_m, "omega_m": omega}


@pytest.mark.slow
def test_a_recalibration_that_is_worse_than_as_given_is_told_and_not_shipped() -> None:
    """The training logs have more friction than the model file and the held-out log."""
    logs = {"a": _log(1, 0.36), "b": _log(2, 0.36), "held": _log(3, 0.30)}
    result = diagnose(logs, DRIVE, hold_out="held")
    assert result.causes == ()
    assert result.rms.as_given is not None
    assert result.rms.recalibrated is not None
    assert result.rms.as_given < 0.5 * result.rms.recalibrated
    assert "with the parameters of the model file, the simulation is off by 11" in result.sentence
    told = next(remark for remark in remarks(result) if remark.startswith("Recalibration alone makes it worse"))
    assert told.endswith("the file's parameters are kept.")
    assert result.model == DRIVE


@pytest.mark.slow
def test_a_recalibration_that_is_better_is_shipped() -> None:
    logs = {"a": _log(1, 0.36), "b": _log(2, 0.36), "held": _log(3, 0.36)}
    result = diagnose(logs, DRIVE, hold_out="held")
    assert result.verdict is Verdict.CONSISTENT
    assert isinstance(result.model, RigidDrive)
    assert result.model.coulomb_friction == pytest.approx(0.36, abs=0.005)
    assert "recalibrated, the simulation is off by" in result.sentence
    assert not any(remark.startswith("Recalibration alone") for remark in remarks(result))


def test_a_mean_that_is_right_by_chance_is_no_baseline() -> None:
    """The mean of four loads equals the fifth load. If the four are held out, the error is the spread of the loads."""
    rng = np.random.default_rng(1)
    loads = np.repeat([-2.0, -1.0, 1.0, 2.0, 0.0], 200)
    target = loads + 0.1 * rng.standard_normal(len(loads))
    held = np.arange(len(loads)) >= 800
    run = SimpleNamespace(full=target, full_target=target, full_bin=1)
    frame = Parts(runs=[run], target=target, slices=[slice(0, len(target))])
    split = SimpleNamespace(frame=frame, fit=~held, held=held)
    assert float(np.std(target[held])) < 0.11
    assert straight(split, ()) == pytest.approx(np.sqrt(np.mean(loads[~held] ** 2)), rel=0.02)  # type: ignore[arg-type]


class Parts(SimpleNamespace):
    """The attributes of a frame that a baseline uses."""

    def __len__(self) -> int:
        return len(self.target)


def _errors(**changed: float) -> HeldOut:
    values = {"as_given": 3.0, "recalibrated": 2.0, "extended": 1.0, "noise_floor": 0.5, "constant": 4.0, "line": 2.5}
    return HeldOut(**{**values, **changed}, refitted=0.5, sliding=(2.0, 1.0), lost=(1.0,))


@pytest.mark.parametrize("simpler", ["as_given", "recalibrated", "constant", "line"])
def test_causes_with_which_it_is_no_better_are_refused_with_the_figures(simpler: str) -> None:
    problem = SimpleNamespace(base=SimpleNamespace(target="tau_m", given=RigidDrive()))
    refuse_useless(problem, True, _errors())  # type: ignore[arg-type]
    refuse_useless(problem, False, _errors(**{simpler: 0.9}))  # type: ignore[arg-type]
    with pytest.raises(InsufficientError, match=r"off by 1 N·m RMS, .* by 0\.9 N·m"):
        refuse_useless(problem, True, _errors(**{simpler: 0.9}))  # type: ignore[arg-type]


def test_the_gain_is_against_the_best_of_them() -> None:
    assert _errors().gain == pytest.approx((4.0 - 1.0) / (4.0 - 0.25))
    assert _errors(line=1.5).gain == pytest.approx((2.25 - 1.0) / (2.25 - 0.25))
    assert _errors(as_given=1.0).gain == 0.0
