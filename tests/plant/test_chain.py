"""Test the distributed tendons: closed forms in the limit, slip fronts, energy, slack."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.plant.bench import R_J, R_M, T_P0, X, axis
from tests.plant.test_full import CLOSED_FORMS, RAMP, run
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
        self.taken = 0.0

    def pull(self, u: float, v: float, pretension: float = T_P0) -> NDArray[np.float64]:
        """Move the ends, and return T1, T2, T3 and T4."""
        f = np.zeros(13)
        both = (pretension, pretension)
        totals = prepare_chains(self.p[0], both, (2.6, 2.6), (self.x, self.x), self.chains)
        assert chain_tensions(self.p[0], totals, self.chains, u, v, f)
        self.last_taken, self.used = commit_chains(self.chains)
        self.taken += self.last_taken
        return f[:4]

    def elastic_energy(self) -> float:
        springs = 0.5 * self.chains[:, Row.TENSION] ** 2 / self.chains[:, Row.STIFFNESS]
        force, stiffness = self.chains[:, Row.FORCE_OLD, :-1], self.chains[:, Row.BRISTLE, :-1]
        bristles = np.where(stiffness > 0.0, 0.5 * force**2 / np.maximum(stiffness, 1e-300), 0.0)
        return float(springs.sum() + bristles.sum())


@pytest.mark.parametrize("curvature", list(CLOSED_FORMS))
@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("torque", [1.0, -0.6])
def test_sliding_tends_to_the_closed_form(tmp_path: Path, curvature: str, direction: int, torque: float) -> None:
    motion = {**RAMP, "amplitude": float(direction)}
    joint = axis(tmp_path, tendon={"kind": "distributed", "curvature": curvature}, motion=motion)
    delivered = run(joint, torque, 0.3)["tau_j"]
    assert delivered == pytest.approx(CLOSED_FORMS[curvature](torque, direction * X), abs=1e-5)


def test_uniform_bending_has_slope_one_and_half_loop_2_tp_x_rj(tmp_path: Path) -> None:
    def delivered(torque: float, direction: float) -> float:
        motion = {**RAMP, "amplitude": direction}
        joint = axis(tmp_path, tendon={"kind": "distributed", "elements": 160}, motion=motion)
        return run(joint, torque, 0.3)["tau_j"]

    forward, more, back = delivered(0.2, 1.0), delivered(1.0, 1.0), delivered(0.2, -1.0)
    assert (more - forward) / (1.0 - 0.2) * R_M / R_J == pytest.approx(1.0, abs=1e-6)
    assert (back - forward) / 2 == pytest.approx(2 * T_P0 * X * R_J, rel=1e-6)


def test_the_error_falls_with_the_square_of_the_elements(tmp_path: Path) -> None:
    def error(elements: int) -> float:
        joint = axis(tmp_path, tendon={"kind": "distributed", "elements": elements}, motion=RAMP)
        return abs(run(joint, 1.0, 0.3)["tau_j"] - CLOSED_FORMS["uniform"](1.0, X))

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
@pytest.mark.parametrize("seed", [1, 2])
def test_friction_never_creates_energy(curvature: str, bristle: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    tendons = Tendons(curvature, bristle=bristle)
    u = v = 0.0
    for _ in range(3000):
        du, dv = rng.normal(0.0, 2e-5, 2)
        u, v = 0.999 * (u + du), 0.999 * (v + dv)
        tendons.pull(u, v)
        assert tendons.last_taken >= -1e-9
    assert tendons.taken > 0.0


def test_work_is_stored_or_taken_by_friction() -> None:
    tendons = Tendons()
    rng = np.random.default_rng(3)
    u = v = work = 0.0
    before = tendons.elastic_energy()
    tension = tendons.pull(0.0, 0.0)
    for target_u, target_v in rng.normal(0.0, 3e-4, (30, 2)):
        du, dv = (target_u - u) / 200, (target_v - v) / 200
        for _ in range(200):
            u, v = u + du, v + dv
            new = tendons.pull(u, v)
            mean = 0.5 * (tension + new)
            work += (mean[2] - mean[0]) * du - (mean[3] - mean[1]) * dv
            tension = new
    stored = tendons.elastic_energy() - before
    assert work - stored == pytest.approx(tendons.taken, rel=2e-3)


def test_a_closed_path_takes_energy() -> None:
    tendons = Tendons()
    path = 3e-4 * np.sin(np.linspace(0.0, 4 * np.pi, 4000))
    work, last, tension = 0.0, 0.0, tendons.pull(0.0, 0.0)
    for place in path:
        new = tendons.pull(place, 0.0)
        work += 0.5 * (tension[2] - tension[0] + new[2] - new[0]) * (place - last)
        last, tension = place, new
    assert work > 0.0


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
