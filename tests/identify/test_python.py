"""The public functions accept arrays, mappings and frames, and their signatures are stable."""

from __future__ import annotations

import html
import inspect
import io
import re
from pathlib import Path

import numpy as np
import pytest

import tsa_ctrl
from tests.conftest import ROOT
from tsa_ctrl.display import Displayed
from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify import diagnose
from tsa_ctrl.identify.calibrate import Calibration
from tsa_ctrl.identify.diagnosis.report.result import Cause, Diagnosis, Experiment, Rms, Verdict
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.model.parameters import TendonSheath

SIGNATURES = Path(__file__).with_name("signatures.txt")
T = np.arange(400) * 0.005
COLUMNS = {"t": T, "tau_m": 0.5 * np.sin(3.0 * T), "q_j": 0.3 * np.sin(2.0 * T), "omega_j": 0.6 * np.cos(2.0 * T)}


class Frame:
    """The interface that pandas and polars have in common: `columns`, and a column by its name."""

    columns = tuple(COLUMNS)

    def __getitem__(self, name: str) -> np.ndarray:
        return COLUMNS[name]


def test_signatures_are_those_that_are_committed() -> None:
    names = sorted({*tsa_ctrl.__all__} - {"__version__", "LeaseLostError"})
    found = "".join(f"{name}{inspect.signature(getattr(tsa_ctrl, name))}\n" for name in names)
    found = re.sub(r" at 0x[0-9a-f]+", "", found)  # address in the default value of a function
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


def test_the_columns_of_one_log_are_no_list_of_logs() -> None:
    """The function of the package takes one log, and that of `identify` takes a list."""
    model = tsa_ctrl.load_model(ROOT / "config/actuator.toml")
    for logs in (COLUMNS, ["x.csv"]):
        with pytest.raises(UsageError, match="not the columns of a log; give a mapping from column to array, several"):
            diagnose(logs, model)  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="column tau_j is missing"):
        diagnose(tsa_ctrl.Dataset.from_arrays(COLUMNS), model)


def shown(result: Displayed) -> str:
    """Check the picture and the table of a notebook, and return the line of a Python session."""
    drawn = io.BytesIO()
    result.plot().savefig(drawn)
    assert len(drawn.getvalue()) > 5_000
    table, line = result._repr_html_(), repr(result)
    assert table.startswith(f"<table><caption>{type(result).__name__}<")
    for value in result.facts().values():
        assert value in line
        assert html.escape(value) in table
    return line


def test_a_log_shows_itself_in_one_line_a_table_and_a_picture() -> None:
    line = shown(tsa_ctrl.Dataset.from_arrays(COLUMNS, "a <log>"))
    assert line == "Dataset(log: a <log>, duration: 1.995 s, rate: 200 Hz, columns: t, tau_m, q_j, omega_j)"


def test_a_calibration_shows_its_estimates_and_errors() -> None:
    quantity = Quantity(0.26, 0.25, 0.27, "1")
    model = tsa_ctrl.load_model(ROOT / "config/actuator.toml")
    assert isinstance(model, TendonSheath)
    found = Calibration(
        friction_angle=quantity,
        pretension=quantity,
        slope=quantity,
        half_loop_torque=quantity,
        split=True,
        condition_number=3.0,
        admitted_seconds=10.0,
        refused=(),
        rms_before=0.08,
        rms_after=0.02,
        rms_given=0.07,
        rms_written=0.03,
        experiment="",
        notes=(),
        model=model,
    )
    assert "friction angle: 0.26 (0.25 to 0.27)" in shown(found)
    assert "held-out error: 0.08 -> 0.02 N·m" in repr(found)


def test_a_diagnosis_shows_its_causes_and_errors() -> None:
    cause = Cause(
        "stribeck_friction", ("presliding_hysteresis",), 0.97, {"static_excess": Quantity(0.61, 0.55, 0.67, "1")}, 0.9
    )
    model = tsa_ctrl.load_model(ROOT / "config/actuator.toml")
    rms = Rms(0.08, 0.06, 0.015, 0.014)
    found = Diagnosis(Verdict.EXPLAINED, "A sentence: more", (cause,), {}, "", {}, {}, Experiment(""), rms, 0.98, model)
    line = shown(found)
    assert "verdict: explained" in line
    assert "stribeck_friction (or presliding_hysteresis): static_excess 0.61 (0.55 to 0.67)" in line
    assert "nominal 0.08, recalibrated 0.06, extended 0.015, sensor noise 0.014" in line
    shown(Diagnosis(Verdict.INSUFFICIENT, "Too short.", (), {}, "", {}, {}, Experiment(""), Rms(), 0.0, model))
