"""A model file with an arbitrary curvature profile: simulation, calibration and diagnosis on logs of such a sheath."""

from __future__ import annotations

import dataclasses

import pytest

from tests.identify.bent_logs import record
from tests.model.actuator import ACTUATOR
from tests.model.capstan import Pair
from tsa_ctrl.identify import diagnose
from tsa_ctrl.identify.calibrate import calibrate
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.model.curvature import Points
from tsa_ctrl.model.parameters import TendonSheath

SERIES = 2e4  # N/m
S_BENT: Points = ((0.0, 0.0), (0.3, 0.5), (0.7, 0.5), (1.0, 1.0))
ONE_BEND: Points = ((0.0, 0.0), (0.1, 0.0), (0.2, 1.0), (1.0, 1.0))
MOTOR_END: Points = ((0.0, 1.0), (1.0, 1.0))
RIGS = {
    "S": (Pair(S_BENT, 0.31), False),
    "one bend": (Pair(ONE_BEND, 0.31), False),
    "motor end, much friction": (Pair(MOTOR_END, 1.0), False),
    "S, spring at the joint": (Pair(S_BENT, 0.6, joint_spring=1.0 / SERIES), True),
}
OFF = 1.15  # nominal x and T_p0 are smaller by this factor


def nominal(pair: Pair, spring: bool, off: float = OFF) -> TendonSheath:
    """Return the model file of a rig: its curvature profile, and a friction angle and a pretension that are too small
    by `off`.
    """
    bent = ACTUATOR.with_effects({"elongation_coupling": {"curvature_profile": pair.points}})
    if spring:
        bent = dataclasses.replace(bent, series_stiffness=SERIES, series_at_joint=True)
    return bent.recalibrated(pair.x / off, pair.pretension / off)


EACH = pytest.mark.parametrize("rig", RIGS)
TENSIONED = pytest.mark.parametrize(  # with two pretensions, all curvature profiles give the same information
    "rig", [pytest.param(rig, marks=[pytest.mark.soak] if rig.startswith("S") else []) for rig in RIGS]
)


class TestRig:
    """Simulation, calibration and diagnosis recover known parameters."""

    @EACH
    def test_calibrated_in_one_configuration(self, rig: str) -> None:
        """The file's proportion of x and T_p0 is right, so both are recovered."""
        pair, spring = RIGS[rig]
        found = calibrate([Dataset.from_arrays(record(pair, 1), "a")], nominal(pair, spring))
        assert found.friction_angle.value == pytest.approx(pair.x, rel=3e-3)
        assert found.pretension.value == pytest.approx(pair.pretension, rel=3e-3)
        assert found.rms_after < 6e-3

    @pytest.mark.parametrize("gain", [0.96, 1.0, 1.04])
    def test_much_friction_is_split_by_the_slope(self, gain: float) -> None:
        """The file's proportion is wrong by 40 %, and the torque constant is known only within a few percent."""
        pair, _ = RIGS["motor end, much friction"]
        table = record(pair, 3)
        table["tau_m"] = table["tau_m"] * gain
        file = nominal(pair, False, 1.0).recalibrated(1.18 * pair.x, pair.pretension / 1.18)
        found = calibrate([Dataset.from_arrays(table, "a")], file)
        assert found.split
        assert found.friction_angle.low <= pair.x <= found.friction_angle.high
        assert abs(found.friction_angle.value / pair.x - 1.0) < 0.07

    @pytest.mark.parametrize(("rig", "bends"), [("S", S_BENT), ("motor end, much friction", ((0.0, 0.0), (1.0, 1.0)))])
    def test_a_slope_that_shows_nothing_or_contradicts_the_file_splits_nothing(self, rig: str, bends: Points) -> None:
        """Little friction does not change the slope, and a wrong curvature profile makes the slope impossible."""
        pair, _ = RIGS[rig]
        file = ACTUATOR.with_effects({"elongation_coupling": {"curvature_profile": bends}})
        found = calibrate([Dataset.from_arrays(record(pair, 4), "a")], file.recalibrated(pair.x, pair.pretension))
        assert not found.split

    @pytest.mark.slow
    @TENSIONED
    def test_split_by_the_tensioner(self, rig: str) -> None:
        """Two logs with a known difference of pretension separate x and T_p0."""
        pair, spring = RIGS[rig]
        logs = [Dataset.from_arrays(record(pair, 1 + k, more_pretension=18.0 * k), f"{k}") for k in range(2)]
        found = calibrate(logs, nominal(pair, spring), tensioner={"1": 18.0})
        assert found.split
        assert found.friction_angle.value == pytest.approx(pair.x, rel=5e-3)
        assert found.pretension.value == pytest.approx(pair.pretension, rel=5e-3)

    @EACH
    def test_split_by_measured_tensions(self, rig: str) -> None:
        """T1 and T3 contain the change of pretension by the elongation. T_p0 is the pretension without friction."""
        pair, spring = RIGS[rig]
        found = calibrate([Dataset.from_arrays(record(pair, 1, tensions=True), "a")], nominal(pair, spring))
        assert found.split
        assert found.friction_angle.value == pytest.approx(pair.x, rel=3e-3)
        assert found.pretension.value == pytest.approx(pair.pretension, rel=3e-3)


@pytest.mark.slow
def test_diagnosed() -> None:
    """Unknown viscous friction is identified, and the file's curvature profile stays in the extended model."""
    pair, spring = RIGS["S, spring at the joint"]
    logs = [Dataset.from_arrays(record(pair, 1, seconds=20.0, viscous=0.08), "a")]
    found = diagnose(logs, nominal(pair, spring, 1.05))
    assert [cause.effect for cause in found.causes] == ["viscous_friction"]
    assert found.causes[0].parameters["coefficient"].value == pytest.approx(0.08, rel=0.05)  # type: ignore[union-attr]
    assert found.model.effects["elongation_coupling"] == {"curvature_profile": S_BENT}
    assert found.not_testable["elongation_coupling"] == "already in the model file"
    assert isinstance(found.model, TendonSheath)
    assert found.model.series_at_joint
    assert found.to_json()
