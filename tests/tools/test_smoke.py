"""Each command of tools/run runs on a very small case and prints a table, a line or JSON objects.

The parts of campaign/fuzz are tested in tests/fuzz.
"""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from tests.conftest import ROOT

WEIGHT = "--sensors encoder --loads weight"
SOAK = pytest.mark.soak  # more than ten seconds of processor time
LINES = {
    "bench/checks --loads held --faults nothing --sensors encoder --set-points sine": "told / off (s)",
    "bench/control --joints held --shapes motor_end --angles 1.2 --laws none true --cycles 1 --json": '"rms"',
    "figures/models --seconds 0.5 --out {out}": "simplified (3.55)",
    f"campaign/runaway changes {WEIGHT} --set-points sine --changes friction=0.5 --delays 1": "1 runs",
    f"campaign/runaway healthy --seconds 1 {WEIGHT} --json": '"said": []',
    f"campaign/runaway loss {WEIGHT} --set-points constant --changes friction=0.1 --at 1": "1 runs",
    f"campaign/runaway scan {WEIGHT} --shares 1.0 --set-points zero --seed 1": "1 cells, 0 missed",
    "campaign/runaway tracking --sensors encoder --loads held --set-points constant": "loss (%)",
    "campaign/virtual --sample 1 --only running --rows {out}/rows.jsonl": "1 trials, 1 safe",
    "manual/measure --list": "virtual-speed",
    "manual/write --check": "",
}
LONG = {
    "bench/axes --virtual --seconds 1": "2 axes, lean, encoders and torque sensors",
    "bench/calibrate --logs 9 --processes 1": "share of 95 % intervals",
    "bench/diagnose --short --families none:1 --processes 1 --out {out}/rows.jsonl": "none",
    "bench/hour --seconds 60 --kinds csv": "MB",
    "bench/measured --list": "above its limit",
    "bench/leg --only runaway": "free, encoder",
    "bench/rigs --rigs 1 --seed 1": "0 of 1 tunings failed",
    "bench/stretch --rigs 1": "intervals hold the truth",
    "bench/two_encoders --draws 1 --names nothing:joint": "groups became single names",
    "campaign/mutate limiter --sample 2": "limiter.py",
    "measured/stretch": "",
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "printed"), [*LINES.items(), *(pytest.param(*each, marks=SOAK, id=each[0]) for each in LONG.items())]
)
def test_it_runs(line: str, printed: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    words = line.format(out=tmp_path_factory.mktemp("out")).split()
    environment = {**os.environ, "COLUMNS": "250"}
    call = [sys.executable, str(ROOT / "tools"), *words]
    done = subprocess.run(call, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    assert printed in done.stdout
