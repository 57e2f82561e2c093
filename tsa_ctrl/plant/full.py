"""Compute the tendon tensions by the elongation equilibrium of the full model, (3.31)-(3.54), for any curvature.

    EA (T_p0 (l + lambda) / EA -+ e) = T (l A(+-z x) + lambda),     e = r_M q_M - r_J q_J,     lambda = EA / k_s
    T2 = T1 exp(+z x_a),     T4 = T3 exp(-z x_b),     A(rho) = mean over the length of exp(rho Theta(s) / Theta)

A series spring at the joint is stretched by T2 and T4, so its term is lambda exp(+-z x). While the tendons slide, z is
the sign of motion. At standstill, z is between -1 and 1 and follows the tendon displacement at the centre of bending,
because with any other place a small closed cycle could create energy. z is the mean of elements that slip at D (i/N)^2,
like the slip front that runs into a uniformly bent sheath. D is the elongation of half a tendon by friction. The effect
`presliding_hysteresis` replaces this rule.
Both tensions are >= 0, because a tendon cannot push.
"""

from __future__ import annotations

import math
from typing import Any

from tsa_ctrl.plant.compiled import compiled
from tsa_ctrl.plant.effects import Presliding, arm, wound
from tsa_ctrl.plant.state import NATURAL_ELEMENTS

_ELASTIC, _MOTOR = int(Presliding.ELASTIC), int(Presliding.MOTOR)


@compiled
def mean_exponential(rho: float, curve: Any) -> tuple[float, float]:
    """Return A(rho) and its derivative for a profile of (fraction of length, fraction of bending) points."""
    value = slope = 0.0
    for i in range(curve.shape[1] - 1):
        width = curve[0, i + 1] - curve[0, i]
        if width <= 0.0:
            continue
        a, d = curve[1, i], curve[1, i + 1] - curve[1, i]
        g = rho * d
        if abs(g) < 1e-3:
            phi = 1.0 + g * (0.5 + g * (1.0 / 6.0 + g / 24.0))
            dphi = 0.5 + g * (1.0 / 3.0 + g * (0.125 + g / 30.0))
        else:
            phi = (math.exp(g) - 1.0) / g
            dphi = (math.exp(g) * (g - 1.0) + 1.0) / (g * g)
        e = width * math.exp(rho * a)
        value += e * phi
        slope += e * (a * phi + d * dphi)
    return value, slope


@compiled
def _distance(p: Any, i: int) -> float:
    """Return the displacement at which element i slips: m of tendon, or rad for the effect."""
    if p.hysteresis == _ELASTIC:
        return float(p.presliding * ((i + 1) / NATURAL_ELEMENTS) ** 2)
    return float(p.hysteresis_distance * (i + 1) / p.hysteresis_elements)


@compiled
def _direction(s: Any, p: Any, slip: Any, u: float, v: float) -> tuple[float, float, float]:
    """Return z at the end of the sub-step and its derivatives by the displacements u, v of motor and joint pulley."""
    du, dv = u - p.r_m * s.q_m, v - wound(p, s.q_j)
    if p.hysteresis == _ELASTIC:
        by_u, by_v = 1.0 - p.centre, p.centre
    elif p.hysteresis == _MOTOR:
        by_u, by_v = 1.0 / p.r_m, 0.0
    else:
        by_u, by_v = 0.0, 1.0 / arm(p, s.q_j)[0]
    moved = by_u * du + by_v * dv
    n = NATURAL_ELEMENTS if p.hysteresis == _ELASTIC else p.hysteresis_elements
    z = slope = 0.0
    if n <= 1:  # Dahl
        sign = math.copysign(1.0, moved)
        decay = math.exp(-abs(moved) / p.hysteresis_distance)
        z = sign + (s.z - sign) * decay
        slope = (1.0 - sign * s.z) * decay / p.hysteresis_distance
    else:
        for i in range(n):
            distance = _distance(p, i)
            part = slip[i] + moved / distance
            if abs(part) < 1.0:
                slope += 1.0 / (distance * n)
            z += min(1.0, max(-1.0, part)) / n
    return z, slope * by_u, slope * by_v


@compiled
def full_tensions(s: Any, p: Any, slip: Any, curve: Any, x_a: float, x_b: float, u: float, v: float, f: Any) -> bool:
    """Write T1..T4 to f[0:4], the derivatives of each by u and v to f[4:12], and z to f[12]. Always returns True."""
    z, z_u, z_v = _direction(s, p, slip, u, v)
    f[12] = z
    stretch = p.stiffness * (u - v)
    for tendon in range(2):
        side = -1.0 if tendon == 0 else 1.0  # a shortens when b lengthens
        x = x_a if tendon == 0 else x_b
        rho = -side * x
        pretension = s.pretension_a if tendon == 0 else s.pretension_b
        force = pretension * (p.length + p.series_length) + side * stretch
        place = 2 * tendon
        torn = p.torn_a if tendon == 0 else p.torn_b
        if force <= 0.0 or torn:
            for i in range(2):
                f[place + i] = f[4 + 2 * (place + i)] = f[5 + 2 * (place + i)] = 0.0
            continue
        mean, slope = mean_exponential(rho * z, curve)
        ratio = math.exp(rho * z)
        if p.series_at_joint:
            mean, slope = mean + p.series_length / p.length * ratio, slope + p.series_length / p.length * ratio
            length = p.length * mean
        else:
            length = p.length * mean + p.series_length
        tension = force / length
        by_z = -tension * p.length * slope * rho / length
        by_e = side * p.stiffness / length
        f[place] = tension
        f[place + 1] = tension * ratio
        f[4 + 2 * place] = by_e + by_z * z_u
        f[5 + 2 * place] = -by_e + by_z * z_v
        f[6 + 2 * place] = ratio * (f[4 + 2 * place] + tension * rho * z_u)
        f[7 + 2 * place] = ratio * (f[5 + 2 * place] + tension * rho * z_v)
    return True


@compiled
def commit_full(s: Any, p: Any, slip: Any, q_m: float, q_j: float, z: float) -> None:
    """Store the friction state of the solution as the initial state of the next sub-step."""
    s.z = z
    if p.hysteresis == _ELASTIC:
        turned = wound(p, q_j) - wound(p, s.q_j)
        n, moved = NATURAL_ELEMENTS, (1.0 - p.centre) * p.r_m * (q_m - s.q_m) + p.centre * turned
    else:
        n, moved = p.hysteresis_elements, q_m - s.q_m if p.hysteresis == _MOTOR else q_j - s.q_j
    for i in range(n):
        slip[i] = min(1.0, max(-1.0, slip[i] + moved / _distance(p, i)))
