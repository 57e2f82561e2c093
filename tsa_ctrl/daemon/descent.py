"""Torque to zero when the loop itself has failed: the last torque fades, and nothing of the control law is asked.

The limiter has the last word here, too: a joint that runs away meanwhile gets no torque, not even a fading one.
"""

from __future__ import annotations

from collections.abc import Sequence

from tsa_ctrl.bus.live.rig import Rig
from tsa_ctrl.control.axis import ControlAxis
from tsa_ctrl.safety.supervisor import Request


def descend(rig: Rig, axes: Sequence[ControlAxis], period: float, stop_time: float) -> None:
    """Ramp what was last sent to 0 within `stop_time` s, as far as each supervisor and limiter still permit torque."""
    steps = max(1, round(stop_time / period))
    last = [axis.terms.tau_m_cmd for axis in axes]
    start = rig.wait(0.0)
    for step in range(1, steps + 1):
        begin = rig.wait(start + step * period)
        rig.sync(begin)
        now = rig.collect(begin + 0.6 * period)
        share = 1.0 - step / steps
        for axis, torque in zip(axes, last, strict=True):
            controlword, permitted, _ = axis.supervisor.update(
                axis.image, now, Request.ENABLE if torque else Request.DISABLE
            )
            image, terms = axis.image, axis.terms
            sent, terms.reason = axis.limiter.update(
                torque * share, permitted, image.pdo_age <= axis.most_age, image.tau_m, image.omega_m, *axis.joint()
            )
            axis.io.command(controlword, sent)
            terms.tau_m_cmd = sent
        rig.heartbeat(now)
