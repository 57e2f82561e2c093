"""Absurd logs through the command: one line with the suspected error, or `insufficient` with an explanation."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.blind.soft_tendons import record
from tests.identify.diagnosis.nominal import MODEL
from tsa_ctrl.cli import main

Columns = dict[str, np.ndarray]
GOOD = record(3, compensated=False)


def swapped(one: str, other: str) -> Callable[[Columns], Columns]:
    return lambda columns: {**columns, one: columns[other], other: columns[one]}


def times(**factors: float) -> Callable[[Columns], Columns]:
    return lambda columns: {**columns, **{name: factor * columns[name] for name, factor in factors.items()}}


def without(*names: str) -> Callable[[Columns], Columns]:
    return lambda columns: {name: values for name, values in columns.items() if name not in names}


def constant(*names: str) -> Callable[[Columns], Columns]:
    return lambda columns: {**columns, **{name: np.full_like(columns[name], columns[name].mean()) for name in names}}


def first(rows: int) -> Callable[[Columns], Columns]:
    return lambda columns: {name: values[:rows] for name, values in columns.items()}


def shifted(columns: Columns) -> Columns:
    """Shift the joint torque by a third of the log, so that it is unrelated to the motor torque."""
    return {**columns, "tau_j": np.roll(columns["tau_j"], len(columns["tau_j"]) // 3)}


def diagnosed(columns: Columns, folder: Path) -> int:
    table = np.column_stack(list(columns.values()))
    np.savetxt(folder / "x.csv", table, "%.10g", ",", header=",".join(columns), comments="")
    (folder / "model.toml").write_text(MODEL)
    command = ["diagnose", str(folder / "x.csv"), "--model", str(folder / "model.toml"), "--out", str(folder / "out")]
    with pytest.raises(SystemExit) as end:
        main([*command, "--json"])
    return int(end.value.code or 0)


ENERGY = ("q_j", "omega_m", "q_m")  # columns that a log of torques and one velocity does not have


@pytest.mark.parametrize(
    ("absurd", "suspected"),
    [
        (swapped("tau_m", "tau_j"), "columns tau_m and tau_j are swapped"),
        (lambda c: without(*ENERGY)(swapped("tau_m", "tau_j")(c)), "columns tau_m and tau_j are swapped"),
        (lambda c: without(*ENERGY)(times(omega_j=-1.0)(c)), "column omega_j is reversed, or columns tau_m and tau_j"),
        (lambda c: without(*ENERGY)(swapped("tau_m", "omega_j")(c)), "swapped"),
        (swapped("omega_j", "tau_j"), "omega_j is not the velocity of q_j .*swapped"),
        (swapped("q_j", "omega_j"), "omega_j .*q_j.*(swapped|reversed)"),
        (swapped("q_j", "tau_m"), "omega_j is not the velocity of q_j .*swapped"),
        (swapped("q_j", "q_m"), "q_m and q_j seem to be swapped"),
        (swapped("omega_j", "omega_m"), "omega_m and omega_j seem to be swapped"),
        (swapped("t", "tau_m"), "column t"),
        (times(tau_m=-1.0), "column tau_m is reversed"),
        (times(omega_j=-1.0), "omega_j runs against dq_j/dt"),
        (times(q_m=-1.0, omega_m=-1.0), "q_m|omega_m"),
        (times(tau_j=1e3), "tau_j.*mm"),
        (times(tau_m=1e3, tau_j=1e3), "tau_[mj].*mm"),
        (times(q_j=180.0 / np.pi), "q_j.*degrees"),
        (without("tau_j"), 'tau_j is missing.*kind = "rigid_drive"'),
        (without("tau_m", "tau_j"), "tau_m is missing"),
    ],
)
def test_a_log_that_cannot_be_right_is_refused_in_one_line_that_names_the_suspicion(
    absurd: Callable[[Columns], Columns], suspected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert diagnosed(absurd(GOOD), tmp_path) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert len(said.err.splitlines()) == 1
    assert "x.csv" in said.err
    assert re.search(suspected, said.err), said.err


@pytest.mark.parametrize(
    ("absurd", "suspected"),
    [
        (constant("tau_m", "tau_j", "omega_j", "q_j", "q_m", "omega_m"), "the measured torque does not change"),
        (constant("tau_j"), "is the sensor connected"),
        (constant("tau_m"), "is the drive's torque recorded"),
        (lambda c: without(*ENERGY)(constant("omega_j")(c)), "the velocity does not change at all: is it recorded"),
        (first(10), "the logs hold .* s; at least 3 s"),
        (lambda c: without(*ENERGY)(swapped("tau_j", "omega_j")(c)), "swapped"),
        (lambda c: shifted(first(len(c["t"]) // 2)(c)), "swapped|another drive"),
    ],
)
def test_a_log_that_says_nothing_is_insufficient_with_the_suspicion_and_a_motion_to_record(
    absurd: Callable[[Columns], Columns], suspected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert diagnosed(absurd(GOOD), tmp_path) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["verdict"] == "insufficient"
    assert re.search(suspected, data["summary"]), data["summary"]
    assert data["summary"] in html.unescape((tmp_path / "out" / "report.html").read_text())
    assert (tmp_path / "out" / "experiment.csv").read_text().startswith("t,tau_j_des\n0.0000,0\n")
