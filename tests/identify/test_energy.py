"""Reversed channels are rejected with their names. Unusual logs are accepted.

The logs come from the equilibrium of two tendons.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from tests.blind import geared, tendon_logs
from tests.blind.cases import Case
from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify import energy
from tsa_ctrl.identify.admit import admit
from tsa_ctrl.identify.dataset import Dataset, load_log
from tsa_ctrl.identify.energy import check_energy
from tsa_ctrl.model.parameters import GearedDrive, Model, RigidDrive, load_model, model_from

VELOCITIES = ("omega_j", "q_j")

Columns = dict[str, np.ndarray]


def rig_log(seed: int, **options: float) -> tuple[Columns, Model]:
    rng = np.random.default_rng(seed)
    rig = tendon_logs.draw_rig(rng, tendon_logs.PROFILES[seed % 3])
    model = model_from(tomllib.loads(tendon_logs.model_text(rig, rng)), "nominal")
    return tendon_logs.record(rig, rng, seconds=20.0, **options), model


def turned(table: Columns, *names: str) -> Dataset:
    return Dataset.from_arrays({name: -values if name in names else values for name, values in table.items()}, "log")


@pytest.mark.parametrize("seed", range(6))
def test_a_right_log_is_accepted(seed: int) -> None:
    table, model = rig_log(seed)
    check_energy(turned(table), model)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("names", "said"),
    [(("tau_j",), "column tau_j is"), (("tau_m",), "column tau_m is"), (VELOCITIES, "column omega_j is")],
)
def test_a_reversed_channel_is_named(seed: int, names: tuple[str, ...], said: str) -> None:
    table, model = rig_log(seed)
    with pytest.raises(UsageError, match=f"{said} reversed"):
        check_energy(turned(table, *names), model)


@pytest.mark.parametrize("names", [("tau_j",), ("tau_m",), VELOCITIES])
def test_of_a_long_log_some_samples_are_enough(names: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    table, model = rig_log(0)
    monkeypatch.setattr(energy, "MOST", len(table["t"]) // 6)
    check_energy(turned(table), model)
    with pytest.raises(UsageError, match=f"column {names[0]} is reversed"):
        check_energy(turned(table, *names), model)


@pytest.mark.parametrize(
    ("name", "factor", "said"),
    [("q_j", 1.0, "column omega_j runs against dq_j/dt"), ("q_m", 1.2, "column q_m is reversed")],
)
def test_an_angle_against_the_velocity_of_the_joint_is_named(name: str, factor: float, said: str) -> None:
    table, model = rig_log(1)
    q = np.cumsum(table["omega_j"]) * float(table["t"][1] - table["t"][0])
    with pytest.raises(UsageError, match=said):
        check_energy(turned({**table, name: factor * q}, name), model)


def test_an_unloaded_joint_still_tells_the_motors_sign() -> None:
    table, model = rig_log(3)
    rng = np.random.default_rng(0)
    sigma = np.sign(table["omega_j"])
    unloaded = {
        **table,
        "tau_m": 0.3 * sigma + 0.01 * rng.normal(size=len(sigma)),
        "tau_j": 1e-3 * rng.normal(size=len(sigma)),
    }
    check_energy(turned(unloaded), model)
    with pytest.raises(UsageError, match="column tau_m or omega_j is reversed"):
        check_energy(turned(unloaded, "tau_m"), model)


@pytest.mark.parametrize(("stiffness", "weight", "inertia"), [(5.0, 0.0, 0.0), (0.0, 3.0, 0.0), (0.0, 0.0, 0.05)])
def test_energy_stored_and_given_back_is_no_reversed_channel(stiffness: float, weight: float, inertia: float) -> None:
    table, model = rig_log(4)
    period = float(table["t"][1] - table["t"][0])
    q = np.cumsum(table["omega_j"]) * period
    held = stiffness * q + weight * np.sin(q + 0.4) + inertia * np.gradient(table["omega_j"], period)
    check_energy(turned({**table, "q_j": q, "tau_j": table["tau_j"] - held}), model)


@pytest.mark.parametrize(
    "table",
    [
        {"omega_j": np.zeros(2000)},
        {"omega_j": np.ones(2000)},
        {"tau_m": np.ones(2000), "tau_j": np.ones(2000)},
        {"tau_j": np.zeros(2000)},
        {"omega_j": np.random.default_rng(1).normal(size=2000)},
    ],
    ids=["still", "one way", "constant torques", "no load", "noise"],
)
def test_a_log_that_cannot_tell_is_accepted(table: Columns) -> None:
    _, model = rig_log(5)
    t = np.arange(2000) * 1e-3
    rng = np.random.default_rng(2)
    noise = {"t": t, "tau_m": rng.normal(size=2000), "tau_j": rng.normal(size=2000), "omega_j": np.sin(9.0 * t)}
    check_energy(Dataset.from_arrays({**noise, **table}), model)


def test_a_short_log_is_accepted() -> None:
    table, model = rig_log(6)
    check_energy(turned({name: values[:60] for name, values in table.items()}, "tau_j"), model)


def test_a_plain_drive_whose_friction_drives_is_refused() -> None:
    rng = np.random.default_rng(7)
    t = np.arange(8000) * 1e-3
    omega = 20.0 * np.sin(3.0 * t) + 8.0 * np.sin(7.7 * t)
    tau = 0.05 * np.sign(omega) + 1e-3 * omega + 1e-4 * np.gradient(omega, 1e-3) + 0.002 * rng.normal(size=len(t))
    table = {"t": t, "tau_m": tau, "omega_m": omega}
    check_energy(turned(table), RigidDrive(coulomb_friction=0.04))
    with pytest.raises(UsageError, match="column tau_m or omega_m is reversed"):
        check_energy(turned(table, "tau_m"), RigidDrive(coulomb_friction=0.04))


def braking() -> Columns:
    """Return the log of a gear that is moved from outside, while the motor brakes with a viscous torque."""
    rng = np.random.default_rng(3)
    t = np.arange(8000) * 1e-3
    omega = 20.0 * np.sin(3.0 * t) + 8.0 * np.sin(7.7 * t)
    tau_m = -0.02 * omega
    tau_j = 9.0 / 0.8 * tau_m - 0.6 * np.sign(omega) - 0.02 * omega / 9.0
    noise = rng.normal(size=(2, len(t)))
    return {"t": t, "tau_m": tau_m + 0.002 * noise[0], "omega_m": omega, "tau_j": tau_j + 0.02 * noise[1]}


def test_a_motor_that_brakes_a_gear_is_accepted() -> None:
    model = GearedDrive(9.0, 0.8, 0.6)
    check_energy(turned(braking()), model)
    check_energy(turned({name: values for name, values in braking().items() if name != "tau_j"}), model)
    for name in ("tau_m", "omega_m"):
        with pytest.raises(UsageError, match="column tau_m or omega_m is reversed"):
            check_energy(turned(braking(), name), model)


class TestRatios:
    @pytest.mark.parametrize("name", ["tau_m", "tau_j"])
    def test_one_torque_in_newton_millimetres_is_named(self, name: str) -> None:
        table, model = rig_log(8)
        small = {"tau_m": 0.01 * table["tau_m"], "tau_j": 0.01 * table["tau_j"]}
        small[name] = small[name] * 1e3
        with pytest.raises(UsageError, match=rf"{name} seems to be in N\*mm"):
            admit(Dataset.from_arrays({**table, **small}), model)

    @pytest.mark.parametrize("name", ["q_j", "q_m"])
    def test_one_angle_in_degrees_is_named(self, name: str) -> None:
        table, model = rig_log(9)
        t = table["t"]
        assert hasattr(model, "motor_pulley_radius")
        ratio = model.joint_pulley_radius / model.motor_pulley_radius
        angles = {"q_j": 0.1 * np.sin(3.0 * t), "q_m": 0.1 * ratio * np.sin(3.0 * t)}
        angles[name] = np.degrees(angles[name])
        without = {key: values for key, values in table.items() if key != "omega_j"}
        with pytest.raises(UsageError, match=f"{name} seems to be in degrees"):
            admit(Dataset.from_arrays({**without, **angles}), model)


@pytest.mark.parametrize("name", ["tau_m", "q_j", "q_m"])
def test_a_reversed_channel_of_the_measured_cable_drive_is_refused(data_dir: Path, name: str) -> None:
    folder = data_dir / "davinci"
    log = load_log(folder / "load050_0.3Hz.csv.gz")
    measured = {key: values for key, values in log.columns.items() if key not in log.derived}
    with pytest.raises(UsageError, match=f"{name}.* is reversed"):
        check_energy(turned(measured, name), load_model(folder / "actuator.toml"))


@pytest.mark.parametrize("column", ["tau_m", "tau_j"])
@pytest.mark.parametrize(
    "case", [geared.geared_case("gravity_load", 0, short=True), geared.held_case("torque_offset", 0)]
)
def test_a_gear_does_not_reverse_the_torque(case: Case, column: str) -> None:
    """The joint moves against a weight, or is locked."""
    model, table = model_from(tomllib.loads(case.model), "nominal"), case.logs[0].columns
    check_energy(turned(table), model)
    with pytest.raises(UsageError, match="column tau_m or tau_j is reversed"):
        check_energy(turned(table, column), model)
