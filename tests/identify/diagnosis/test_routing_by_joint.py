"""A joint whose gain of the wrap angle differs from the file's is identified; the interval contains its gain."""

from __future__ import annotations

import dataclasses
import tomllib
from pathlib import Path

import numpy as np
import pytest

from tests.blind.routed import routed_case
from tests.identify.diagnosis.nominal import diagnosed
from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.calibrate import calibrate
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.diagnosis.report.page import write
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.identify.simulate import simulate
from tsa_ctrl.model.parameters import TendonSheath, load_tendon_sheath, model_from
from tsa_ctrl.model.routing import Routing

NAME = "routing_by_joint"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["absent", "wrong", "two"])
def test_the_missing_gain_of_each_joint_is_found(name: str, tmp_path: Path) -> None:
    """The [routing] of the extended file contains the sums of the file's gains and the missing gains."""
    case, gains = routed_case(name, 0, short=True)
    result = diagnosed(case)
    (cause,) = result.causes
    assert cause.effect == NAME
    assert not cause.alternatives
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
