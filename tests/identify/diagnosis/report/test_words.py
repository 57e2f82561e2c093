"""The first sentence is short for every result, and the report proposes one experiment."""

from __future__ import annotations

import dataclasses

import pytest

from tsa_ctrl.identify.diagnosis.parameters.formula import Formula
from tsa_ctrl.identify.diagnosis.report.experiment import _parting_most
from tsa_ctrl.identify.diagnosis.report.result import Cause, Diagnosis, Experiment, Rms, Verdict
from tsa_ctrl.identify.diagnosis.report.words import four_lines, insufficient_sentence, remarks, sentence, spoken
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.identify.three_errors import ThreeErrors
from tsa_ctrl.model.effects.specification import Motion
from tsa_ctrl.model.parameters import RigidDrive

LONG = Cause(
    "direction_asymmetric_friction",
    ("load_dependent_friction", "configuration_dependent_bending", "tension_dependent_friction"),
    0.4,
    {"viscous_difference": Quantity(0.1, 0.05, 0.2, "N*m*s/rad")},
    0.5,
)
PLAIN = Cause("torque_offset", (), 1.0, {"offset": Quantity(0.0003487, 0.00029, 0.000407, "N*m")}, 1.0)


def told(verdict: Verdict, *causes: Cause, left: str = "", formula: Formula | None = None) -> str:
    rms = Rms(0.06, 0.05, 0.01, 0.009, 0.06)
    nothing = Experiment("")
    found = Diagnosis(verdict, "", causes, {}, left, {}, {}, nothing, rms, 0.9, RigidDrive())
    return sentence(dataclasses.replace(found, formula=formula))


@pytest.mark.parametrize("count", [1, 2, 4])
def test_the_first_sentence_has_at_most_35_words_and_names_the_first_cause(count: int) -> None:
    found = told(Verdict.PARTLY_EXPLAINED, *[LONG] * count, left="the residual depends on the load")
    assert found.startswith("Direction asymmetric friction")
    assert "from 50 to 10 mN·m" in found
    assert len(found.split()) <= 35


def test_what_is_simple_is_told_whole() -> None:
    assert "torque offset, offset 0.0003487 N·m (0.00029 to 0.000407)" in told(
        Verdict.EXPLAINED, PLAIN
    ).lower().replace("n·m", "N·m")


def test_a_long_list_of_what_is_left_is_cut_from_the_first_sentence() -> None:
    left = "the residual depends on several signals at once (44% of its mean square); it also depends on the load"
    assert len(told(Verdict.UNEXPLAINED, left=left).split()) <= 35


@pytest.mark.parametrize("text", ["a*tau**3", " + ".join(["a*sin(q_j)*tau"] * 9)], ids=["short", "long"])
def test_a_formula_that_takes_most_of_what_is_left_comes_first(text: str) -> None:
    formula = Formula(text, {}, RigidDrive(), 0.96, (0.05, 0.01), 1, 1, 1)
    found = told(Verdict.UNEXPLAINED, left="the residual is a slow drift (100% of its mean square)", formula=formula)
    assert "no effect explains it; a formula takes 96% of it" in found
    assert (text in found) == (len(text) < 20)
    assert len(found.split()) <= 35
    little = dataclasses.replace(formula, gain=0.3)
    assert "slow drift" in told(Verdict.UNEXPLAINED, left="the residual is a slow drift", formula=little)


def test_a_long_reason_goes_on_in_a_second_sentence() -> None:
    found = insufficient_sentence(
        "friction does not show: " + "so much " * 10 + "is known; the " + "motion " * 12 + "is small"
    )
    first, second = found.split(". ", 1)
    assert len(first.split()) <= 35
    assert second.startswith("The motion")
    assert insufficient_sentence("is it swapped?") == "These logs cannot determine: is it swapped?"


def test_that_parameters_are_no_rival_does_not_say_that_they_are_right() -> None:
    assert spoken("parameter_error") == "wrong parameters alone"


def test_one_motion_parts_most_pairs() -> None:
    pairs = [
        ("thermal_friction_drift", "pretension_relaxation"),
        ("transport_delay", "backlash"),
        ("velocity_lag", "backlash"),
    ]
    motion, parted = _parting_most(pairs)
    assert motion is Motion.SPEEDS
    assert parted == pairs[1:]


def four(verdict: Verdict, *causes: Cause, left: str = "", sliding: float = 0.011) -> dict[str, str]:
    rms = Rms(0.06, 0.05, 0.01, 0.009, 0.06, 0.055)
    errors = ThreeErrors(sliding, 0.03, 0.009)
    experiment = Experiment("move in both directions")
    found = Diagnosis(verdict, "", causes, {}, left, {}, {}, experiment, rms, 0.9, RigidDrive(), errors=errors)
    return four_lines(found)


def test_four_lines_state_error_cause_rest_and_next_step() -> None:
    found = four(Verdict.EXPLAINED, PLAIN)
    assert list(found) == ["Error", "Cause", "Rest", "Next"]
    expected = (
        "55 mN·m RMS with the model file; with extended.toml 11 mN·m while sliding, 30 mN·m in reversals; "
        "the sensor noise is"
    )
    assert found["Error"] == f"{expected} 9 mN·m"
    assert found["Cause"] == "torque offset, offset 0.0003487 N·m (0.00029 to 0.000407)"
    assert found["Rest"] == "noise"
    assert found["Next"].startswith("use extended.toml")


def test_what_only_reversals_leave_is_not_called_more_than_noise() -> None:
    left = "the residual depends on time (23% of its mean square); it also depends on the load"
    rest = four(Verdict.PARTLY_EXPLAINED, PLAIN, left=left)["Rest"]
    noisier = "it is 1.2 times the sensor noise and depends on time (23% of its mean square)"
    assert rest == f"mostly in reversals; while sliding {noisier}"
    alone = four(Verdict.PARTLY_EXPLAINED, PLAIN, left=left, sliding=0.009)["Rest"]
    assert alone == "in reversals alone; while sliding it is noise"
    much = four(Verdict.PARTLY_EXPLAINED, PLAIN, left=left, sliding=0.03)["Rest"]
    assert much == "more than noise: it depends on time (23% of its mean square)"


def test_with_alternatives_the_next_step_is_the_experiment() -> None:
    found = four(Verdict.EXPLAINED, LONG)
    assert found["Next"] == "move in both directions"
    assert "direction asymmetric friction, load dependent friction" in found["Cause"]


def test_the_first_sentence_and_the_gain_use_the_same_samples() -> None:
    """The error over all samples fell, while the printed gain was -168 %."""
    rms = Rms(0.06, 0.05, 0.01, 0.009, 0.06, 0.055, (0.009, 0.012))
    found = Diagnosis(
        Verdict.EXPLAINED, "", (PLAIN,), {}, "", {}, {}, Experiment("move"), rms, -1.68, RigidDrive(), gain_all=0.9
    )
    assert "the error falls from 50 to 10 mN·m" in sentence(found)
    (gain,) = [each for each in remarks(found) if "mean square" in each]
    assert "90% with reversals. They do not reduce the error while the joint slides." in gain
    slides = dataclasses.replace(found, rms=dataclasses.replace(rms, sliding=(0.04, 0.012)), gain=0.9)
    assert "the error while sliding falls from 40 to 12 mN·m" in sentence(slides)
    worse = dataclasses.replace(found, gain_all=-0.2, rms=dataclasses.replace(rms, extended=0.06))
    assert "the error does not fall on held-out data, 50 and 60 mN·m RMS" in sentence(worse)
    assert "The causes do not reduce the error on held-out data." in remarks(worse)
    assert "extended.toml" not in four_lines(worse)["Next"]


def test_a_rest_of_noise_names_a_parameter_at_its_limit() -> None:
    bound = {"pretension": (24.0, 24.0, 37.5, "N")}
    rms = Rms(0.06, 0.05, 0.01, 0.009, 0.06, 0.055)
    found = Diagnosis(Verdict.PARTLY_EXPLAINED, "", (PLAIN,), {}, "", {}, {}, Experiment(""), rms, 0.9, RigidDrive())
    rest = four_lines(dataclasses.replace(found, at_bounds=bound))["Rest"]
    assert rest == "noise, but the pretension reached the limit of [uncertainty] and may hide an error"


def test_without_a_cause_the_lines_say_so() -> None:
    assert four(Verdict.CONSISTENT)["Cause"] == "none"
    assert four(Verdict.UNEXPLAINED, left="the residual is a slow drift (90% of its mean square)")["Cause"] == (
        "none in the catalogue"
    )
    assert four(Verdict.INSUFFICIENT)["Error"] == "not known"
