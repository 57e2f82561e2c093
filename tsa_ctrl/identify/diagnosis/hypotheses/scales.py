"""Sizes of a log's signals, by which the coordinates of a fit are scaled and its starting grids placed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tsa_ctrl.identify.diagnosis.data.frame import Frame
from tsa_ctrl.model.parameters import Model, RigidDrive


@dataclass(frozen=True)
class Scales:
    """Sizes of this log's signals, to scale coordinates and to place grids."""

    torque: float  # RMS of the predicted torque's change, N*m
    motor_torque: float  # N*m
    speed: float  # 95 % of the moving speeds are below, rad/s
    speed_noise: float  # rad/s
    acceleration: float  # rad/s^2
    reach: float  # half range of q_j, rad
    motor_reach: float  # half range of the displacement that presliding follows, rad
    seconds: float  # longest run, s
    period: float  # compute period, s
    heating: float  # range of the temperature, K
    plain: bool  # a drive without tendons: joint and motor are one
    offset: bool  # the base model has a constant torque, which is fitted


def scales_of(frame: Frame, model: Model) -> Scales:
    """Speeds, torques and travels that occur in these logs: where the grids of candidates lie."""
    signals = [run.signals for run in frame.runs]
    speed = np.concatenate([np.abs(s.omega_j) for s in signals])
    fast = float(np.quantile(speed, 0.95))
    reach = max((0.5 * float(np.ptp(s.q_j)) for s in signals if s.q_j is not None), default=0.0)
    motor = max((0.5 * float(np.ptp(s.q_m)) for s in signals if s.q_m is not None), default=0.0)
    if not reach:
        reach = max(0.5 * float(np.ptp(np.cumsum(s.omega_j))) * s.period for s in signals)
    return Scales(
        torque=max(float(np.std(np.concatenate([run.target for run in frame.runs]))), 1e-9),
        motor_torque=max(float(np.std(np.concatenate([s.tau_m for s in signals]))), 1e-9),
        speed=max(fast, 1e-9),
        speed_noise=max(run.velocity_noise for run in frame.runs),
        acceleration=max(float(np.std(np.concatenate([s.acceleration for s in signals]))), 1e-9),
        reach=max(reach, 1e-9),
        motor_reach=max(motor or reach, 1e-9),
        seconds=max(float(s.t[-1] - s.t[0]) for s in signals),
        period=signals[0].period,
        heating=max((float(np.ptp(s.temperature)) for s in signals if s.temperature is not None), default=0.0),
        plain=isinstance(model, RigidDrive),
        offset=isinstance(model, RigidDrive) and model.torque_offset is not None,
    )
