"""One control cycle. It is given the time; nothing below it reads a clock, and nothing in it knows which bus it has."""

from __future__ import annotations

from collections.abc import Sequence

from tsa_ctrl.bus.rig import Rig
from tsa_ctrl.control.axis import ControlAxis
from tsa_ctrl.control.limiter import Reason

_TRIPPING = frozenset({Reason.OVER_SPEED, Reason.NOT_FINITE})


def run_cycle(rig: Rig, axes: Sequence[ControlAxis], now: float, deadline: float) -> None:
    """SYNC out, answers in, and for every axis one command out.

    `now`: monotonic time in s; `deadline`: until when answers are waited for. The torque sent here acts at the next
    SYNC, or on arrival, as the bus is configured.
    """
    rig.sync()
    rig.collect(deadline)
    for axis in axes:
        image, terms, instruments = axis.image, axis.terms, axis.instruments
        instruments.update(now)
        controlword, permitted, _ = axis.supervisor.update(image, now, axis.request)
        terms.q_j, terms.omega_j = q_j, omega_j = axis.joint()
        terms.sigma = sigma = axis.direction.update(omega_j)
        terms.theta = theta = axis.bending.update()
        wanted = 0.0
        if permitted:
            t = axis.since_enable(now)
            axis.estimator.update(sigma, omega_j, theta, image.tau_m, instruments.tau_j, image.fresh)
            axis.adapt()
            terms.tau_j_des = tau_j_des = axis.set_point.update(t)
            back_off = axis.monitor.update(omega_j, tau_j_des)
            wanted = axis.ramp * axis.law.update(tau_j_des, sigma, omega_j, q_j, image.q_m, t, back_off)
        else:
            axis.release()
        fresh = image.pdo_age <= axis.most_age
        torque, reason = axis.limiter.update(wanted, permitted, fresh, image.tau_m, image.omega_m, q_j, omega_j)
        axis.law.applied(torque)
        axis.io.command(controlword, torque)
        if permitted and reason in _TRIPPING:
            axis.supervisor.trip(f"{reason.name.lower().replace('_', '-')} at the limiter", now)
        terms.tau_m_cmd = torque
        terms.reason = reason
    rig.heartbeat(now)
