"""The public names on arrays, mappings and frames, and their signatures, which are stable."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import numpy as np
import pytest

import tsa_ctrl
from tests.conftest import ROOT
from tsa_ctrl.errors import UsageError

SIGNATURES = Path(__file__).with_name("signatures.txt")
T = np.arange(400) * 0.005
COLUMNS = {"t": T, "tau_m": 0.5 * np.sin(3.0 * T), "q_j": 0.3 * np.sin(2.0 * T), "omega_j": 0.6 * np.cos(2.0 * T)}


class Frame:
    """What pandas and polars have in common: `columns`, and a column by its name."""

    columns = tuple(COLUMNS)

    def __getitem__(self, name: str) -> np.ndarray:
        return COLUMNS[name]


def test_signatures_are_those_that_are_committed() -> None:
    names = sorted({*tsa_ctrl.__all__} - {"__version__", "LeaseLostError"})
    found = "".join(f"{name}{inspect.signature(getattr(tsa_ctrl, name))}\n" for name in names)
    found = re.sub(r" at 0x[0-9a-f]+", "", found)  # of a default that is a function
    assert found == SIGNATURES.read_text(encoding="utf-8")


def test_a_mapping_a_frame_and_a_file_give_the_same_prediction(tmp_path: Path) -> None:
    model = tsa_ctrl.load_model(ROOT / "config/actuator.toml")
    np.savetxt(
        tmp_path / "x.csv", np.column_stack(list(COLUMNS.values())), "%.17g", ",", header=",".join(COLUMNS), comments=""
    )
    predicted = tsa_ctrl.predict(model, COLUMNS)
    assert predicted.shape == T.shape
    np.testing.assert_array_equal(tsa_ctrl.predict(model, Frame()), predicted)
    np.testing.assert_allclose(
        tsa_ctrl.predict(ROOT / "config/actuator.toml", tmp_path / "x.csv"), predicted, rtol=1e-9
    )


def test_calibrate_and_diagnose_take_a_frame() -> None:
    with pytest.raises(UsageError, match="tau_j"):
        tsa_ctrl.calibrate(Frame(), tsa_ctrl.load_model(ROOT / "config/actuator.toml"))
    with pytest.raises(UsageError, match="tau_j"):
        tsa_ctrl.diagnose([Frame()], tsa_ctrl.load_model(ROOT / "config/actuator.toml"))


def test_what_is_no_log_is_rejected_in_words() -> None:
    with pytest.raises(UsageError, match="is a int; give a Dataset"):
        tsa_ctrl.predict(ROOT / "config/actuator.toml", 3)
