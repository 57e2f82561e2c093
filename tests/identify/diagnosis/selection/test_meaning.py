"""Fits that are not causes: a value at its bound, or several times the torque. No data of the package are used."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tsa_ctrl.identify.diagnosis.data.prepare import prepare
from tsa_ctrl.identify.diagnosis.data.split import split
from tsa_ctrl.identify.diagnosis.fitting.fit import Fit, fit
from tsa_ctrl.identify.diagnosis.fitting.problem import Hypothesis, Problem
from tsa_ctrl.identify.diagnosis.hypotheses.base import base_of
from tsa_ctrl.identify.diagnosis.hypotheses.candidates import candidates, scales_of
from tsa_ctrl.identify.diagnosis.noise.autoregressive import white_noise
from tsa_ctrl.identify.diagnosis.noise.nuisance import Nuisance
from tsa_ctrl.identify.diagnosis.rivals.elsewhere import Elsewhere
from tsa_ctrl.identify.diagnosis.selection.meaning import meaningless
from tsa_ctrl.model.parameters import RigidDrive

RATE, SECONDS, OFFSET = 200.0, 12.0, 0.3
DRIVE = RigidDrive(inertia=0.002, coulomb_friction=0.05, viscous_friction=0.01)


def fitted(*names: str) -> tuple[Problem, Fit]:
    """Return the problem of a drive under a constant torque that moves by 0.1 rad, and its fit with these effects."""
    t = np.arange(round(RATE * SECONDS)) / RATE
    q, omega = 0.1 * np.sin(3.0 * t), 0.3 * np.cos(3.0 * t)
    noise = np.random.default_rng(5).normal(0.0, 0.01, len(t))
    tau = 0.002 * -0.9 * np.sin(3.0 * t) + 0.05 * np.sign(omega) + 0.01 * omega + OFFSET + noise
    data = split(prepare({"log": {"t": t, "tau_m": tau, "q_m": q, "omega_m": omega}}, DRIVE), None)
    scales = scales_of(data.frame, DRIVE)
    base = base_of(DRIVE, scales)
    nothing = Nuisance(np.zeros((len(data.frame), 0)))
    problem = Problem(data.frame, base, white_noise(0.01), nothing, data.frame.train)
    hypothesis = Hypothesis(base)
    start = base.start()
    for name in names:
        variant = candidates(data.frame, DRIVE, scales).catalogue[name][0]
        hypothesis, start = hypothesis.plus(variant), np.concatenate([start, variant.starts[0]])
    return problem, fit(problem, hypothesis, start)


def test_an_offset_inside_the_torque_is_a_claim() -> None:
    problem, found = fitted("torque_offset")
    assert found.hypothesis.effects(found.point)["torque_offset"]["offset"] == pytest.approx(-OFFSET, abs=0.01)
    assert meaningless(problem, found) == []


def test_a_spring_that_rests_far_outside_the_motion_is_an_offset() -> None:
    """A spring that explains a constant torque hardly changes over the motion. A stiff spring is a cause."""
    problem, found = fitted("joint_stiffness")
    (values,) = found.hypothesis.effects(found.point).values()
    assert abs(values["rest_angle"]) > 10.0 * 0.1
    assert meaningless(problem, found) == [0]
    own = found.point.copy()
    own[-2:] = 1.0, 0.5  # as large as the torque at the end of the range
    assert meaningless(problem, dataclasses.replace(found, point=own)) == []


def test_giants_that_cancel_are_no_claims() -> None:
    problem, found = fitted("gravity_load", "torque_offset")
    own = found.point.copy()
    own[-3:] += [0.0, 6.0 / 0.06, -6.0 / 0.06]  # the sine cancels the offset; both have the same scale
    giants = dataclasses.replace(found, point=own)
    assert meaningless(problem, giants) == [0, 1]


def test_a_number_that_its_bound_holds_against_the_data_is_no_claim() -> None:
    problem, found = fitted("load_dependent_friction")
    bound = np.append(found.point[:-1], found.hypothesis.high[-1])
    predicted = problem.predicted(found.hypothesis.model(bound))
    column = problem.whiten(
        problem.predicted(found.hypothesis.model(bound - np.eye(len(bound))[-1] * 1e-2)) - predicted
    )
    for push, named in ((-1.0, [0]), (-0.001, [])):  # the data push beyond the bound strongly, or hardly at all
        residual = push * 1e3 * column / float(np.linalg.norm(column))
        at = dataclasses.replace(found, point=bound, residual=residual, jacobian=found.jacobian[:, :-1])
        assert meaningless(problem, at) == named
    inside = dataclasses.replace(found, point=np.append(found.point[:-1], 0.3))
    assert meaningless(problem, inside) == []


def test_a_rival_is_beaten_elsewhere_by_visibly_more_that_blocks_do_not_scatter() -> None:
    rng = np.random.default_rng(1)
    own = Elsewhere(rng.uniform(0.5, 1.5, 24))
    assert own.clearly_beats(Elsewhere(3.0 * own.squares))
    assert not own.clearly_beats(Elsewhere(1.2 * own.squares))  # not worse for a user
    one_block = own.squares.copy()
    one_block[3] += 40.0
    assert not own.clearly_beats(Elsewhere(one_block))  # caused by a single block
    assert not Elsewhere(3.0 * own.squares).clearly_beats(own)
