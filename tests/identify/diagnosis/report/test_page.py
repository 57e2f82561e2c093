"""Files of a report, in particular those of an earlier report in the same folder."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from tests.identify.diagnosis.nominal import MODEL, model
from tsa_ctrl.identify import Diagnosis
from tsa_ctrl.identify.diagnosis.parameters.formula import Formula
from tsa_ctrl.identify.diagnosis.report.page import write
from tsa_ctrl.identify.diagnosis.report.result import Experiment, Rms, Verdict


def drawn(result: Diagnosis, folder: Path) -> dict[str, Path]:
    """Return one picture for a result with a formula, otherwise none."""
    picture = folder / "load.png"
    if result.formula is None:
        return {}
    picture.write_bytes(b"a picture")
    return {"a caption": picture}


def test_no_file_of_an_earlier_diagnosis_keeps_its_name(tmp_path: Path) -> None:
    custom = model(f"{MODEL}[effects.custom]\nexpression = '0.01*tau'\nstage = 'joint'\n")
    formula = Formula("0.01*tau", {}, custom, 0.96, (0.05, 0.01), 1, 1, 1)
    experiment = Experiment("move", (0.0, 1.0), (0.0, 0.1))
    first = Diagnosis(Verdict.INSUFFICIENT, "?", (), {}, "?", {}, {}, experiment, Rms(), 0.0, model(), formula=formula)
    write(first, tmp_path, plot=drawn)
    before = {name: (tmp_path / name).read_bytes() for name in ("formula.toml", "experiment.csv")}
    assert (tmp_path / "load.png").is_file()
    second = dataclasses.replace(first, formula=None, experiment=Experiment("rest"))
    write(second, tmp_path, plot=drawn)
    names = {path.name for path in tmp_path.iterdir()}
    backups = {f"{name}.~1~" for name in ("diagnosis.json", "extended.toml", "formula.toml", "experiment.csv")}
    assert names == {"diagnosis.json", "extended.toml", "report.html", *backups}
    assert {name: (tmp_path / f"{name}.~1~").read_bytes() for name in before} == before
