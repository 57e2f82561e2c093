"""Torque and tensions through the pair of tendon-sheaths, sliding: (3.37), (3.40), (3.45)-(3.46), (3.53)-(3.55).

    T1 = T_p - tau_M/(2 r_M),     T3 = T_p + tau_M/(2 r_M),
    T2 = T1 exp(+x_a),            T4 = T3 exp(-x_b),            tau_J = r_J (T4 - T2)

Angles here are signed, x = sigma mu Theta; x_a = x_b gives (3.55). Tensions in N, torques in N*m, radii in m, x in 1.
Assumes Coulomb friction while sliding, and that both tendons pull. The printed minus signs of the source are lost; the
forms here are derived anew from dT/T = sigma mu dTheta.
"""

from __future__ import annotations

from typing import Generic, NamedTuple

from tsa_ctrl.model.functions import F, Functions


def motor_tensions(tau_m: F, pretension: F, r_m: float) -> tuple[F, F]:
    """(T1, T3) from (3.40) and (3.45); a negative one means that a tendon would have to push."""
    half = tau_m / (2.0 * r_m)
    return pretension - half, pretension + half


def torque_between(t2: F, t4: F, r_j: float) -> F:
    """tau_J from the joint-side tensions (3.46)."""
    return r_j * (t4 - t2)


class FullModel(NamedTuple, Generic[F]):
    """(3.53)-(3.54) as lines in tau_M: tau_J = gain tau_M - loss, T_p = level + coupling tau_M."""

    gain: F  # 1
    loss: F  # N*m
    level: F  # N
    coupling: F  # 1/m


def full_model(
    functions: Functions[F], x: F, alpha: F, beta: F, strain_force: F, r_m: float, r_j: float
) -> FullModel[F]:
    """The full model, derived signs.

    x: signed friction angle. alpha, beta: elongation integrals (3.36), (3.39), and strain_force EA Delta l, all three
    divided by l_us or none of them. A series element adds EA/k_s to alpha, beta and to the length in EA Delta l.
    """
    decay, growth = functions.exp(-x), functions.exp(x)
    total = alpha + beta
    return FullModel(
        gain=r_j / r_m * (alpha * decay + beta * growth) / total,
        loss=r_j * 2.0 * (growth - decay) * strain_force / total,
        level=2.0 * strain_force / total,
        coupling=(alpha - beta) / (2.0 * r_m * total),
    )
