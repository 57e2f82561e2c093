"""Test `tsa demo --leg`: each joint changes the wrap angle of the next, with and without the routing in the files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tsa_ctrl.cli import main
from tsa_ctrl.demo.leg import ANGLES, strides
from tsa_ctrl.demo.rig import MOST_TORQUE, PERIOD


def test_a_stride_ends_where_it_begins() -> None:
    for name, play in strides().items():
        assert play.t[-1] == pytest.approx(PERIOD)
        assert play.q_j[0] == pytest.approx(play.q_j[-1]), name
        assert play.tau_j_des[0] == pytest.approx(play.tau_j_des[-1]), name
        assert np.abs(play.tau_j_des).max() < MOST_TORQUE


@pytest.mark.slow
def test_the_routing_halves_what_another_joint_leaves(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The routing reduces the RMS error of knee and ankle to less than 60 %.

    RMS errors of hip, knee and ankle (mN*m) are 592, 681 and 743 without compensation. They are 54, 154 and 180
    without routing, and 54, 73 and 73 with routing.
    """
    with pytest.raises(SystemExit) as ended:
        main(["demo", "--leg", "--seconds", "5", "--out", str(tmp_path / "leg"), "--json"])
    assert not ended.value.code
    found = json.loads(capsys.readouterr().out)
    errors = {axis["name"]: axis["rms"] for axis in found["axes"]}
    assert list(errors) == list(ANGLES)
    assert errors["hip"]["with"] == pytest.approx(errors["hip"]["fixed"], rel=0.02)  # its sheath crosses no other joint
    for name in ("knee", "ankle"):
        assert errors[name]["with"] < 0.6 * errors[name]["fixed"]
        assert errors[name]["with"] < 0.15 * errors[name]["without"]
    assert found["reduction_percent"] > 85.0
    assert Path(found["picture"]).is_file()


def test_a_leg_takes_no_other_motion(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["demo", "--leg", "--load", "weight"])
    assert ended.value.code == 2
    assert "--leg can only be combined with" in capsys.readouterr().err
