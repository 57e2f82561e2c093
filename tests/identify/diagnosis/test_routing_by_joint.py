"""A joint whose gain of the wrap angle differs from the file's is identified; the interval contains its gain."""

from __future__ import annotations

import dataclasses
import tomllib
from pathlib import Path

import numpy as np
import pytest

from tests.blind.routed import routed_case
from tests.identify.diagnosis.nominal import diagnosed, model
from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.calibrate import calibrate
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.diagnosis import diagnose
from tsa_ctrl.identify.diagnosis.report.page import write
from tsa_ctrl.identify.diagnosis.report.result import Verdict
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.identify.simulate import simulate
from tsa_ctrl.model.catalogue import CATALOGUE, check_effects
from tsa_ctrl.model.effects.search import Scales
from tsa_ctrl.model.parameters import TendonSheath, load_tendon_sheath, model_from
from tsa_ctrl.model.routing import Routing

NAME = "routing_by_joint"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["absent", "wrong", "two"])
def test_the_missing_gain_of_each_joint_is_found(name: str, tmp_path: Path) -> None:
    """The [routing] of the extended file contains the sums of the file's gains and the missing gains.

    At small torques, a joint that changes the pretension instead looks the same.
    """
    case, gains = routed_case(name, 0, short=True)
    result = diagnosed(case)
    (cause,) = result.causes
    assert cause.effect == NAME
    assert set(cause.alternatives) <= {"pretension_per_joint_angle"}
    for joint, missing in gains.missing.items():
        found = cause.parameters[joint]
        assert isinstance(found, Quantity)
        assert found.value == pytest.approx(missing, rel=0.05)
    write(result, tmp_path, plot=lambda *_: {})
    written = load_tendon_sheath(tmp_path / "extended.toml")
    assert not written.effects
    assert written.routing is not None
    for joint, true in gains.true.items():
        assert written.routing.a.gains[joint] == pytest.approx(true, rel=0.05)


@pytest.mark.slow
def test_nothing_is_found_where_the_file_states_the_routing() -> None:
    assert diagnosed(routed_case("right", 0, short=True)[0]).causes == ()


T = np.arange(0.0, 40.0, 0.002)


def leg_log(share: float, seed: int) -> Dataset:
    """Return a log of `nominal.MODEL` with a hip that adds 0.8 rad of wrap angle per rad.

    The pretension changes by `share` times (3.52), calculated from the four tensions. The torque is small.
    """
    rng = np.random.default_rng(seed)
    phases = rng.uniform(0.0, 6.0, 5)
    parts = ((0.5, 0.31), (0.2, 0.83))
    q = sum(a * np.sin(2.0 * np.pi * f * T + p) for (a, f), p in zip(parts, phases, strict=False))
    omega = sum(2.0 * np.pi * f * a * np.cos(2.0 * np.pi * f * T + p) for (a, f), p in zip(parts, phases, strict=False))
    hip = 0.5 * np.sin(2.0 * np.pi * 0.4 * T + phases[2])
    tau_m = 0.4 * np.sin(2.0 * np.pi * 0.17 * T + phases[3]) + 0.24 * np.sin(2.0 * np.pi * 0.43 * T + phases[4])
    slope = 6e4 / 1.2 * 3e-4
    tension = 45.0 + share * slope * 0.8 * hip
    growth = np.exp(np.sign(omega) * 0.1 * (2.6 + 0.8 * hip))
    tau_j = 0.025 * ((tension + tau_m / 0.04) / growth - (tension - tau_m / 0.04) * growth)
    columns = {"t": T, "tau_m": tau_m + 1e-3 * rng.standard_normal(T.size), "q_j": q, "q_j.hip": hip}
    columns["tau_j"] = tau_j + 0.004 * rng.standard_normal(T.size)
    columns["omega_j"] = omega + 0.01 * rng.standard_normal(T.size)
    return Dataset.from_arrays(columns, f"run{seed}.csv")


@pytest.mark.slow
@pytest.mark.parametrize(("share", "seed"), [(0.0, 2), (0.8, 1), (1.2, 2), (3.0, 1)])
def test_the_interval_of_a_gain_does_not_assume_the_path_length(share: float, seed: int) -> None:
    """The pretension changes otherwise than by (3.52). The gain was wrong by up to half, with an interval of 2 %."""
    found = diagnose([leg_log(share, seed)], model())
    gain = {cause.effect: cause for cause in found.causes}[NAME].parameters["hip"]
    assert isinstance(gain, Quantity)
    assert gain.low <= 0.8 <= gain.high
    assert {cause.effect for cause in found.causes} <= {NAME, "pretension_per_joint_angle"}


@pytest.mark.slow
def test_the_joint_with_the_wrong_gain_is_named_first() -> None:
    log = leg_log(1.0, 2)
    ankle = {"q_j.ankle": 0.4 * np.sin(2.0 * np.pi * 0.29 * T)}
    columns = {name: log[name] for name in ("t", "tau_m", "tau_j", "omega_j", "q_j")}
    found = diagnose([Dataset.from_arrays({**columns, **ankle, "q_j.hip": log["q_j.hip"]}, "run.csv")], model())
    assert [*found.causes[0].parameters] == ["hip", "ankle"]
    assert "hip 0." in found.sentence


@pytest.mark.slow
def test_joints_that_move_in_proportion_are_reported_and_not_one_of_them() -> None:
    log = leg_log(1.0, 2)
    columns = {name: log[name] for name in ("t", "tau_m", "tau_j", "omega_j", "q_j", "q_j.hip")}
    found = diagnose([Dataset.from_arrays({**columns, "q_j.knee": -1.3 * log["q_j.hip"]}, "run.csv")], model())
    assert found.verdict is Verdict.INSUFFICIENT
    assert "the joints hip and knee move in proportion" in found.sentence


def test_a_gain_at_its_limit_is_within_the_range_of_the_file() -> None:
    """Rounding gave 10.000000000000002 rad/rad, which a model file may not have."""
    scales = Scales(*[1.0] * 15, derived_velocity="", plain=False, offset=False)
    for reach in np.linspace(0.02, 2.0, 200).tolist():
        (variant,) = CATALOGUE[NAME].search(NAME, dataclasses.replace(scales, joints={"hip": reach}))
        parameters = variant.parameters(np.array([variant.coordinates[0].high]))
        assert check_effects({NAME: parameters}, "file") == {NAME: {"hip": pytest.approx(10.0)}}


def one_log(gains: dict[str, float] | None) -> tuple[Dataset, TendonSheath]:
    """Return the log of a rig and its file with the true friction and pretension.

    `gains` replaces the routing of the file unless it is None.
    """
    case, _ = routed_case("right", 1, short=True)
    model = model_from(tomllib.loads(case.model), "nominal.toml")
    assert isinstance(model, TendonSheath)
    assert case.bench is not None
    true = dataclasses.replace(model, friction_coefficient=case.bench.rig.mu, pretension=case.bench.rig.pretension)
    if gains is not None:
        true = dataclasses.replace(true, routing=Routing.sum_of(None, gains))
    return Dataset.from_arrays(case.logs[0].columns, "run.csv"), true


def test_a_simulation_follows_the_routing_of_the_file() -> None:
    """The error consists of sensor noise and wrong signs at reversals.

    Without the routing it is several times larger.
    """
    log, model = one_log(None)
    _, constant = one_log({})
    followed, fixed = simulate(log, model).rms, simulate(log, constant).rms
    assert followed is not None
    assert fixed is not None
    assert followed < 0.4 * fixed


def test_a_calibration_takes_the_wrap_angle_of_the_routing_as_known() -> None:
    """x and T_p are identified separately, because the wrap angle varied by a known amount."""
    log, model = one_log(None)
    off = model.recalibrated(1.1 * model.friction_angle, 0.9 * model.pretension)
    found = calibrate([log], off)
    assert found.split
    assert found.model.friction_angle == pytest.approx(model.friction_angle, rel=0.05)
    assert found.model.pretension == pytest.approx(model.pretension, rel=0.05)


def test_an_angle_that_the_log_lacks_is_one_line_with_the_remedy() -> None:
    log, model = one_log(None)
    columns = {name: log.columns[name] for name in ("t", "tau_m", "tau_j", "q_j")}
    with pytest.raises(UsageError) as caught:
        simulate(Dataset.from_arrays(columns, "run.csv"), model)
    assert str(caught.value) == (
        "run.csv: column q_j.hip is missing, and [routing] of nominal.toml names joint 'hip'; log its angle (rad), "
        "name the axis of a log of all joints (run.mcap:AXIS), or add column theta"
    )
    measured = Dataset.from_arrays({**columns, "theta": np.full(len(log), model.bending_angle)}, "run.csv")
    assert simulate(measured, model).rms is not None
