"""The range in which a pretension is appropriate: no tendon goes slack, and the motor has torque left for the joint.

Both tendons pull while |tau_M| < 2 T_p0 r_M, and friction at the motor is h = 2 T_p0 r_M f(x), which also grows with
the pretension. So for a torque of tau at the motor

    tau / (2 r_M)  <  T_p0  <  tau / (2 r_M f(x)),     f by where the sheath bends (`tsa_ctrl.model.steady_sliding`)
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.steady_sliding import sliding

FloatArray = NDArray[np.float64]

REACHED = 0.999  # of the samples, of the motor torque: its peak without spikes
NEAR = 1.1  # of the lesser end: below it sensors that are off by a tenth hide whether a tendon pulls


def appropriate(model: TendonSheath, torque: float) -> tuple[float, float]:
    """T_p0 in N, lowest and highest, for `torque` N*m at the motor."""
    lowest = torque / (2.0 * model.motor_pulley_radius)
    return lowest, model.pretension * torque / sliding(model).motor_half_loop


def reached(logs: Iterable[FloatArray]) -> float:
    """N*m at the motor that logs reach, of their motor torques."""
    return max(float(np.quantile(np.abs(tau_m), REACHED)) for tau_m in logs)


def remark(model: TendonSheath, torque: float) -> str:
    """A line for people where T_p0 of the model is not appropriate for `torque` N*m at the motor; empty where it is."""
    lowest, highest = appropriate(model, torque)
    begin = f"the motor torque in these logs reaches {torque:.3g} N·m, for which {lowest:.3g} to {highest:.3g} N are"
    if model.pretension < NEAR * lowest and "tendon_slack" not in model.effects:
        return (
            f"{begin} an appropriate pretension; at {model.pretension:.3g} N one tendon is slack, or nearly so, where "
            "it does: raise the pretension, or ask for less torque"
        )
    if model.pretension > highest:
        return (
            f"{begin} an appropriate pretension; at {model.pretension:.3g} N friction takes all of it: lower the "
            "pretension, or move the joint by a motor that has more"
        )
    return ""
