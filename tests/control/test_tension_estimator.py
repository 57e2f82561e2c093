"""Test the estimator kind "tension" with load cells at the motor that are correct, absent, stuck or drifting."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.daemon.machine import CELLS, HERE, WITH_CELLS, Machine
from tests.virtual.joints import GAIT, PERIOD, play
from tsa_ctrl.config import load_configuration
from tsa_ctrl.control.estimator import EstimateState, Sample
from tsa_ctrl.control.settings import Attribution, EstimatorSettings
from tsa_ctrl.control.tension_estimator import TensionEstimator
from tsa_ctrl.demo.rig import NOMINAL
from tsa_ctrl.errors import UsageError

X, TENSION = NOMINAL.friction_angle, NOMINAL.pretension
EACH = 10  # cycles between two values of a cell: 100 Hz
NOISE, COUNT = 0.1, 0.05  # N

Cells = Callable[[float, float, float], tuple[float, float]]  # (t, true t1, true t3) -> readings of t1 and t3


@dataclass(frozen=True)
class Run:
    """The log of a gait on distributed tendons and the tensions of the plant (N), (n,) each."""

    log: dict[str, NDArray[np.float64]]
    t1: NDArray[np.float64]
    t3: NDArray[np.float64]


def recorded(folder: Path, **perturbation: float) -> Run:
    result = play(folder, "imposed", GAIT, 6.0, compensation=0.7, plant={"perturbation": perturbation}).axes[0]
    clock = result.start + result.log["t"] + result.log["lateness"]
    rows = np.minimum(np.searchsorted(result.truth["clock"], clock), result.truth["clock"].size - 1)
    return Run(result.log, result.truth["t1"][rows], result.truth["t3"][rows])


@pytest.fixture(scope="module")
def slack(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Return a run whose tensioner has lost a quarter of the pretension."""
    return recorded(tmp_path_factory.mktemp("slack"), pretension=0.75)


def follow(run: Run, read: Cells = lambda t, t1, t3: (t1, t3), **settings: object) -> TensionEstimator:
    """Return an estimator that processed the run.

    The load cells have noise and a resolution and deliver 100 values per second. Each value is held until the next.
    """
    chosen = TensionEstimator(NOMINAL, EstimatorSettings(kind="tension", use=True, **settings), PERIOD)  # type: ignore[arg-type]
    log, random = run.log, np.random.default_rng(3)
    t1 = t3 = math.nan
    for row in range(log["t"].size):
        if row % EACH == 0:
            noise = random.normal(0.0, NOISE, 2)
            values = read(float(log["t"][row]), float(run.t1[row] + noise[0]), float(run.t3[row] + noise[1]))
            t1, t3 = (COUNT * round(value / COUNT) if math.isfinite(value) else value for value in values)
        sigma, omega, tau_m = (float(log[name][row]) for name in ("sigma", "omega_j", "tau_m"))
        chosen.update(Sample(sigma, omega, math.nan, tau_m, math.nan, True, t1=t1, t3=t3))
    return chosen


@pytest.mark.slow
def test_a_tensioner_that_gave_way_is_found_within_2_percent(slack: Run) -> None:
    chosen = follow(slack, attribute=Attribution.PRETENSION)
    assert chosen.state is EstimateState.ESTIMATED
    assert chosen.pretension == pytest.approx(0.75 * TENSION, rel=0.02)
    assert chosen.friction_angle == X
    assert chosen.half_loop_ratio == pytest.approx(0.75, rel=0.02)


@pytest.mark.slow
def test_a_sheath_that_is_straighter_has_less_of_both(slack: Run) -> None:
    """A loss of 11.25 N pretension, attributed to the wrap angle, also reduces the friction angle.

    By (3.56) the wrap angle of 2.6 rad falls by 11.25/35 rad.
    """
    chosen = follow(slack, attribute=Attribution.BENDING)
    straighter = 1.0 - 0.25 * TENSION / NOMINAL.pretension_slope / NOMINAL.bending_angle
    assert chosen.pretension == pytest.approx(0.75 * TENSION, rel=0.02)
    assert chosen.friction_angle == pytest.approx(straighter * X, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("read", "words"),
    [
        (lambda t, t1, t3: (math.nan, t3), "no value of t1; check the load cell's serial connection"),
        (lambda t, t1, t3: (t1, math.nan if t > 3.0 else t3), "no value of t3"),
        (lambda t, t1, t3: (0.75 * TENSION if t > 2.0 else t1, t3), "T3 - T1 differs from the motor's torque"),
        (lambda t, t1, t3: (t1 + 2.0 * max(0.0, t - 1.0), t3), "T3 - T1 differs from the motor's torque"),
        (lambda t, t1, t3: (1.5 * t1, 1.5 * t3), "check zero and gain of both load cells"),
        (lambda t, t1, t3: (t1 - 20.0, t3 - 20.0), "N of pretension, .* times the pretension as the model file has"),
    ],
    ids=["absent", "lost", "stuck", "drifting", "gain", "both"],
)
def test_a_cell_that_is_wrong_is_said_in_one_line_and_raises_nothing(slack: Run, read: Cells, words: str) -> None:
    chosen = follow(slack, read, attribute=Attribution.PRETENSION)
    assert chosen.state is EstimateState.INVALID
    assert re.search(words, chosen.reason)
    assert "\n" not in chosen.reason
    assert chosen.pretension <= TENSION
    assert math.isnan(chosen.half_loop_ratio)


def test_nothing_is_known_of_a_joint_that_rests_and_a_disable_forgets() -> None:
    chosen = TensionEstimator(NOMINAL, EstimatorSettings(kind="tension"), PERIOD)
    for _ in range(3000):
        chosen.update(Sample(1.0, 0.0, math.nan, 0.0, math.nan, True, t1=30.0, t3=30.0))
    assert chosen.state is EstimateState.UNESTIMATED
    assert (chosen.friction_angle, chosen.pretension) == (X, TENSION)
    for _ in range(3000):
        chosen.update(Sample(1.0, 0.0, math.nan, 0.0, math.nan, True))
    assert chosen.state is EstimateState.INVALID
    chosen.reset()
    assert (chosen.state, chosen.reason) == (EstimateState.UNESTIMATED, "")


KIND = ('# kind = "sensor"  ', 'kind = "tension"  ')
USED = ("# use = true  ", "use = true  ")


def test_in_the_loop_it_is_told_once_when_a_cell_stops(tmp_path: Path) -> None:
    machine = Machine(tmp_path, KIND, USED, WITH_CELLS)
    try:
        says, image = [TENSION], machine.axis.image

        def half() -> float:
            return 0.5 * image.tau_m / NOMINAL.motor_pulley_radius

        machine.axis.instruments.connect({"t1": lambda now: says[0] - half(), "t3": lambda now: TENSION + half()})
        machine.drive.at_sync[500] = lambda: says.__setitem__(0, math.nan)
        machine.run(seconds=2.5)
        told = [event.text for event in machine.events.all if "are not estimated" in event.text]
        assert len(told) == 1
        assert "no value of t1" in told[0]
    finally:
        machine.close()


@pytest.mark.parametrize(
    ("serial", "attribute", "words"),
    [
        ("", "bending", "without a serial sensor of t1 and t3; it takes both"),
        (CELLS.split("\n\n")[0] + "\n\n", "bending", "without a serial sensor of t3"),
        (CELLS, "friction", 'attribute "friction", which tensions do not show; give "pretension" or "bending"'),
    ],
)
def test_what_it_cannot_do_is_refused(tmp_path: Path, serial: str, attribute: str, words: str) -> None:
    config = Path(__file__).resolve().parents[2] / "config"
    (tmp_path / "actuator.toml").write_text((config / "actuator.toml").read_text())
    text = (config / "controller.toml").read_text().replace(*KIND, 1).replace(HERE, serial + HERE, 1)
    text = text.replace('# attribute = "bending"', f'attribute = "{attribute}"', 1)
    (tmp_path / "controller.toml").write_text(text)
    with pytest.raises(UsageError, match=words) as caught:
        load_configuration(tmp_path / "controller.toml")
    assert "\n" not in str(caught.value)
