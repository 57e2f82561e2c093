"""Run the loop with a pair of load cells on two serial lines, which follows the tensioner by t1 and t3.

The plant's tendons are distributed and have lost a quarter of their pretension. The parser of the serial sensors reads
lines of text, 100 values per second. Only the terminal is not simulated.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tests.virtual.joints import GAIT, error, files, rms
from tsa_ctrl.config import load_configuration
from tsa_ctrl.control.estimator import EstimateState
from tsa_ctrl.demo.rig import NOMINAL
from tsa_ctrl.plant.process import check
from tsa_ctrl.sensors.process import LineState, Reading, SerialSensorSettings, Slots
from tsa_ctrl.sensors.reader import LineParser
from tsa_ctrl.virtual.result import Simulation
from tsa_ctrl.virtual.simulation import Run

SECONDS = 5.0
KILOGRAM_FORCE = 9.80665  # N
EACH = 0.01  # s between two lines of a cell
NOISE = 0.1  # N
LEFT = 0.75  # share of the pretension
WRONG_FROM = 2.0  # s of the run
TENSION = NOMINAL.pretension

Cell = Callable[[float, float], str]  # s since the first line and N, to the line that is sent


def said(tension: float) -> str:
    return f"{tension / KILOGRAM_FORCE:.3f} kgf\n"


def good(t: float, tension: float) -> str:
    return said(tension)


def silent(t: float, tension: float) -> str:
    return said(tension) if t < WRONG_FROM else ""


def drifting(t: float, tension: float) -> str:
    return said(tension + 3.0 * max(0.0, t - WRONG_FROM))


class Cells:
    """Simulate both serial lines of a run, from the plant's tensions to the values that the loop reads."""

    def __init__(self, run: Run, settings: tuple[SerialSensorSettings, ...], t3: Cell) -> None:
        self._truth = run.machine.axes[0].axis.values
        self._settings = settings
        self._parsers = [LineParser(each) for each in settings]
        self._slots = Slots(len(settings))
        self._cells = {"t1": good, "t3": t3}
        self._random = np.random.default_rng(5)
        self._first = self._next = math.nan

    def source(self, index: int) -> Callable[[float], float]:
        def read(now: float) -> float:
            if not now < self._next:
                self._send(now)
            return self._slots.fresh(index, now, self._settings[index].timeout)

        return read

    def _send(self, now: float) -> None:
        self._first = now if math.isnan(self._first) else self._first
        self._next = now + EACH
        truth = self._truth()
        for index, (settings, parser) in enumerate(zip(self._settings, self._parsers, strict=True)):
            tension = truth[settings.quantity] + self._random.normal(0.0, NOISE)
            line = self._cells[settings.quantity](now - self._first, tension)
            for value in parser.feed(line.encode()):
                self._slots.write(index, Reading(value, now, 1, 0, LineState.READING))

    def close(self) -> None:
        self._slots.close()


@dataclass(frozen=True)
class Told:
    """The result of a run, and the events about the estimate."""

    result: Simulation
    lines: list[str]


def play(folder: Path, kind: str, t3: Cell = good) -> Told:
    """Run the gait with the reduced pretension."""
    line = {"pattern": r"^(?P<value>\S+) (?P<unit>\w+)$", "unit": "kgf", "scale": KILOGRAM_FORCE, "timeout": 0.1}
    axis = {
        "estimator": {"kind": kind, **({} if kind == "fixed" else {"use": True, "attribute": "pretension"})},
        "serial": [{"quantity": name, "port": f"/dev/none-{name}", **line} for name in ("t1", "t3")],
    }
    plant = {"perturbation": {"pretension": LEFT}}
    controller, rig = files(folder, "imposed", GAIT, compensation=0.9, axis=axis, plant=plant)
    configuration = load_configuration(controller)
    run = Run(configuration, check(rig), SECONDS)
    cells = Cells(run, configuration.file.axes[0].serial, t3)
    try:
        run.axes[0].instruments.connect({"t1": cells.source(0), "t3": cells.source(1)})
        result = run.play([], [], lambda share: None)
        texts = [str(event.text) for event in run.loop.events.all]
        return Told(result, [text for text in texts if "friction and pretension are" in text])
    finally:
        cells.close()
        run.close()


@pytest.fixture(scope="module")
def without(tmp_path_factory: pytest.TempPathFactory) -> float:
    """Return the RMS error with the model file's pretension, mN*m."""
    return rms(error(play(tmp_path_factory.mktemp("fixed"), "fixed").result, 3.0))


@pytest.mark.slow
def test_the_loop_follows_the_tensioner(tmp_path: Path, without: float) -> None:
    told = play(tmp_path, "tension")
    log = told.result.axes[0].log
    last = int(np.flatnonzero(told.result.axes[0].counted)[-1])
    assert log["pretension"][last] == pytest.approx(LEFT * TENSION, rel=0.03)
    assert log["estimate_state"][last] == EstimateState.ESTIMATED.value
    assert log["friction_angle"][last] == NOMINAL.friction_angle
    assert told.result.axes[0].faults == ()
    assert told.lines == []
    assert rms(error(told.result, 3.0)) < 1.1 * without  # the torque sensor also measures the friction without cells


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cell", "words"),
    [
        (silent, "no value of t3; check the load cell's serial connection"),
        (drifting, "check zero and gain of both load cells"),
    ],
)
def test_a_cell_that_is_wrong_is_told_in_one_line_and_gives_the_joint_no_more(
    tmp_path: Path, cell: Cell, words: str, without: float
) -> None:
    told = play(tmp_path, "tension", cell)
    axis = told.result.axes[0]
    log = axis.log
    assert len(told.lines) == 1
    assert words in told.lines[0]
    assert "\n" not in told.lines[0]
    assert np.all(log["pretension"] <= TENSION)
    last = int(np.flatnonzero(axis.counted)[-1])
    assert log["estimate_state"][last] == EstimateState.INVALID.value
    assert rms(error(told.result, 3.0)) < 1.05 * without
    assert axis.faults == ()
