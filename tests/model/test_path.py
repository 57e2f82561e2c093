"""Path length, bending and pretension: (3.49)-(3.52), (3.56)."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tsa_ctrl.model import path
from tsa_ctrl.model.functions import ARRAYS, SCALARS
from tsa_ctrl.model.parameters import TendonSheath

ACTUATOR = TendonSheath(
    motor_pulley_radius=0.020,
    joint_pulley_radius=0.025,
    axial_stiffness=60e3,
    unstrained_length=1.2,
    diameter=0.6e-3,
    contact_offset=0.4e-3,
    friction_coefficient=0.1,
    bending_angle=2.6,
    pretension=45.0,
)


def test_path_grows_by_contact_offset_and_half_the_diameter() -> None:
    """(3.50): 0.7 mm per rad here."""
    assert path.path_length(ACTUATOR, 2.0, 1.2) == pytest.approx(1.2 + 2.0 * 0.7e-3)


def test_pretension_returns_from_the_unstrained_angle() -> None:
    """(3.51) and (3.56) undo `unstrained_bending_angle`."""
    unstrained = path.unstrained_bending_angle(ACTUATOR)
    assert unstrained == pytest.approx(2.6 - 45.0 / 35.0)
    assert path.pretension(ACTUATOR, path.length_change(ACTUATOR, 2.6, unstrained)) == pytest.approx(45.0)


def test_pretension_follows_bending() -> None:
    """k_t (p + d/2) = 50 kN/m * 0.7 mm/rad = 35 N/rad."""
    assert path.pretension_at(SCALARS, ACTUATOR, 2.8) == pytest.approx(45.0 + 0.2 * 35.0)


def test_slack_is_no_pretension() -> None:
    """Below Theta_us the tendon hangs; it does not push."""
    assert path.pretension_at(ARRAYS, ACTUATOR, np.array([1.0])) == pytest.approx([0.0])


def test_series_element_softens() -> None:
    """k_t = 1/(l_us/EA + 1/k_s): the reason for the mechanism's name."""
    soft = dataclasses.replace(ACTUATOR, series_stiffness=50e3)
    assert path.pretension_slope(soft) == pytest.approx(0.5 * path.pretension_slope(ACTUATOR))
