"""Compute the range of pretension in which no tendon goes slack and the motor torque exceeds the friction.

Both tendons pull while |tau_M| < 2 T_p0 r_M. The friction torque at the motor is h = 2 T_p0 r_M f(x), which also
increases with the pretension. For a torque of tau at the motor the range is therefore

    tau / (2 r_M)  <  T_p0  <  tau / (2 r_M f(x))

The function f depends on where the sheath bends (`tsa_ctrl.model.steady_sliding`).
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.steady_sliding import sliding

FloatArray = NDArray[np.float64]

REACHED = 0.999  # quantile of the motor torque that counts as its peak, so that spikes do not count
NEAR = 1.1  # times the lower end: below it, sensor errors of 10 % may hide a slack tendon


def appropriate(model: TendonSheath, torque: float) -> tuple[float, float]:
    """Return the lowest and the highest appropriate T_p0 in N for `torque`, N*m at the motor."""
    lowest = torque / (2.0 * model.motor_pulley_radius)
    return lowest, model.pretension * torque / sliding(model).motor_half_loop


def reached(logs: Iterable[FloatArray]) -> float:
    """Return the largest torque (N*m at the motor) in the logs; `logs`: their motor torques, (n,) each."""
    return max(float(np.quantile(np.abs(tau_m), REACHED)) for tau_m in logs)


def remark(model: TendonSheath, torque: float) -> str:
    """Return a remark if the model's T_p0 is not appropriate for `torque`, N*m at the motor; empty if it is."""
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
