"""Test the example of `tsa diagnose`: a log with a hidden effect that the model file does not contain."""

from __future__ import annotations

from pathlib import Path

import pytest

from tsa_ctrl.cli import main
from tsa_ctrl.demo import example
from tsa_ctrl.demo.example import EFFECTS, draw
from tsa_ctrl.identify.dataset import load_log
from tsa_ctrl.model.parameters import load_model


@pytest.mark.slow
def test_the_log_is_read_and_the_model_does_not_know_what_is_hidden(tmp_path: Path) -> None:
    made = example.make(tmp_path, 1)
    log = load_log(made.log)
    assert log.seconds > 19.0
    assert {"tau_m", "tau_j", "omega_j", "q_j", "q_m"} <= set(log.columns)
    assert load_model(made.model).effects == {}
    assert all(name in made.told() for name in made.hidden.effects)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (["x.csv", "--example"], "omit LOG and --model"),
        (["x.csv"], "Missing --model; or try --example"),
        ([], "Missing LOG; or try --example"),
    ],
)
def test_what_does_not_go_together_is_one_line(line: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["diagnose", *line])
    err = capsys.readouterr().err
    assert (ended.value.code, err.count("\n")) == (2, 1)
    assert said in err


@pytest.mark.parametrize("name", EFFECTS)
def test_what_was_hidden_is_told_whatever_it_was(name: str) -> None:
    """The example prints the name and the size of each hidden effect. A size is a number or a word."""
    assert example.Example(Path("a"), Path("b"), draw(0, [name])).told().startswith(f"{name} with ")
