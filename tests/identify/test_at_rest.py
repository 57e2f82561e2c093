"""A joint that rests between strokes: the torque at rest is not friction and does not determine x and T_p0."""

from __future__ import annotations

import numpy as np

from tests.blind import tendon_logs
from tests.identify.test_calibrate import rig_and_model
from tsa_ctrl.identify.calibrate.keep_split import least_error
from tsa_ctrl.identify.calibrate.prepared import prepare
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.model.steady_sliding import sliding


def test_a_joint_at_rest_does_not_make_the_least_friction_the_best() -> None:
    """In half of the log friction holds the joint, at torques between the two sliding branches."""
    rng, rig, model = rig_and_model(3)
    columns = tendon_logs.record(rig, rng, noise=1e-3)
    n = columns["t"].size
    rest = {name: values.copy() for name, values in columns.items()}
    half_loop = rig.truth()["half_loop_torque"]
    middle = rig.r_j / rig.r_m * columns["tau_m"]
    rest["tau_j"] = middle + 0.3 * half_loop * np.sin(np.arange(n) / 400.0)
    rest["omega_j"] = 1e-4 * rng.normal(size=n)
    joined = {name: np.concatenate([columns[name], rest[name]]) for name in columns}
    joined["t"] = np.arange(2 * n) * float(columns["t"][1] - columns["t"][0])
    logs = prepare([Dataset.from_arrays(joined, "a.csv")], model, {})
    x, tension = least_error(logs, model)
    found = sliding(model, 1.0, x.value, tension.value).half_loop
    assert abs(found / half_loop - 1.0) < 0.05
