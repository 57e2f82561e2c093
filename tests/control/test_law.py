"""The feedforward law: ideal plus friction term, compensated, faded in, slew-limited."""

from __future__ import annotations

import math

import pytest

from tsa_ctrl.control.law import Law, LawSettings

PERIOD = 1e-3
RATIO = 0.8


class Friction:
    """An inverse with constant friction of `size` N*m in the direction of sigma."""

    def __init__(self, size: float = 0.5) -> None:
        self.size = size
        self.resets = 0

    def update(
        self,
        tau_j_des: float,
        sigma: float,
        omega_j: float,
        q_j: float = math.nan,
        q_m: float = math.nan,
        temperature: float = math.nan,
        theta: float = math.nan,
        t: float = math.nan,
    ) -> float:
        return tau_j_des * RATIO + self.size * sigma

    def domain_limit(self) -> float:
        return 5.0

    def reset(self) -> None:
        self.resets += 1

    def set(self, friction_angle: float | None = None, pretension: float | None = None) -> None:
        self.size = (friction_angle or 0.0) * (pretension or 0.0)


def step(law: Law, tau_j_des: float, sigma: float, back_off: float = 1.0) -> float:
    return law.update(tau_j_des, sigma, 0.0, 0.0, 0.0, 0.0, back_off)


def test_adds_the_compensated_share() -> None:
    """Settled: tau_J* r_M/r_J plus the factor times the friction term."""
    law = Law(Friction(0.5), RATIO, LawSettings(compensation=0.9, fade_in=0.0, slew=1e4), PERIOD)
    assert step(law, 1.0, 1.0) == pytest.approx(0.8 + 0.45)
    assert (law.ideal, law.friction_term) == pytest.approx((0.8, 0.45))


def test_fades_in_after_the_enable() -> None:
    """The friction term grows linearly to its share within the fade-in, and starts anew after a reset."""
    law = Law(Friction(0.5), RATIO, LawSettings(compensation=1.0, fade_in=0.1, slew=1e4), PERIOD)
    terms = [step(law, 0.0, 1.0) for _ in range(100)]
    assert terms[49] == pytest.approx(0.25)
    assert terms[99] == step(law, 0.0, 1.0) == pytest.approx(0.5)
    law.reset()
    assert step(law, 0.0, 1.0) == pytest.approx(0.005)


def test_reversal_is_slew_limited() -> None:
    """At a reversal the friction term moves by at most slew times period."""
    law = Law(Friction(0.5), RATIO, LawSettings(compensation=1.0, fade_in=0.0, slew=50.0), PERIOD)
    for _ in range(100):
        step(law, 0.0, 1.0)
    before = law.friction_term
    for cycle in range(20):
        step(law, 0.0, -1.0)
        assert before - law.friction_term == pytest.approx(0.05)
        before = law.friction_term
        assert cycle < 20
    assert law.friction_term == pytest.approx(-0.5)


def test_ideal_part_is_not_slewed() -> None:
    """The slew limit is for the friction term: a set-point passes at once."""
    law = Law(Friction(0.0), RATIO, LawSettings(fade_in=0.0, slew=1.0), PERIOD)
    assert step(law, 2.0, 0.0) == pytest.approx(1.6)


def test_back_off_scales_the_term() -> None:
    """The oscillation monitor's back-off multiplies the compensation factor."""
    law = Law(Friction(0.5), RATIO, LawSettings(compensation=1.0, fade_in=0.0, slew=1e4), PERIOD)
    assert step(law, 0.0, 1.0, back_off=0.5) == pytest.approx(0.25)


def test_continues_from_what_was_applied() -> None:
    """A term that the limiter cut slews on from what was left, without a jump when the limit goes."""
    law = Law(Friction(0.5), RATIO, LawSettings(compensation=1.0, fade_in=0.0, slew=50.0), PERIOD)
    for _ in range(20):
        step(law, 0.0, 1.0)
    law.applied(0.2)
    assert step(law, 0.0, 1.0) == pytest.approx(0.25)


@pytest.mark.parametrize(("applied", "left"), [(0.5, 0.5), (0.7, 0.5), (-0.1, 0.0), (0.0, 0.0)])
def test_applied_torque_only_shrinks_the_term(applied: float, left: float) -> None:
    """More than asked, or a torque of the other sign, never turns the term round or makes it larger."""
    law = Law(Friction(0.5), RATIO, LawSettings(compensation=1.0, fade_in=0.0, slew=1e4), PERIOD)
    step(law, 0.0, 1.0)
    law.applied(applied)
    assert law.friction_term == pytest.approx(left)


def test_reset_resets_the_inverse() -> None:
    """Disabled means reset, down to the model's memory."""
    friction = Friction()
    Law(friction, RATIO, LawSettings(), PERIOD).reset()
    assert friction.resets == 1


def test_stays_where_both_tendons_pull() -> None:
    """Whatever is asked, the output stays within the inverse's domain."""
    law = Law(Friction(0.5), RATIO, LawSettings(fade_in=0.0, slew=1e4), PERIOD)
    assert step(law, 100.0, 1.0) == 5.0
    assert step(law, -100.0, 1.0) == -5.0
