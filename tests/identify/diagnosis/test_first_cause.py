"""A first cause that fits the sum of several others: the measured cable drive, with one load left out."""

from __future__ import annotations

from pathlib import Path

import pytest

from tsa_ctrl.identify.dataset import load_logs
from tsa_ctrl.identify.diagnosis import diagnose
from tsa_ctrl.model.parameters import load_model

EXPECTED = ("presliding_hysteresis", "load_dependent_friction")


@pytest.mark.soak
@pytest.mark.parametrize("load", ["030", "070"])
def test_torque_saturation_does_not_replace_presliding_and_friction_by_load(data_dir: Path, load: str) -> None:
    """Torque saturation fits the other loads best of all single causes, with an error of 20 mN*m at the load left out.

    Fits by hand with the published causes reach 7 mN*m over all loads.
    """
    files = sorted((data_dir / "davinci").glob("load*_0.3Hz.csv.gz"))
    if not files:
        pytest.skip("the measured data here have no davinci")
    found = diagnose(load_logs(files), load_model(data_dir / "davinci" / "actuator.toml"), hold_out=f"load{load}*")
    named = [{cause.effect, *cause.alternatives} for cause in found.causes]
    assert all(any(name in group for group in named) for name in EXPECTED)
    assert not any("torque_saturation" in group for group in named)
    assert found.rms.extended is not None
    assert found.rms.extended < 0.008  # N*m
