"""The torque sensor's correction in the whole loop, on the plant's distributed tendons."""

from __future__ import annotations

import numpy as np
import pytest

from tools.campaign.passive.experiment import Experiment


def error(load: str, set_point: str, friction: float, feedback: float, seconds: float = 7.0) -> float:
    """Return the RMS error of the delivered torque in the second half of a run, N*m."""
    rig = Experiment(load, set_point, "sensor", friction=friction, compensation=0.95, feedback=feedback)
    (axis,) = rig.play(seconds).axes
    assert not axis.faults
    return float(np.sqrt(np.mean(np.square(axis.error[axis.error.size // 2 :]))))


@pytest.mark.slow
@pytest.mark.parametrize(("load", "set_point"), [("held", "sine"), ("imposed", "gait")])
def test_friction_that_the_file_does_not_have_is_corrected(load: str, set_point: str) -> None:
    """A plant with 6 % more friction than the file: at least a third of the error is removed."""
    assert error(load, set_point, 1.06, 3.0) < 0.67 * error(load, set_point, 1.06, 0.0)


@pytest.mark.slow
def test_a_rig_that_the_file_describes_exactly_does_not_get_worse() -> None:
    assert error("held", "sine", 1.0, 3.0) < 1.1 * error("held", "sine", 1.0, 0.0)
