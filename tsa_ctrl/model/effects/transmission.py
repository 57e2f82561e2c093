"""Define the transmission: the simplified model by four tensions with the effects that change it, and the full model.

B is the torque (N*m) at the joint before friction in the joint. x = mu Theta >= 0 is the friction angle, the mean of
both tendons; x_a = x (1 + i), x_b = x (1 - i) with the imbalance i (1) of tendons with different routings. sigma in
[-1, 1] is the direction or the friction state. Source: (3.37), (3.40), (3.45)-(3.46),
(3.53)-(3.55) and the catalogue of effects. Sliding, with the signed angles sigma x_a and sigma x_b:

    T1 = T_p - tau_M/(2 r_M),     T3 = T_p + tau_M/(2 r_M),
    T2 = T1 exp(+sigma x_a),      T4 = T3 exp(-sigma x_b),      tau_J = r_J (T4 - T2)

For x_a = x_b, this is (3.55). Tensions in N, torques in N*m, radii in m, angles in 1. Assumptions: Coulomb friction
while sliding, and both tendons pull. The printed source has lost its minus signs, so the forms here are derived from
dT/T = sigma mu dTheta.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, ClassVar, Generic, NamedTuple

from tsa_ctrl.model import curvature
from tsa_ctrl.model.curvature import NAMED, Profile
from tsa_ctrl.model.effects.friction import TensionDependentFriction
from tsa_ctrl.model.effects.search import Scales, Variant, linear, one
from tsa_ctrl.model.effects.specification import Draw, Kind, Motion, Parameter, Specification, Stage, Twins
from tsa_ctrl.model.functions import SCALARS, F, Functions


def motor_tensions(tau_m: F, pretension: F, r_m: float) -> tuple[F, F]:
    """Return (T1, T3), N, from (3.40) and (3.45); a negative tension means that a tendon would have to push."""
    half = tau_m / (2.0 * r_m)
    return pretension - half, pretension + half


def torque_between(t2: F, t4: F, r_j: float) -> F:
    """Return tau_J, N*m, from the joint-side tensions (3.46)."""
    return r_j * (t4 - t2)


class FullModel(NamedTuple, Generic[F]):
    """Hold (3.53)-(3.54) as lines in tau_M: tau_J = gain tau_M - loss, T_p = level + coupling tau_M."""

    gain: F  # 1
    loss: F  # N*m
    level: F  # N
    coupling: F  # 1/m


def full_model(
    functions: Functions[F], angles: tuple[F, F], alpha: F, beta: F, strain_force: F, r_m: float, r_j: float
) -> FullModel[F]:
    """Return the full model with the derived signs.

    alpha, beta and strain_force are all divided by l_us, or none of them is. A series spring adds EA/k_s to alpha, beta
    and to the length in EA Delta l.

    Args:
        angles: signed friction angles x_a and x_b.
        alpha, beta: elongation integrals of tendons a and b, (3.36), (3.39).
        strain_force: EA Delta l, the mean of both tendons.
        r_m, r_j: m.
    """
    decay, growth = functions.exp(-angles[1]), functions.exp(angles[0])
    total = alpha + beta
    return FullModel(
        gain=r_j / r_m * (alpha * decay + beta * growth) / total,
        loss=r_j * 2.0 * (growth - decay) * strain_force / total,
        level=2.0 * strain_force / total,
        coupling=(alpha - beta) / (2.0 * r_m * total),
    )


@dataclass(frozen=True)
class SheathAsymmetry:
    """x_a = x (1 + k/2), x_b = x (1 - k/2): equals exp(sigma k x/2) times (3.55)."""

    relative_difference: Annotated[float, Parameter("1", low=-2.0, high=2.0, low_open=True, high_open=True)]  # k

    specification: ClassVar = Specification(
        name="sheath_asymmetry",
        stage=Stage.TRANSMISSION,
        summary="the two sheaths have different friction angles",
        search=linear("relative_difference", one, -1.98, 1.98),
        twins=(Twins(("tension_dependent_friction",), (Motion.SIGNS,)),),
        kinds=(Kind.TENDON_SHEATH,),
        equation="x_a, x_b ← x (1 ± k/2)",
        demo={"relative_difference": Draw(0.8, 1.2, signed=True)},
    )

    def angles(self, x_a: F, x_b: F) -> tuple[F, F]:
        half = self.relative_difference / 2.0
        return x_a * (1.0 + half), x_b * (1.0 - half)


@dataclass(frozen=True)
class TendonSlack:
    """Tensions are >= 0: beyond abs(tau_M) = 2 T_p r_M the other tendon carries tau_M/r_M alone."""

    specification: ClassVar = Specification(
        name="tendon_slack",
        stage=Stage.TRANSMISSION,
        summary="a tendon cannot push",
        search=lambda name, s: [Variant(name, (), ((),), (), lambda u: {})],
        twins=(Twins(("sheath_asymmetry", "tension_dependent_friction"), (Motion.SIGNS,)),),
        kinds=(Kind.TENDON_SHEATH,),
        equation="T_1, T_3 ≥ 0",
    )

    def clip(self, functions: Functions[F], t1: F, t3: F) -> tuple[F, F]:
        return (
            functions.at_least(t1, 0.0) + functions.at_least(-t3, 0.0),
            functions.at_least(t3, 0.0) + functions.at_least(-t1, 0.0),
        )


def _profiles(name: str, s: Scales) -> list[Variant]:
    def of(profile: str) -> Variant:
        return Variant(name, (), ((),), (), lambda u: {"curvature_profile": profile}, profile)

    return [of("uniform"), of("motor_end")]  # all bending at the joint is (3.55)


@dataclass(frozen=True)
class ElongationCoupling:
    """Replace (3.55) by the full model (3.53), for any curvature profile of the sheath."""

    curvature_profile: Annotated[str | curvature.Points, Parameter(choices=tuple(NAMED), points=True, fitted=False)]

    specification: ClassVar = Specification(
        name="elongation_coupling",
        stage=Stage.TRANSMISSION,
        summary="the full model (3.53): friction along the sheath couples into the pretension",
        search=_profiles,
        twins=(Twins(("torque_constant_error", "tension_dependent_friction"), (Motion.BENDING, Motion.GAIN)),),
        excludes=("tendon_slack", "sheath_asymmetry", "tension_dependent_friction"),
        kinds=(Kind.TENDON_SHEATH,),
        equation="(3.53) in place of (3.55)",
    )


@dataclass(frozen=True)
class FourTensions:
    """Compute (3.55) by the four tensions, with asymmetric sheaths, slack and tension-dependent friction if present."""

    radii: tuple[float, float]  # r_M, r_J, m
    asymmetry: SheathAsymmetry | None = None
    slack: TendonSlack | None = None
    tension_dependence: TensionDependentFriction | None = None

    @property
    def symmetric(self) -> bool:
        """Return True if both tendons' tensions grow by the same exp(sigma x)."""
        return self.asymmetry is None and self.tension_dependence is None

    @property
    def linear(self) -> bool:
        """Return True if B is the line of `tangent` in tau_M, and `limits` bounds it."""
        return self.slack is None and self.tension_dependence is None

    def angles(self, x: F, imbalance: F | float = 0.0) -> tuple[F, F]:
        """Return the dimensionless x_a and x_b, including the asymmetry of the sheaths."""
        x_a, x_b = x * (1.0 + imbalance), x * (1.0 - imbalance)
        return (x_a, x_b) if self.asymmetry is None else self.asymmetry.angles(x_a, x_b)

    def torque(self, functions: Functions[F], tau_m: F, sigma: F, x: F, pretension: F, imbalance: F | float = 0.0) -> F:
        """Return B, N*m."""
        if self.symmetric and isinstance(imbalance, float) and imbalance == 0.0:
            return self.grown(functions, tau_m, functions.exp(sigma * x), pretension)  # fast: a single exponential
        t1, t3 = self._tensions(functions, tau_m, pretension)
        x_a, x_b = self.angles(x, imbalance)
        if self.tension_dependence is not None:
            x_a = x_a * self.tension_dependence.factor(functions, t1)
            x_b = x_b * self.tension_dependence.factor(functions, t3)
        return torque_between(t1 * functions.exp(sigma * x_a), t3 * functions.exp(-sigma * x_b), self.radii[1])

    def grown(self, functions: Functions[F], tau_m: F, growth: F, pretension: F) -> F:
        """Return B, N*m, of a `symmetric` pair at growth = exp(sigma x)."""
        t1, t3 = self._tensions(functions, tau_m, pretension)
        return torque_between(t1 * growth, t3 / growth, self.radii[1])

    def _tensions(self, functions: Functions[F], tau_m: F, pretension: F) -> tuple[F, F]:
        t1, t3 = motor_tensions(tau_m, pretension, self.radii[0])
        return (t1, t3) if self.slack is None else self.slack.clip(functions, t1, t3)

    def motor_torque(self, torque: float, sigma: float, x: float, pretension: float, imbalance: float = 0.0) -> float:
        """Return tau_M, N*m, that delivers B = `torque`.

        The solution has a closed form. With tension-dependent friction, it takes at most `ITERATIONS` steps.
        """
        x_a, x_b = self.angles(x, imbalance)
        tau_m = self._invert(torque, sigma * x_a, sigma * x_b, pretension)
        if self.tension_dependence is not None:
            return self._iterate(torque, tau_m, sigma, (x_a, x_b), pretension)
        return tau_m

    def limits(self, sigma: float, x: float, pretension: float, imbalance: float = 0.0) -> tuple[float, float]:
        """Return the range of tau_M, N*m, in which both tendons pull; it is unlimited if the model includes slack."""
        if self.slack is not None:
            return -math.inf, math.inf
        bound = 2.0 * pretension * self.radii[0]
        return -bound, bound

    def tangent(self, sigma: float, x: float, pretension: float, imbalance: float = 0.0) -> tuple[float, float]:
        """Return (slope, loss) of B = slope tau_M - loss at tau_M = 0; exact while both tendons pull."""
        r_m, r_j = self.radii
        angles = self.angles(x, imbalance)
        if self.tension_dependence is not None:
            value, slope = self._value_and_slope(0.0, sigma, angles, pretension)
            return slope, -value
        growth, decay = SCALARS.exp(sigma * angles[0]), SCALARS.exp(-sigma * angles[1])
        return 0.5 * r_j / r_m * (growth + decay), r_j * pretension * (growth - decay)

    def _invert(self, torque: float, x_a: float, x_b: float, pretension: float) -> float:
        r_m, r_j = self.radii
        growth, decay = SCALARS.exp(x_a), SCALARS.exp(-x_b)
        tau_m = 2.0 * r_m * (torque / r_j + pretension * (growth - decay)) / (growth + decay)
        if self.slack is not None and abs(tau_m) > 2.0 * pretension * r_m:
            return torque * r_m / r_j / (decay if tau_m > 0.0 else growth)
        return tau_m

    def _iterate(self, torque: float, tau_m: float, sigma: float, x: tuple[float, float], pretension: float) -> float:
        """Solve B(tau_M) = torque by Newton's method within the present bracket, and return the best tau_M found."""
        accepted = TOLERANCE * (abs(torque) + pretension * self.radii[0])
        low, high, best, least = -math.inf, math.inf, tau_m, math.inf
        for _ in range(ITERATIONS):
            value, slope = self._value_and_slope(tau_m, sigma, x, pretension)
            error = value - torque
            if abs(error) < least:
                least, best = abs(error), tau_m
            if not abs(error) > accepted:
                break
            low, high = (low, tau_m) if error > 0.0 else (tau_m, high)
            step = tau_m - error / slope if slope > 0.0 else math.nan
            if not low < step < high:
                if math.isinf(low) or math.isinf(high):
                    break
                step = 0.5 * (low + high)
            tau_m = step
        return best

    def _value_and_slope(
        self, tau_m: float, sigma: float, x: tuple[float, float], pretension: float
    ) -> tuple[float, float]:
        """Return B (N*m) and dB/dtau_M (1) with tension-dependent friction."""
        dependence = self.tension_dependence
        assert dependence is not None
        r_m, r_j = self.radii
        t1, t3 = motor_tensions(tau_m, pretension, r_m)
        d1, d3 = -0.5 / r_m, 0.5 / r_m
        if self.slack is not None:
            d1, d3 = (0.0, 1.0 / r_m) if t1 < 0.0 else (-1.0 / r_m, 0.0) if t3 < 0.0 else (d1, d3)
            t1, t3 = self.slack.clip(SCALARS, t1, t3)
        f1, f3 = dependence.factor(SCALARS, t1), dependence.factor(SCALARS, t3)
        g1, g3 = SCALARS.exp(sigma * x[0] * f1), SCALARS.exp(-sigma * x[1] * f3)
        slope1 = d1 * g1 * (1.0 + t1 * sigma * x[0] * dependence.slope(t1, f1))
        slope3 = d3 * g3 * (1.0 - t3 * sigma * x[1] * dependence.slope(t3, f3))
        return r_j * (t3 * g3 - t1 * g1), r_j * (slope3 - slope1)


@dataclass(frozen=True)
class Elongating:
    """Compute the full model (3.53), which excludes slack, asymmetry and tension dependence."""

    radii: tuple[float, float]  # r_M, r_J, m
    profile: Profile
    series: float = 0.0  # EA/(k_s l_us), 1; 0 without a series element
    at_joint: bool = False  # True for a series element at the joint, which carries T2 and T4
    _last: list[tuple[tuple[float, float, float], FullModel[float]]] = field(
        default_factory=list, compare=False, repr=False
    )

    @property
    def linear(self) -> bool:
        """Return True: B is always the line of `tangent` in tau_M."""
        return True

    def line(self, functions: Functions[F], x: F, pretension: F, imbalance: F | float = 0.0) -> FullModel[F]:
        """Return (3.53)-(3.54) at the signed angle x, with all lengths divided by l_us."""
        angles = x * (1.0 + imbalance), x * (1.0 - imbalance)
        alpha, beta = self.lengths(functions, *angles)
        return full_model(functions, angles, alpha, beta, pretension * (1.0 + self.series), *self.radii)

    def lengths(self, functions: Functions[F], x_a: F, x_b: F) -> tuple[F, F]:
        """Return alpha and beta over l_us at the signed angles x_a and x_b, including the series element."""
        alpha, beta = self.profile.mean_exponential(functions, x_a), self.profile.mean_exponential(functions, -x_b)
        if self.at_joint:
            return alpha + self.series * functions.exp(x_a), beta + self.series * functions.exp(-x_b)
        return alpha + self.series, beta + self.series

    def _now(self, x: float, pretension: float, imbalance: float) -> FullModel[float]:
        """Return `line` for floats; the last result is cached, because the inverse requests it three times a cycle."""
        last, asked = self._last, (x, pretension, imbalance)
        if not last or last[0][0] != asked:
            last[:] = [(asked, self.line(SCALARS, x, pretension, imbalance))]
        return last[0][1]

    def torque(self, functions: Functions[F], tau_m: F, sigma: F, x: F, pretension: F, imbalance: F | float = 0.0) -> F:
        """Return B, N*m."""
        line = self.line(functions, sigma * x, pretension, imbalance)
        return line.gain * tau_m - line.loss

    def motor_torque(self, torque: float, sigma: float, x: float, pretension: float, imbalance: float = 0.0) -> float:
        """Return tau_M, N*m, that delivers B = `torque`."""
        line = self._now(sigma * x, pretension, imbalance)
        return (torque + line.loss) / line.gain

    def limits(self, sigma: float, x: float, pretension: float, imbalance: float = 0.0) -> tuple[float, float]:
        """Return the range of tau_M, N*m, in which both tendons pull at the pretension of (3.54)."""
        line = self._now(sigma * x, pretension, imbalance)
        level, coupling = 2.0 * self.radii[0] * line.level, 2.0 * self.radii[0] * line.coupling
        return -level / (1.0 + coupling), level / (1.0 - coupling)

    def tangent(self, sigma: float, x: float, pretension: float, imbalance: float = 0.0) -> tuple[float, float]:
        """Return (slope, loss) of B = slope tau_M - loss, for `tsa_ctrl.model.steady_sliding`; exact."""
        line = self._now(sigma * x, pretension, imbalance)
        return line.gain, line.loss


Transmission = FourTensions | Elongating

ITERATIONS = 30  # most steps; 3 to 5 are usual, and only a kink requires more
TOLERANCE = 1e-13  # of the torque scale; smaller errors are rounding errors
