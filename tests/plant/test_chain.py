"""Test the distributed tendons: closed forms in the limit, slip fronts, energy, slack."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.plant.bench import R_J, R_M, T_P0, X, axis
from tests.plant.test_full import RAMP, run
from tsa_ctrl.plant.axis import CURVATURES
from tsa_ctrl.plant.chain import Row, build_chain, chain_tensions, commit_chains, prepare_chains, settle
from tsa_ctrl.plant.state import PARAMETERS

EA, LENGTH = 60e3, 1.2


class Tendons:
    """Both tendons with prescribed ends. `pull(u, v)` moves the tendons at motor and joint pulley, m."""

    def __init__(self, curvature: str = "uniform", elements: int = 40, x: float = X, bristle: float = 0.0) -> None:
        self.p = np.zeros(1, PARAMETERS)
        for name, value in {"stiffness": EA, "length": LENGTH, "theta": 2.6, "reference_tension": T_P0}.items():
            self.p[name] = value
        curve = np.ascontiguousarray(np.array(CURVATURES[curvature], dtype=float).T)
        chain = build_chain(curve, elements, EA, LENGTH, 0.0, bristle)
        self.chains = np.ascontiguousarray(np.stack((chain, chain)))
        for tendon in self.chains:
            settle(tendon, 0.0, 0.0, T_P0)
        self.x = x

    def pull(self, u: float, v: float, pretension: float = T_P0) -> NDArray[np.float64]:
        """Move the ends, and return T1, T2, T3 and T4."""
        f = np.zeros(13)
        both = (pretension, pretension)
        totals = prepare_chains(self.p[0], both, (2.6, 2.6), (self.x, self.x), self.chains)
        assert chain_tensions(self.p[0], totals, self.chains, u, v, f)
        self.last_taken, self.used = commit_chains(self.chains)
        return f[:4]


def test_the_error_falls_with_the_square_of_the_elements(tmp_path: Path) -> None:
    def error(elements: int) -> float:
        joint = axis(tmp_path, tendon={"kind": "distributed", "elements": elements}, motion=RAMP)
        return abs(run(joint, 1.0, 0.3)["tau_j"] - R_J * (1.0 / R_M - 2 * T_P0 * X))

    ratio = error(5) / error(20)
    assert 14 < ratio < 18


@pytest.mark.parametrize("x", [0.1, 0.26, 0.6])
def test_after_a_reversal_the_output_is_frozen_until_the_input_moved_by_exp_2x(x: float) -> None:
    tendons = Tendons(x=x)
    u = 0.0
    for _ in range(4000):  # the motor winds up tendon b while the joint is at rest
        u += 1e-7
        pulled = tendons.pull(u, 0.0)
    assert pulled[3] == pytest.approx(pulled[2] * math.exp(-x), rel=1e-9)
    turned, frozen = pulled[2], pulled[3]
    while True:
        u -= 1e-7
        pulled = tendons.pull(u, 0.0)
        if abs(pulled[3] - frozen) > 1e-3:
            break
    assert turned / pulled[2] == pytest.approx(math.exp(2 * x), rel=2e-3)


@pytest.mark.parametrize("curvature", ["uniform", "motor_end", "joint_end"])
def test_contacts_that_stick_pass_on_at_most_one_percent_of_a_change(curvature: str) -> None:
    """The motor moves back until the tension has changed by a fifth of the friction, and the joint is locked."""
    tendons = Tendons(curvature)
    for u in np.linspace(0.0, 4e-4, 400):
        start = tendons.pull(u, 0.0)
    while (start[2] - (now := tendons.pull(u, 0.0))[2]) < 0.2 * (start[2] - start[3]):
        u -= 1e-7
    assert abs(start[3] - now[3]) < 0.0101 * (start[2] - now[2])


def test_a_slip_front_travels_from_the_motor_end() -> None:
    tendons = Tendons()
    for u in np.linspace(0.0, 4e-4, 400):
        tendons.pull(u, 0.0)
    fronts = []
    for u in np.linspace(4e-4, 3.6e-4, 40):
        tendons.pull(u, 0.0)
        sliding_back = tendons.chains[1, Row.MODE, :-1] < 0
        assert not np.any(np.diff(sliding_back.astype(int)) > 0)  # one front, which begins at the motor
        fronts.append(int(sliding_back.sum()))
    assert fronts == sorted(fronts)
    assert fronts[0] < fronts[-1] < 40


@pytest.mark.parametrize("curvature", ["uniform", "motor_end", "joint_end"])
@pytest.mark.parametrize("bristle", [0.0, 1e5])
def test_friction_never_creates_energy(curvature: str, bristle: float) -> None:
    """In no step, where tests/plant/test_energy.py has the sum of closed cycles."""
    rng = np.random.default_rng(1)
    tendons = Tendons(curvature, bristle=bristle)
    u = v = 0.0
    for _ in range(1000):
        du, dv = rng.normal(0.0, 2e-5, 2)
        u, v = 0.999 * (u + du), 0.999 * (v + dv)
        tendons.pull(u, v)
        assert tendons.last_taken >= -1e-9


def test_slack_is_everywhere_or_nowhere_and_ends_where_it_began() -> None:
    tendons = Tendons()
    natural = T_P0 * LENGTH / EA
    for u in np.linspace(0.0, 1.5 * natural, 300):
        tension = tendons.pull(u, 0.0)
    assert tension[0] == tension[1] == 0.0
    for u in np.linspace(1.5 * natural, 0.999 * natural, 300):
        tension = tendons.pull(u, 0.0)
    assert 0.0 < tension[0] < 0.2
    assert np.all(tendons.chains[0, Row.TENSION] >= 0.0)


def test_a_bristle_makes_sticking_elastic() -> None:
    stiff, soft = Tendons(), Tendons(bristle=1e5)
    moves = [tendons.pull(2e-5, 2e-5) for tendons in (stiff, soft)]
    assert abs(moves[0][2] - moves[0][3]) > abs(moves[1][2] - moves[1][3]) > 0.0


@pytest.mark.parametrize("curvature", ["uniform", "motor_end", [(0.0, 0.0), (0.3, 0.1), (0.4, 0.8), (1.0, 1.0)]])
@pytest.mark.parametrize("inertia", [0.0, 1e-4])
def test_wild_torques_are_always_solved(tmp_path: Path, curvature: Any, inertia: float) -> None:
    rng = np.random.default_rng(7)
    joint = axis(
        tmp_path,
        tendon={"kind": "distributed", "curvature": curvature},
        joint={"load": "spring"},
        motor={"inertia": inertia, "damping": 1e-4},
    )
    torque = 0.0
    for i in range(500):
        torque = 3.0 if i == 300 else 0.98 * torque + rng.normal(0.0, 0.1)
        values = run(joint, torque, 1e-3)
    assert np.all(np.isfinite(list(values.values())))


def test_a_chain_has_the_whole_bending_and_length() -> None:
    points = np.array([[0.0, 0.25, 0.25, 1.0], [0.0, 0.2, 0.7, 1.0]])
    chain = build_chain(points, 40, EA, LENGTH, 0.5, 0.0)
    assert chain[Row.BEND, :-1].sum() == pytest.approx(1.0)
    assert (EA / chain[Row.STIFFNESS]).sum() == pytest.approx(LENGTH + 0.5)
    assert chain[Row.BEND_SHARE].sum() == pytest.approx(1.0)
    assert chain[Row.BEND, 10] == pytest.approx(0.5 + 0.3 / 30)
