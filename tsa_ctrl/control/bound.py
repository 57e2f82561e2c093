"""How much of the friction may be compensated, by how well it is known: c h_model <= h_true, with all that may be.

Two things are not known: the half loop when the model was calibrated, and how the sheath bends now.

    bound = (lower end of the half loop's interval / its value) * min over the range of Theta of h(Theta)/h(Theta_0)

The interval is that of the calibration, `[provenance] intervals` of the model file. A file that was never calibrated
has only [uncertainty]; where something measures what the joint is given, the guard acts on it and that is said; where
nothing does, its lower end counts. The range of the bending is `[axis.bending] range`; where the bending is measured,
commanded or estimated it is not needed.
"""

from __future__ import annotations

from dataclasses import dataclass

from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.sliding import sliding

_STEPS = 16  # over the range of the bending; h has one maximum there


@dataclass(frozen=True)
class Bound:
    """`seen`: 1, most of the friction term while the delivered torque is known; `unseen`: while it is not."""

    seen: float
    unseen: float
    notes: tuple[str, ...] = ()


def bound_of(
    model: TendonSheath, *, bending_range: float, bending_known: bool, sees: bool, compensation: float
) -> Bound:
    """What follows from the model and the axis' settings.

    `bending_range`: share of the model's bending, either way, that it may differ; `bending_known`: it is followed live;
    `sees`: something can measure the delivered torque; `compensation`: what [axis.law] asks for.
    """
    calibrated = interval_share(model)
    uncertain = 1.0 / ((1.0 + model.friction_angle_uncertainty) * (1.0 + model.pretension_uncertainty))
    bent = 1.0 if bending_known else bending_share(model, bending_range)
    seen = bent * (1.0 if calibrated is None else calibrated)
    unseen = bent * (uncertain if calibrated is None else calibrated)
    notes = []
    if compensation > 1.0:
        notes.append(f"law.compensation {compensation:g} asks for more than the friction that the model has: 1 is used")
    if calibrated is not None and calibrated * bent < compensation and calibrated < 1.0:
        notes.append(
            f"the half loop's interval of the calibration begins at {100.0 * calibrated:.0f} % of its value: no more "
            "is compensated; longer logs narrow it"
        )
    if bent < 1.0:
        notes.append(
            f"the sheath may bend {100.0 * bending_range:.0f} % more or less (bending.range), and nothing measures it: "
            f"that costs {100.0 * (1.0 - bent):.0f} % of the compensation; an estimator in use, or a sensor of "
            "the bending, gives it back"
        )
    if calibrated is None and sees and compensation > 0.0:
        notes.append(
            f"the model file was never calibrated: by its [uncertainty] the friction may be {100.0 * uncertain:.0f} % "
            "of the file's value. Until a motion proves more, an energy credit limits the compensation; tsa tune "
            "measures the friction"
        )
    if not sees and compensation > 0.0:
        notes.append(
            "no sensor proves the friction of this axis (no joint torque sensor, no usable elongation). At most "
            f"{100.0 * unseen:.0f} % of it is compensated. At a constant set-point the compensation is withdrawn once "
            "the joint has moved on it. While the set-point changes, nothing bounds the motion of a joint whose "
            "friction is less"
        )
    return Bound(seen, unseen, tuple(notes))


def interval_share(model: TendonSheath) -> float | None:
    """Lower end of the calibrated half loop's interval over its value, at most 1; None without a calibration."""
    low = model.half_loop_low
    if low is None:
        return None
    value = abs(sliding(model).half_loop)
    return min(1.0, max(0.0, low / value)) if value > 0.0 else 1.0


def bending_share(model: TendonSheath, span: float) -> float:
    """Least half loop at the motor over that of the model file, with Theta within 1 -+ `span` of the file's."""
    nominal = abs(sliding(model).motor_half_loop)
    if span == 0.0 or nominal == 0.0:
        return 1.0
    least = 1.0
    for k in range(-_STEPS, _STEPS + 1):
        factor = 1.0 + span * k / _STEPS
        tension = model.pretension + model.pretension_slope * model.bending_angle * (factor - 1.0)
        h = abs(sliding(model, 1.0, factor * model.friction_angle, max(0.0, tension)).motor_half_loop)
        least = min(least, h / nominal)
    return least
