"""The public functions accept arrays, mappings and frames, and their signatures are stable."""

from __future__ import annotations

import html
import inspect
import io
import math
import re
import tomllib
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

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
from tsa_ctrl.signals import COLUMNS as UNITS

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


SECONDS = [timedelta(seconds=seconds) for seconds in T.tolist()]
MEANINGFUL: dict[str, Any] = {
    "structured": np.rec.fromarrays(list(COLUMNS.values()), names=list(COLUMNS)),
    "lists": {name: values.tolist() for name, values in COLUMNS.items()},
    "objects": {name: values.astype(object) for name, values in COLUMNS.items()},
    "without masked values": {name: np.ma.array(values) for name, values in COLUMNS.items()},
    "dates": {**COLUMNS, "t": np.datetime64("2024-01-01") + (T * 1e9).round().astype("m8[ns]")},
    "durations": {**COLUMNS, "t": (T * 1e6).round().astype("m8[us]")},
    "dates as objects": {**COLUMNS, "t": [datetime(2024, 3, 31, tzinfo=UTC) + each for each in SECONDS]},
    "durations as objects": {**COLUMNS, "t": SECONDS},
    "other columns of any type": {**COLUMNS, "note": "text", "image": np.zeros((3, 4, 5)), 5: None},
}


@pytest.mark.parametrize("columns", MEANINGFUL.values(), ids=MEANINGFUL)
def test_each_meaningful_form_of_a_log_gives_the_same_prediction(columns: Any) -> None:
    model = tsa_ctrl.load_model(ROOT / "config/actuator.toml")
    expected = tsa_ctrl.predict(model, COLUMNS)
    np.testing.assert_allclose(tsa_ctrl.predict(model, columns), expected, atol=1e-6)
    made: Any = tsa_ctrl.Dataset
    np.testing.assert_allclose(tsa_ctrl.predict(model, made(columns)), expected, atol=1e-6)


class Levels(Frame):
    """A frame whose columns have names of several levels, and whose index is the time."""

    def __init__(self, columns: list[tuple[str, ...]]) -> None:
        self.columns: Any = columns
        self.index = (COLUMNS["t"] * 1e9).round().astype("m8[ns]")

    def __getitem__(self, name: Any) -> Any:
        return COLUMNS[next(part for part in name if part in COLUMNS)]


@pytest.mark.parametrize("levels", [("rig", "{}"), ("{}", ""), ("{}", "{unit}")])
def test_a_name_of_several_levels_and_an_index_of_time_are_columns(levels: tuple[str, ...]) -> None:
    """A level that is equal for all columns, empty, or the SI unit is not a part of the name."""
    model = tsa_ctrl.load_model(ROOT / "config/actuator.toml")
    names = [tuple(level.format(name, unit=UNITS[name].unit) for level in levels) for name in COLUMNS if name != "t"]
    np.testing.assert_allclose(tsa_ctrl.predict(model, Levels(names)), tsa_ctrl.predict(model, COLUMNS), atol=1e-6)
    wrong = [(*name[:1], "mN*m") if "tau_m" in name else name for name in names]
    if "{unit}" in levels:
        with pytest.raises(UsageError, match=r"column tau_m is missing \(found: t, tau_m.mN\*m"):
            tsa_ctrl.predict(model, Levels(wrong))


def test_a_masked_value_is_a_missing_value() -> None:
    """A single one is an error, and several in succession are a hole."""
    masked = np.ma.array(COLUMNS["tau_m"], mask=np.arange(400) == 5)
    with pytest.raises(UsageError, match="column tau_m, row 6: found no number"):
        tsa_ctrl.Dataset.from_arrays({**COLUMNS, "tau_m": masked})
    masked.mask = (np.arange(400) >= 5) & (np.arange(400) < 12)
    hole = tsa_ctrl.Dataset.from_arrays({**COLUMNS, "tau_m": masked})
    np.testing.assert_allclose(hole["tau_m"], COLUMNS["tau_m"][12:])


def test_the_content_of_a_model_file_is_a_model() -> None:
    path = ROOT / "config/actuator.toml"
    model = tsa_ctrl.load_model(path)
    content = tomllib.loads(path.read_text(encoding="utf-8"))
    content["tendon"]["diameter"] = np.float64(content["tendon"]["diameter"])
    np.testing.assert_array_equal(tsa_ctrl.predict(content, COLUMNS), tsa_ctrl.predict(model, COLUMNS))
    assert tsa_ctrl.load_model(model) is model
    with pytest.raises(UsageError, match=r"tendon\.diameter: found nan; give a finite number"):
        tsa_ctrl.load_model({**content, "tendon": {**content["tendon"], "diameter": math.nan}})


class Twice(Frame):
    columns = (*COLUMNS, "tau_m")


def wrong_calls() -> dict[str, tuple[Callable[[], Any], str]]:
    package: Any = tsa_ctrl
    files = ROOT / "config"
    controller = package.Controller(files / "controller.toml")
    log, values = package.Dataset(COLUMNS), COLUMNS["tau_m"]
    measured = {"tau_m": 0.0, "q_m": 0.0, "omega_m": 0.0, "q_j": 0.0}

    def column(given: Any, name: str = "tau_m") -> Callable[[], Any]:
        return lambda: package.Dataset({**COLUMNS, name: given})

    def loop(**given: Any) -> Callable[[], Any]:
        paths = {"controller": files / "controller.toml", "plant": files / "plant.toml", "seconds": 0.1}
        return lambda: package.simulate_loop(**{**paths, **given})

    return {
        "Dataset()": (lambda: package.Dataset(), "give the columns of one log"),
        "Controller(model)": (lambda: package.Controller(package.load_model(files / "actuator.toml")), "give its path"),
        "load_model(bytes)": (lambda: package.load_model(b"x"), "found a bytes; give a model, the path"),
        "load_model({})": (lambda: package.load_model({}), "'actuator' is missing"),
        "predict(None)": (lambda: package.predict(None, COLUMNS), "found a NoneType; give a model"),
        "texts": (column(["1"] * 400), "column tau_m is no array of numbers .row 1 is '1'"),
        "marker": (column(np.array([*values[:3], "OVLD", *values[4:]], dtype=object)), "row 4 is 'OVLD'"),
        "iterator": (column(iter(values)), "no array of numbers"),
        "NaT": (column(np.full(400, np.timedelta64("NaT")), "t"), "found no number"),
        "matrix": (column(values[:, None]), r"column tau_m has shape \(400, 1\); give columns of one length \(400,\)"),
        "short": (column(values[1:]), r"column tau_m has shape \(399,\); give columns of one length \(400,\)"),
        "empty": (lambda: package.Dataset({name: [] for name in COLUMNS}), "holds 0 rows; at least 10"),
        "twice": (lambda: package.Dataset(Twice()), "column tau_m appears 2 times; rename or remove"),
        "cutoff": (lambda: package.Dataset.from_arrays(COLUMNS, cutoff="a"), "cutoff in Hz: found 'a'; give a number"),
        "rate": (lambda: log.resampled(0), "rate in Hz: found 0; give a number from"),
        "key": (lambda: log[3], "column 3 is missing"),
        "seed": (lambda: package.diagnose(log, files / "actuator.toml", seed="a"), "seed: found 'a'; give a whole"),
        "hold_out": (lambda: package.diagnose(log, files / "actuator.toml", hold_out=3), "hold_out is a int; give a"),
        "step text": (lambda: controller.step("0.1", **measured), "tau_j_des: found '0.1'; give a number"),
        "skipped": (lambda: controller.step(0.1, **measured, skipped=1.5), "skipped: found 1.5; give a whole number"),
        "loop controller": (loop(controller=None), "controller file: found a NoneType; give its path"),
        "loop seconds": (loop(seconds="1"), "seconds: found '1'; give a number"),
        "loop faults": (loop(faults=[3]), "found 3; give texts or objects of Fault"),
        "Client": (lambda: package.Client(3), "Client: found a int; give the path of the daemon's socket"),
    }


def test_a_wrong_argument_is_reported_in_one_line() -> None:
    for name, (call, said) in wrong_calls().items():
        with pytest.raises(UsageError) as error:
            call()
        assert re.search(said, str(error.value)), f"{name}: {error.value}"
        assert "\n" not in str(error.value)


def test_pandas_and_polars_give_the_same_prediction() -> None:
    model = tsa_ctrl.load_model(ROOT / "config/actuator.toml")
    expected = tsa_ctrl.predict(model, COLUMNS)
    pandas, polars = pytest.importorskip("pandas"), pytest.importorskip("polars")
    stamps = np.datetime64("2024-01-01") + (T * 1e9).round().astype("m8[ns]")
    for frame in (pandas.DataFrame, polars.DataFrame):
        dated = frame({**COLUMNS, "t": stamps, "note": ["x"] * 400})
        np.testing.assert_allclose(tsa_ctrl.predict(model, dated), expected, atol=1e-6)
    values = pandas.DataFrame({name: column for name, column in COLUMNS.items() if name != "t"})
    for index in (pandas.DatetimeIndex(stamps, tz="UTC"), pandas.Index(COLUMNS["t"], name="t")):
        np.testing.assert_allclose(tsa_ctrl.predict(model, values.set_index(index)), expected, atol=1e-6)
    lazy = polars.LazyFrame(COLUMNS)
    np.testing.assert_allclose(tsa_ctrl.predict(model, lazy), expected)
    missing = polars.DataFrame({**COLUMNS, "tau_m": [None, *COLUMNS["tau_m"][1:].tolist()]})
    twice = pandas.concat([pandas.DataFrame(COLUMNS), pandas.DataFrame({"tau_m": T})], axis=1)
    for frame, said in ((missing, "column tau_m, row 1: found no number"), (twice, "column tau_m appears 2 times")):
        with pytest.raises(UsageError, match=said):
            tsa_ctrl.predict(model, frame)


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
