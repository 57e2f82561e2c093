"""The ratio of the radii from angles. Motion, elongation and encoders are synthesised without the model's code."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.model.actuator import ACTUATOR
from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.tune.procedure import radius_ratio, with_ratio

PERIOD, SECONDS = 2e-3, 20.0  # s
MOTOR_COUNTS = 65_536
STIFFNESS, WIND = 40.0, 0.012  # N*m/rad at the motor; rad of elongation by friction, in either direction
WAY = 0.02  # rad of the joint, travel of a reversal
LATE = 0.5e-3  # s, delay of the joint's encoder


def log(ratio: float, bits: int, load: str = "independent", travel: float = 0.5, seed: int = 1) -> Dataset:
    """Return 20 s of a joint moved by two sines, with an independent torque or the torque of a weight or a spring."""
    rng = np.random.default_rng(seed)
    t = PERIOD * np.arange(round(SECONDS / PERIOD))
    phase = rng.uniform(0.0, 2.0 * np.pi, 4)

    def angle(at: np.ndarray) -> np.ndarray:
        return travel * (np.sin(2.1 * at + phase[0]) + 0.4 * np.sin(5.3 * at + phase[1]))

    q = angle(t)
    speed = (angle(t + 1e-5) - angle(t - 1e-5)) / 2e-5
    wound = np.zeros(t.size)
    for n in range(1, t.size):  # Dahl's hysteresis
        step = q[n] - q[n - 1]
        wound[n] = wound[n - 1] + step / WAY * (1.0 - np.sign(step) * wound[n - 1])
    weight = {"independent": np.sin(3.3 * t + phase[2]), "weight": np.sin(q + 0.4), "spring": q / travel}[load]
    tau_m = 0.6 * weight + 0.4 * np.sign(speed)
    q_m = ratio * q + tau_m / STIFFNESS - WIND * wound + 0.3
    counts = 2.0 * np.pi / MOTOR_COUNTS, 2.0 * np.pi / 2**bits
    columns = {
        "t": t,
        "tau_m": tau_m + rng.normal(0.0, 2e-3, t.size),
        "tau_j": ratio * tau_m,
        "q_m": counts[0] * np.floor(q_m / counts[0]),
        "q_j": counts[1] * np.floor(angle(t - LATE) / counts[1]),
        "omega_j": speed,
    }
    return Dataset.from_arrays(columns, f"{load}-{bits}", recorded=True)


@pytest.mark.parametrize(
    ("load", "bits", "error"),
    [
        ("independent", 14, 0.99),
        ("independent", 20, 1.01),
        ("weight", 14, 1.01),
        ("weight", 16, 1.0),
        ("weight", 20, 0.99),
    ],
)
def test_the_ratio_is_found_to_two_thousandths(load: str, bits: int, error: float) -> None:
    """The file is exact or 1 % off. The torque is independent of the angle, or a weight causes it."""
    true = 1.25 * error
    found = radius_ratio([log(true, bits, load)], ACTUATOR)
    assert found is not None
    assert found.value == pytest.approx(true, rel=2e-3)
    assert found.share < 2e-3
    model, _ = with_ratio(ACTUATOR, found)
    assert model.joint_pulley_radius / model.motor_pulley_radius == pytest.approx(true, rel=2e-3)
    assert model.motor_pulley_radius == ACTUATOR.motor_pulley_radius


@pytest.mark.parametrize(("bits", "error"), [(14, 0.99), (20, 1.01)])
def test_a_torque_that_follows_the_angle_leaves_the_ratio_open_by_the_doubt_of_the_stiffness(
    bits: int, error: float
) -> None:
    true = 1.25 * error
    found = radius_ratio([log(true, bits, "spring")], ACTUATOR)
    assert found is not None
    assert found.low < true < found.high
    assert 2e-3 < found.share < 2e-2
    assert with_ratio(ACTUATOR, found)[0] == ACTUATOR


def test_the_interval_holds_the_truth() -> None:
    found = [radius_ratio([log(1.26, 14, "weight", seed=seed)], ACTUATOR) for seed in range(20)]
    held = [each.low - 5e-4 <= 1.26 <= each.high + 5e-4 for each in found if each is not None]
    assert sum(held) >= 17


def test_each_log_has_a_zero_of_its_own() -> None:
    first = log(1.26, 16)
    second = dataclasses.replace(first, columns={**first.columns, "q_m": first["q_m"] + 1.0})
    found = radius_ratio([first, second], ACTUATOR)
    assert found is not None
    assert found.value == pytest.approx(1.26, rel=2e-3)
    columns = {name: values for name, values in first.columns.items() if name != "q_j"}
    assert radius_ratio([Dataset.from_arrays(columns, "bare", recorded=True)], ACTUATOR) is None


@pytest.mark.parametrize("ratio", [0.8, 1.8])
def test_radii_that_the_angles_contradict_are_rejected(ratio: float) -> None:
    found = radius_ratio([log(ratio, 16)], ACTUATOR)
    words = "exchanged" if ratio == 0.8 else "gear_ratio and counts_per_revolution"
    with pytest.raises(UsageError, match=rf"is 1.25, but the angles of motor and joint give [\d.]+ .*{words}"):
        with_ratio(ACTUATOR, found)


def test_too_little_travel_leaves_the_file_as_it_is() -> None:
    loose = Quantity(1.26, 1.25, 1.27, "1")
    model, (note,) = with_ratio(ACTUATOR, loose)
    assert model == ACTUATOR
    assert "known only to 0.79 %" in note
    assert with_ratio(ACTUATOR, None) == (ACTUATOR, ())
