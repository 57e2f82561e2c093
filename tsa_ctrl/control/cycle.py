"""Run one control cycle. It receives the time, no part of it reads a clock, and it does not depend on the bus type."""

from __future__ import annotations

import math
from collections.abc import Sequence

from tsa_ctrl.bus.canopen.cia301 import NmtCommand
from tsa_ctrl.bus.canopen.cia402 import Controlword
from tsa_ctrl.bus.live.rig import Rig
from tsa_ctrl.control.axis import ControlAxis
from tsa_ctrl.safety.limiter import Reason


def run_cycle(rig: Rig, axes: Sequence[ControlAxis], now: float, deadline: float) -> None:
    """Send SYNC, collect the answers, and send one command to every axis.

    `now`: monotonic time in s; `deadline`: end of the wait for answers, s. The torque sent here acts at the next SYNC
    or on arrival, depending on the configuration of the bus.
    """
    rig.sync(now)
    rig.collect(deadline)
    for axis in axes:
        axis.io.command(*command(axis, now))


def command(axis: ControlAxis, now: float) -> tuple[Controlword, float]:
    """Return controlword and motor torque (N*m) of one axis from this cycle's measurements; `now` in s, monotonic."""
    image, terms = axis.image, axis.terms
    controlword, permitted, _ = axis.supervisor.update(image, now, axis.request)
    axis.read_motion()
    q_j, omega_j = terms.q_j, terms.omega_j
    law, set_point = axis.law, axis.set_point
    wanted = 0.0
    if permitted:
        t = axis.since_enable(now)
        if set_point.is_received:
            axis.receive_setpoint(now, t)
        terms.tau_j_des = set_point.update(t)
        law.observe(q_j, terms.q_m, image.fresh, set_point.ahead, set_point.rate)
        wanted = axis.ramp * law.update(set_point.acting, terms.q_m, terms.omega_m, t, axis.guard.share)
    else:
        law.observe(q_j, terms.q_m, image.fresh, math.nan, 0.0)
    terms.sigma = law.sigma
    fresh = image.pdo_age <= axis.most_age
    torque, reason = axis.limiter.update(wanted, permitted, fresh, image.tau_m, image.omega_m, q_j, omega_j)
    if reason is Reason.NONE and law.beyond:
        reason = Reason.DOMAIN
    terms.tau_m_cmd, terms.reason, terms.permitted = torque, reason, permitted
    return controlword, torque


def after_commands(rig: Rig, axes: Sequence[ControlAxis], now: float) -> None:
    """Complete a cycle after its commands, so that they are not delayed; the results act in the next cycle."""
    for axis in axes:
        axis.after_command(now)
        if axis.supervisor.cut_off:  # commands do not reach the drive or have no effect: 0x6007 remains
            rig.nmt(NmtCommand.STOP, axis.io.nodes.drive.node_id)
    rig.heartbeat(now)
    rig.read_back(now)
