"""Estimates from a shaken motor compared with the plant: delay, inertia, stiffness and curvature profile."""

from __future__ import annotations

import dataclasses
import math
import shutil
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from tests.tune.shaken import LAG, PERIOD, play, true_delay
from tests.virtual.rigs import Drawn, draw
from tsa_ctrl.config import load_configuration
from tsa_ctrl.control.law_design import gain_margin
from tsa_ctrl.demo.rig import NOMINAL
from tsa_ctrl.identify.calibrate.result import Calibration
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.plant.axis import CURVATURES
from tsa_ctrl.tune.delay import Delay, command_delay
from tsa_ctrl.tune.estimate import Estimate, Form, bends, course
from tsa_ctrl.tune.excitation import multi_sine
from tsa_ctrl.tune.mechanics import (
    LawTuning,
    Mechanics,
    bearable,
    law_tuning,
    measured,
    pulling,
    stiffened,
)
from tsa_ctrl.tune.procedure import shaken
from tsa_ctrl.tune.swing import Swing

SECONDS = 4.0
RIGS = [draw(1, number) for number in (1, 13, 16)]  # all centres of curvature, with delays of 1 and 3 periods
CENTRES = {"motor_end": 0.0, "uniform": 0.5, "s_bent": 0.5, "joint_end": 1.0}


def shake(folder: Path, drawn: Drawn, peak: float = 0.035) -> Dataset:
    slow = multi_sine((0.9,), 0.1, SECONDS)
    return play(folder, drawn, shaken(slow, peak, PERIOD).tau_j_des)


@pytest.mark.slow
@pytest.mark.parametrize("drawn", RIGS, ids=str)
def test_delay_inertia_and_stiffness_lie_in_their_intervals(tmp_path: Path, drawn: Drawn) -> None:
    found = measured([shake(tmp_path, drawn)], drawn.nominal)
    assert found.delay is not None
    assert found.swing is not None
    assert found.delay.delay.low <= true_delay(drawn) <= found.delay.delay.high
    assert found.swing.inertia.low <= drawn.inertia <= found.swing.inertia.high
    profile = [list(point) for point in CURVATURES[drawn.curvature]]
    bent = drawn.nominal.with_effects({"elongation_coupling": {"curvature_profile": profile}})
    if drawn.curvature == "motor_end":
        bent = drawn.nominal.with_effects({"elongation_coupling": {"curvature_profile": "motor_end"}})
    x = drawn.truth.friction_angle
    changed = stiffened(bent.recalibrated(x), found.swing)
    assert changed is not None
    model, stiffness = changed
    assert stiffness.low <= drawn.truth.axial_stiffness <= stiffness.high
    assert stiffness.low <= model.axial_stiffness <= stiffness.high
    assert stiffness.high - stiffness.low < 0.15 * stiffness.value


@pytest.mark.slow
def test_a_velocity_that_the_drive_filters_changes_nothing(tmp_path: Path) -> None:
    """The filter is a first-order low-pass at 100 Hz, the default of velocity_cutoff."""
    drawn = RIGS[0]
    log = shake(tmp_path, drawn)
    share = 1.0 - math.exp(-2.0 * math.pi * 100.0 * PERIOD)
    filtered = lfilter([share], [1.0, share - 1.0], log["omega_m"])
    found = measured([dataclasses.replace(log, columns={**log.columns, "omega_m": filtered})], drawn.nominal)
    assert found.swing is not None
    assert found.swing.inertia.low <= drawn.inertia <= found.swing.inertia.high


@pytest.mark.slow
@pytest.mark.parametrize("drawn", RIGS, ids=str)
def test_the_centre_of_the_bending_lies_in_its_interval(tmp_path: Path, drawn: Drawn) -> None:
    load = multi_sine((0.31, 0.53, 0.87), 0.5, 8.0)
    t = PERIOD * np.arange(round(load.seconds / PERIOD))
    log = play(tmp_path, drawn, np.interp(t, load.t, load.tau_j_des))
    found = bends([pulling(log, drawn.inertia)], drawn.nominal)
    assert found is not None
    assert found.centre.low <= CENTRES[drawn.curvature] <= found.centre.high
    assert found.profile == {"s_bent": "uniform"}.get(drawn.curvature, drawn.curvature)


@pytest.mark.slow
def test_an_arbitrary_course_gets_its_centre(tmp_path: Path) -> None:
    """The profile is straight for 30 % of the length and has half of the bending in the next tenth."""
    points = [[0.0, 0.0], [0.3, 0.0], [0.4, 0.5], [1.0, 1.0]]
    centre = 1.0 - float(np.trapezoid(*np.array(points).T[::-1]))
    drawn = draw(1, 2)
    load = multi_sine((0.31, 0.53, 0.87), 0.5, 8.0)
    t = PERIOD * np.arange(round(load.seconds / PERIOD))
    tendon = {"kind": "distributed", "curvature": points}
    log = play(tmp_path, drawn, np.interp(t, load.t, load.tau_j_des), tendon=tendon)
    found = bends([pulling(log, drawn.inertia)], drawn.nominal)
    assert found is not None
    assert found.centre.low <= centre <= found.centre.high
    assert found.profile == course(found.centre.value)


@pytest.mark.parametrize(("transport", "lag"), [(0.6, 1.2e-3), (1.0, 0.1e-3), (2.37, 0.1e-3), (6.0, 1.2e-3)])
def test_a_delay_of_any_size_is_found(transport: float, lag: float) -> None:
    """The reference is a torque loop in steps of a fiftieth of a period, without code of the package."""
    rng = np.random.default_rng(5)
    command = np.cumsum(rng.normal(0.0, 0.02, 3000))
    command -= np.linspace(command[0], command[-1], command.size)
    torque = stepped(command, transport, lag / PERIOD) + rng.normal(0.0, 2e-3, command.size)
    columns = {"t": PERIOD * np.arange(command.size), "tau_m_cmd": command, "tau_m": torque, "omega_j": command}
    found = command_delay([Dataset.from_arrays(columns, "drive")])
    assert found is not None
    true = (transport + 0.5) * PERIOD + lag
    assert found.delay.low <= true <= found.delay.high
    settled = lag < 0.2 * PERIOD  # the time of the measurement within the period is not visible
    assert found.delay.high - found.delay.low < (1.2 if settled else 0.25) * PERIOD


def stepped(command: NDArray[np.float64], transport: float, lag: float) -> NDArray[np.float64]:
    """Return the response of a lag to a held command that is `transport` periods late. Both are in periods."""
    fine = 50
    torque, found = 0.0, np.zeros(command.size)
    for k in range(command.size):
        found[k] = torque
        for i in range(fine):
            newest = int(np.floor(k + (i + 0.5) / fine - transport))
            torque += (1.0 - np.exp(-1.0 / (fine * lag))) * ((command[newest] if newest >= 0 else 0.0) - torque)
    return found


def test_a_drive_that_does_not_follow_has_no_delay() -> None:
    rng = np.random.default_rng(1)
    columns = {name: rng.normal(size=3000) for name in ("tau_m_cmd", "tau_m", "omega_j")}
    log = Dataset.from_arrays({"t": PERIOD * np.arange(3000), **columns}, "drive")
    assert command_delay([log]) is None


@pytest.mark.slow
def test_a_joint_that_hardly_moves_says_nothing_of_the_motor(tmp_path: Path) -> None:
    drawn = dataclasses.replace(RIGS[0], delay=2)
    slow = multi_sine((0.9,), 0.1, SECONDS)
    log = play(tmp_path, drawn, shaken(slow, 0.035, PERIOD).tau_j_des, amplitude=0.02)
    found = measured([log], drawn.nominal)
    assert found.swing is None
    assert found.delay is not None
    assert found.delay.lag == pytest.approx(LAG, abs=1e-4)
    assert "slides too little" in found.notes[0]


def around(value: float, unit: str) -> Quantity:
    return Quantity(value, 0.98 * value, 1.02 * value, unit)


def learned_of(model: TendonSheath) -> Estimate:
    """Return an estimate whose friction torque is known to 2 %."""
    loop = around(0.5, "N*m")
    calibration = Calibration(loop, loop, loop, loop, False, 1.0, 9.0, (), 0.1, 0.1, 0.1, 0.1, "", (), model)
    return Estimate(model, calibration, Form.GIVEN, (), ())


def tuned(tmp_path: Path, delay: float, ringing: float = 150.0) -> LawTuning:
    """Return the [axis.law] settings for a motor of 1e-4 kg*m^2 with this ringing (Hz) and delay (s)."""
    folder = Path(__file__).resolve().parents[2] / "config"
    for name in ("controller.toml", "actuator.toml"):
        shutil.copy(folder / name, tmp_path)
    configuration = load_configuration(tmp_path / "controller.toml")
    inertia, late = around(1e-4, "kg*m^2"), around(delay, "s")
    stiffness = around(1e-4 * (2.0 * math.pi * ringing) ** 2, "N*m/rad")
    found = Mechanics(Delay(delay / PERIOD - 1.0, LAG, late), Swing(inertia, stiffness, around(ringing, "Hz"), 0.0))
    learned = learned_of(configuration.models[0])
    made = law_tuning(configuration, configuration.file.axes[0], learned, found)
    assert made is not None
    return made


@pytest.mark.parametrize("delay", [2e-3, 4e-3, 6e-3])
def test_the_damping_keeps_its_margin_at_the_latest_delay(tmp_path: Path, delay: float) -> None:
    made = tuned(tmp_path, delay)
    stiffness = 1e-4 * (2.0 * math.pi * 150.0) ** 2
    assert made.values["compensation"] == pytest.approx(0.98)  # the share of the friction torque that is certain
    assert made.margin is not None
    assert made.margin >= 2.0
    assert gain_margin(made.values["damping"], 1e-4, stiffness, 1.02 * delay, PERIOD) >= 2.0
    assert f"gain margin {made.margin:.2g}" in made.keys["damping"].comment
    assert made.values["lead"] == pytest.approx(0.5 * made.values["turn"] + delay, abs=1e-4)


def test_a_delay_without_margin_gets_no_damping_and_that_is_said(tmp_path: Path) -> None:
    made = tuned(tmp_path, 12e-3)
    assert made.margin is None
    assert made.values["damping"] == 0.0
    assert any("leaves no gain margin of 2" in note and "is not damped" in note for note in made.notes)
    assert "no gain margin of 2" in made.keys["damping"].comment


@pytest.mark.parametrize(("share", "tried"), [(1.2, 0.95), (1.0, 0.95), (0.9, 0.88), (0.5, 0.49)])
def test_a_file_is_tried_with_no_more_friction_than_the_rig_surely_has(share: float, tried: float) -> None:
    """With even curvature the motor's friction torque is proportional to the pretension, whose lower end is 98 %."""
    given = NOMINAL.with_effects({"elongation_coupling": {"curvature_profile": "uniform"}})
    learned = learned_of(given.recalibrated(given.friction_angle, share * given.pretension))
    found, reason = bearable(0.95, given, learned)
    assert found == pytest.approx(tried, abs=3e-3)
    assert (reason is None) is (tried == 0.95)
    if reason is not None:
        assert f"with {100.0 * found:.3g} % of its friction term, not 95 %" in reason
    assert bearable(0.0, given, learned) == (0.0, None)


def test_a_sheath_that_bends_at_the_joint_bears_less_of_one_that_bends_evenly() -> None:
    """The friction torque is proportional to tanh x instead of x."""
    given, at_joint = (
        NOMINAL.with_effects({"elongation_coupling": {"curvature_profile": profile}})
        for profile in ("uniform", "joint_end")
    )
    x = NOMINAL.friction_angle
    assert bearable(1.0, given, learned_of(at_joint))[0] == pytest.approx(0.98 * math.tanh(x) / x, abs=2e-3)
