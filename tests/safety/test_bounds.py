"""Detection of bounds that are looser than the shipped ones: every key of the table against the settings' defaults."""

from __future__ import annotations

import math

import msgspec
import pytest

from tsa_ctrl.bus.settings import BusSettings, DriveSettings, EncoderSettings, SupervisionSettings, TorqueSensorSettings
from tsa_ctrl.config import ControllerSection
from tsa_ctrl.control.settings import DirectionSettings, EstimatorSettings, LawSettings, SetPointSettings
from tsa_ctrl.safety.bounds import KEYS, SMALLER, loose_bounds
from tsa_ctrl.safety.limiter import LimiterSettings
from tsa_ctrl.safety.settings import PassivitySettings, PlausibilitySettings
from tsa_ctrl.safety.use_class import SafetySettings
from tsa_ctrl.sensors.process import SerialSensorSettings
from tsa_ctrl.system.realtime import RealtimeSettings

SECTIONS: dict[str, msgspec.Struct] = {
    "controller": ControllerSection(),
    "realtime": RealtimeSettings(),
    "bus": BusSettings(),
    "bus.supervision": SupervisionSettings(),
    "safety": SafetySettings(),
    "axis.drive": DriveSettings(node_id=1),
    "axis.encoder": EncoderSettings(node_id=2),
    "axis.torque_sensor": TorqueSensorSettings(node_id=3),
    "axis.setpoint": SetPointSettings(),
    "axis.direction": DirectionSettings(),
    "axis.law": LawSettings(),
    "axis.estimator": EstimatorSettings(),
    "axis.serial": SerialSensorSettings(quantity="tau_j", port="/dev/null"),
    "axis.limits": LimiterSettings(torque=1.0),
    "axis.plausibility": PlausibilitySettings(),
    "axis.passivity": PassivitySettings(),
}
TORQUE = {("axis.limits", "torque"): 1.0}


def test_shipped_defaults_are_not_loose() -> None:
    assert set(SECTIONS) == set(KEYS)
    assert not list(loose_bounds(SECTIONS, TORQUE))


@pytest.mark.parametrize(("section", "key"), [(section, key) for section, keys in KEYS.items() for key in keys])
def test_every_key_is_found_when_it_is_looser(section: str, key: str) -> None:
    """A larger number, a slower filter or a changed flag is one finding. A tighter bound is not reported."""
    default = getattr(SECTIONS[section], key)
    if isinstance(default, bool):
        looser: object = not default
    elif key == "travel":
        looser = (-90.0, 90.0)
    elif key == "joint_speed":  # must stay below over_speed
        looser = 1.1 * default
    elif key in SMALLER:
        looser = default / 2.5
    else:
        looser = 2.5 * (1 if default is None else default)
    changed = SECTIONS | {section: msgspec.structs.replace(SECTIONS[section], **{key: looser})}
    (found,) = loose_bounds(changed, TORQUE)
    assert (found.section, found.key, found.unfit_to_wear) == (section, key, key != "joint_speed")
    if isinstance(default, float):
        tighter = SECTIONS | {
            section: msgspec.structs.replace(SECTIONS[section], **{key: (1.1 if key in SMALLER else 0.9) * default})
        }
        assert not list(loose_bounds(tighter, TORQUE))


def test_a_bound_up_to_twice_the_shipped_one_may_be_worn() -> None:
    changed = SECTIONS | {"axis.drive": DriveSettings(node_id=1, host_timeout=0.2)}
    (found,) = loose_bounds(changed, TORQUE)
    assert not found.unfit_to_wear
    assert str(found) == "[axis.drive] host_timeout 0.2 s (shipped is 0.1)"


def test_a_section_that_is_not_there_has_no_bounds() -> None:
    assert not list(loose_bounds({"axis.encoder": None}, {}))


def test_a_bound_whose_default_follows_from_the_model_says_so() -> None:
    (found,) = loose_bounds({"axis.plausibility": PlausibilitySettings(slip=1.0)}, {})
    assert math.isnan(found.shipped)
    assert str(found).endswith("(shipped follows from the model)")
