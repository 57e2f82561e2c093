"""Path length and bending, (3.49)-(3.52), and what they do to the pretension, (3.56).

    l(t) = l(Theta = 0) + (p + d/2) Theta(t),     Delta l = (p + d/2) (Theta - Theta_us),     T_p = k_t Delta l

p: contact offset, d: tendon diameter, both in m; Theta, Theta_us: bending angle and that at which the tendon is just
unstrained, rad; k_t = 1/(l_us/EA + 1/k_s), N/m. Assumes a spiral sheath whose neutral axis is its inner arc.
Source: section 3.2, "A Series Elastic Tendon-sheath Actuation Mechanism".
"""

from __future__ import annotations

from tsa_ctrl.model.functions import F, Functions
from tsa_ctrl.model.parameters import TendonSheath


def lever(model: TendonSheath) -> float:
    """p + d/2, m: path length per bending angle (3.50)."""
    return model.contact_offset + model.diameter / 2.0


def path_length(model: TendonSheath, theta: F, straight_length: float) -> F:
    """l, m, of a tendon whose path in the straight sheath is `straight_length` m (3.50)."""
    return straight_length + lever(model) * theta


def length_change(model: TendonSheath, theta: F, unstrained: float) -> F:
    """Delta l, m, at bending angle `theta` when the tendon is just unstrained at `unstrained`, both rad (3.51)."""
    return lever(model) * (theta - unstrained)


def pretension(model: TendonSheath, change: F) -> F:
    """T_p, N, at the path-length change `change` in m (3.56); negative means slack and is left to the caller."""
    return model.tendon_stiffness * change


def pretension_slope(model: TendonSheath) -> float:
    """dT_p0/dTheta = k_t (p + d/2), N/rad."""
    return model.tendon_stiffness * lever(model)


def pretension_at(functions: Functions[F], model: TendonSheath, theta: F) -> F:
    """T_p0(Theta), N, from the file's value at `bending_angle`; slack is 0."""
    return functions.at_least(model.pretension + pretension_slope(model) * (theta - model.bending_angle), 0.0)


def unstrained_bending_angle(model: TendonSheath) -> float:
    """Theta_us, rad, at which the pretension of this model vanishes (3.51), (3.56)."""
    return model.bending_angle - model.pretension / pretension_slope(model)
