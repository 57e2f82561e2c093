"""Closed cycles of both ends create no energy, for any bends of the sheath and both tendon models."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.plant.bench import ACTUATOR, R_J, R_M, axis
from tsa_ctrl.plant.axis import Axis
from tsa_ctrl.plant.chain import Row, chain_tensions, commit_chains, prepare_chains
from tsa_ctrl.plant.full import commit_full, full_tensions
from tsa_ctrl.plant.settings import PhysicsSettings

PROFILES: dict[str, Any] = {
    "uniform": "uniform",
    "motor_end": "motor_end",
    "joint_end": "joint_end",
    "s_bent": "s_bent",
    "one_bend": [(0.0, 0.0), (0.3, 0.0), (0.34, 1.0), (1.0, 1.0)],
}
POINTS = 800  # in one cycle
LEAST = -1e-9  # J, rounding of a cycle's sum

Path2 = NDArray[np.float64]


def closed_path(seed: int, radius: float) -> Path2:
    """Return displacements of the tendon at motor and joint (m) for one cycle, (POINTS, 2), of three harmonics each."""
    rng = np.random.default_rng(seed)
    t = np.arange(1, POINTS + 1) / POINTS * 2.0 * math.pi
    ends = []
    for _ in range(2):
        phases, sizes = rng.uniform(0.0, 2.0 * math.pi, 3), rng.normal(size=3)
        ends.append(
            sum(a / n * (np.cos(n * t + p) - np.cos(p)) for n, a, p in zip((1, 2, 3), sizes, phases, strict=True))
        )
    return radius * np.column_stack(ends)


def work_of_cycles(joint: Axis, path: Path2, cycles: int = 3) -> list[float]:
    """Energy (J) that motor and joint put into the tendons in each cycle.

    After the first cycle the state repeats, so that the remaining energy is the dissipated one.
    """
    s, p, arrays = joint.state[0], joint.parameters[0], joint._arrays
    x = float(p["friction"] * p["theta"])
    f = np.zeros(13)
    before: NDArray[np.float64] | None = None
    u = v = 0.0
    works = []
    for _ in range(cycles):
        work = 0.0
        for new_u, new_v in path.tolist():
            if p["distributed"]:
                pretension, theta = float(p["pretension"]), float(p["theta"])
                totals = prepare_chains(p, (pretension, pretension), (theta, theta), (x, x), arrays.chains)
                assert chain_tensions(p, totals, arrays.chains, new_u, new_v, f)
                commit_chains(arrays.chains)
            else:
                full_tensions(s, p, arrays.slip, arrays.curve, x, x, new_u, new_v, f)
                commit_full(s, p, arrays.slip, new_u / R_M, new_v / R_J, f[12])
            joint.state["q_m"], joint.state["q_j"] = new_u / R_M, new_v / R_J
            mean = f[:4] if before is None else 0.5 * (f[:4] + before)
            work += (mean[2] - mean[0]) * (new_u - u) - (mean[3] - mean[1]) * (new_v - v)
            before, u, v = f[:4].copy(), new_u, new_v
        works.append(work)
    return works


@pytest.mark.parametrize("profile", list(PROFILES))
@pytest.mark.parametrize("kind", ["full", "distributed"])
def test_a_closed_cycle_creates_no_energy(tmp_path: Path, kind: str, profile: str) -> None:
    for seed, (radius, friction) in enumerate(((1e-5, 0.1), (1e-4, 0.3), (1e-3, 0.1), (1e-4, 0.1))):
        joint = axis(tmp_path, tendon={"kind": kind, "curvature": PROFILES[profile]})
        joint.parameters["friction"] = friction
        works = work_of_cycles(joint, closed_path(seed, radius), 2)
        assert min(works[1:]) >= LEAST, (seed, friction, works)


@pytest.mark.slow
@pytest.mark.parametrize("position", ["motor", "joint"])
def test_a_series_element_changes_nothing_of_that(tmp_path: Path, position: str) -> None:
    for profile in PROFILES.values():
        settings = axis(tmp_path, tendon={"curvature": profile}).settings
        actuator = tmp_path / "actuator.toml"
        spring = f'series_stiffness = 2.0e4\nseries_position = "{position}"\ndiameter ='
        actuator.write_text(ACTUATOR.replace("diameter =", spring), encoding="utf-8")
        soft = Axis(settings, PhysicsSettings())
        assert float(soft.parameters["series_length"][0]) > 1.0
        for seed in (7, 8):
            assert min(work_of_cycles(soft, closed_path(seed, 1e-4), 2)[1:]) >= LEAST


def elastic_energy(joint: Axis) -> float:
    """Return the elastic energy of both chains and of their contacts, J."""
    chains = joint._arrays.chains
    springs = chains[:, Row.TENSION] ** 2 / chains[:, Row.STIFFNESS]
    force, held = chains[:, Row.FORCE_OLD, :-1], chains[:, Row.BRISTLE, :-1]
    return float(0.5 * (springs.sum() + (force**2 / np.where(held > 0.0, held, np.inf)).sum()))


@pytest.mark.parametrize("profile", list(PROFILES))
@pytest.mark.parametrize("load", ["held", "imposed", "spring", "spring, its pulley off its centre"])
def test_what_the_motor_gives_is_stored_delivered_or_taken_by_friction(tmp_path: Path, load: str, profile: str) -> None:
    """A motor with inertia gets an impulse. With all bends at a locked joint, friction dissipates almost nothing.

    On an eccentric pulley the lever arm is the derivative of the wound length, which the energy balance requires.
    """
    load, _, off = load.partition(",")
    effects = {"pulley_eccentricity": {"relative_eccentricity": 0.3, "phase": 0.4}} if off else {}
    step = 1e-4
    joint = axis(
        tmp_path,
        step=step,
        tendon={"kind": "distributed", "curvature": PROFILES[profile]},
        motor={"inertia": 1e-4, "damping": 1e-4},
        joint={"load": load},
        motion={"kind": "sine", "amplitude": 0.4, "frequency": 0.7, "ramp": 0.1},
        effects=effects,
    )
    s, rng = joint.state[0], np.random.default_rng(1)
    names = ("t1", "t2", "t3", "t4", "q_m", "q_j", "tau_tendon")
    joint.command.enabled = True
    given, stored = 0.0, elastic_energy(joint)
    before = np.array([s[name] for name in names])
    for i in range(3000):
        if i % 500 == 0:
            joint.command.torque = rng.uniform(-1.0, 1.0)
        joint.advance((i + 1) * step)
        now = np.array([s[name] for name in names])
        mean, moved = 0.5 * (before + now), now - before
        given += R_M * (mean[2] - mean[0]) * moved[4] - mean[6] * moved[5]
        before = now
    stored = elastic_energy(joint) - stored
    taken = float(s["dissipated"])
    assert taken > 0.0
    assert given - stored == pytest.approx(taken, rel=0.005, abs=2e-6)  # of 3 mJ in one oscillation
    assert joint.values()["unsolved"] == 0
