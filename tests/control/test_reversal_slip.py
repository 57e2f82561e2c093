"""Compare the slip fronts of a joint at rest with two tendons whose tensions are stored point by point.

In the reference, the tension of a tendon loaded by the motor is max(old, T1 e^(-phi)). The tension of a released tendon
is min(old, T3 e^(+phi)). phi is the friction angle, counted from the motor. The motor's motion elongates one tendon and
releases the other by the same length. The reference uses no code of the package.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from tsa_ctrl.control.reversal import FADE, FrictionReversal, ReversalFront, ReversalSlip
from tsa_ctrl.model.curvature import NAMED, Points

R_M, R_J, X, T_P = 0.020, 0.025, 0.26, 45.0
S_BENT: Points = ((0.0, 0.0), (0.2, 0.5), (0.7, 0.5), (1.0, 1.0))
SHAPES: dict[str, Points] = {**NAMED, "S": S_BENT}


class Held:
    """Tensions of both tendons along their length. The joint is locked after sliding in direction 1.

    Elongations are in units of l/EA.
    """

    def __init__(self, points: Points, tau_j: float) -> None:
        u = (np.arange(4000) + 0.5) / 4000
        places, shares = np.array(points).T
        self.phi = X * np.interp(u, places + 1e-9 * np.arange(places.size), shares)
        difference = tau_j / R_J
        to_joint = X - self.phi

        def too_much(t4: float) -> float:
            return float(np.mean(t4 * np.exp(to_joint)) + np.mean((t4 - difference) * np.exp(-to_joint)) - 2.0 * T_P)

        t4 = brentq(too_much, 0.0, 500.0)
        self.b = t4 * np.exp(to_joint)
        self.a = (t4 - difference) * np.exp(-to_joint)
        self.ends = t4 - difference, t4

    def _end(self, tendon: str, moved: float) -> tuple[float, float]:
        """Return the tensions at motor and joint after the motor has moved back by `moved`."""
        if tendon == "a":

            def loaded(t1: float) -> np.ndarray:
                return np.maximum(self.a, t1 * np.exp(-self.phi))

            t1 = brentq(lambda t: np.mean(loaded(t) - self.a) - moved, self.a[0] * 0.5, 1000.0)
            return t1, max(self.ends[0], t1 * math.exp(-X))

        def let_go(t3: float) -> np.ndarray:
            return np.minimum(self.b, t3 * np.exp(self.phi))

        t3 = brentq(lambda t: np.mean(self.b - let_go(t)) - moved, 1e-6, self.b[0] * 2.0)
        return t3, min(self.ends[1], t3 * math.exp(X))

    def motor_torque(self, tau_j: float) -> float:
        """Return the motor torque at which the joint torque falls to `tau_j` while the motor moves back."""

        def at(moved: float) -> tuple[float, float]:
            (t1, t2), (t3, t4) = self._end("a", moved), self._end("b", moved)
            return R_M * (t3 - t1), R_J * (t4 - t2)

        most = 0.9 * min(float(np.mean(self.b)), 500.0)
        moved = brentq(lambda m: at(m)[1] - (tau_j - 1e-7), 1e-9, most)
        return at(moved)[0]

    def forward(self, tau_j: float) -> float:
        """Return tau_M before the reversal."""
        return float(R_M * (self.ends[1] * math.exp(X) - self.ends[0] * math.exp(-X)))

    def slid(self, tau_j: float) -> float:
        """Return tau_M when the whole tendon slides in the other direction."""
        difference = tau_j / R_J
        to_joint = X - self.phi

        def too_much(t4: float) -> float:
            return float(np.mean(t4 * np.exp(-to_joint)) + np.mean((t4 - difference) * np.exp(to_joint)) - 2.0 * T_P)

        t4 = brentq(too_much, 0.0, 500.0)
        return float(R_M * (t4 * math.exp(-X) - (t4 - difference) * math.exp(X)))


STIFFNESS = 40.0  # N*m/rad at the motor


class Reversed:
    """Slip fronts after a stroke to the joint torque `tau_j` and a reversal of the friction term."""

    def __init__(self, points: Points, tau_j: float, sign: float = 1.0) -> None:
        front = ReversalFront(points)
        self.slip, self.turn = ReversalSlip(front, R_M, R_J, STIFFNESS, 1e-3), FrictionReversal(front, 8e-3, 1e-3)
        self.slip.slide(sign)
        self.turn.reset(-sign)
        self.slip.turn(self.turn)
        self.slip.begin(-sign, sign * Held(points, tau_j).forward(tau_j), X, T_P)

    def torque(self, tau_j: float) -> float:
        self.slip.update(tau_j, X, T_P, self.turn)
        return self.slip.torque


@pytest.mark.parametrize("shape", ["uniform", "motor_end", "S"])
@pytest.mark.parametrize("tau_j", [-0.8, 0.2, 0.8])
@pytest.mark.parametrize("further", [1e-3, 0.05])
def test_torque_is_that_of_the_tendons(shape: str, tau_j: float, further: float) -> None:
    """The torque of the slip fronts agrees with the reference, relative to sliding tendons, within 3 mN*m."""
    held, found = Held(SHAPES[shape], tau_j), Reversed(SHAPES[shape], tau_j)
    expected = held.motor_torque(tau_j - further) - held.slid(tau_j - further)
    assert found.torque(tau_j - further) == pytest.approx(expected, abs=0.003)


@pytest.mark.parametrize("shape", ["uniform", "S"])
def test_mirrored(shape: str) -> None:
    one, other = Reversed(SHAPES[shape], 0.5), Reversed(SHAPES[shape], 0.5, -1.0)
    assert one.torque(0.47) == pytest.approx(-other.torque(-0.47))


def test_ends_when_the_other_front_is_through() -> None:
    """When the second front reaches its end, the whole tendon slides and the torque of the fronts is 0."""
    found = Reversed(SHAPES["uniform"], 0.5)
    torques = [found.torque(float(tau)) for tau in np.arange(0.5, 0.2, -1e-3)]
    assert torques[-1] == 0.0
    assert np.abs(np.diff(torques)).max() < 0.01


def test_a_joint_that_moves_ends_it_within_its_time() -> None:
    found, left = Reversed(SHAPES["uniform"], 0.5), []
    for _ in range(round(FADE / 1e-3) + 1):
        left.append(found.torque(0.499))
        found.slip.move()
    assert left[-1] == 0.0
    assert np.all(np.diff(np.abs(left)) < 0.0)


def test_a_release_by_parts_takes_away_its_share() -> None:
    found = Reversed(SHAPES["uniform"], 0.5)
    whole = found.torque(0.499)
    found.slip.release(0.25)
    assert found.torque(0.499) == pytest.approx(0.75 * whole)


def test_a_closed_inner_stroke_leaves_no_trace() -> None:
    """After a small closed stroke, the large stroke continues as if the small one had not occurred.

    This is return-point memory.
    """
    found, alone = Reversed(SHAPES["uniform"], 0.8), Reversed(SHAPES["uniform"], 0.8)
    for sign, tau_j in ((1.0, 0.79), (-1.0, 0.792)):
        t1, t3 = found.slip._ends(tau_j / R_J)
        found.slip.begin(sign, R_M * (t3 - t1), X, T_P)
    assert found.torque(0.785) == pytest.approx(alone.torque(0.785), abs=1e-3)
    assert abs(alone.torque(0.785)) > 0.05


@pytest.mark.parametrize(("x", "pretension"), [(0.0, T_P), (X, 5.0)])
def test_what_has_no_fronts_begins_nothing(x: float, pretension: float) -> None:
    """Without friction or with a slack tendon, the torque of the fronts is 0."""
    front = ReversalFront(SHAPES["uniform"])
    found, turn = ReversalSlip(front, R_M, R_J, STIFFNESS, 1e-3), FrictionReversal(front, 8e-3, 1e-3)
    found.slide(1.0)
    turn.reset(-1.0)
    found.begin(-1.0, 0.4, x, pretension)
    found.update(0.4, x, pretension, turn)
    assert found.torque == 0.0
