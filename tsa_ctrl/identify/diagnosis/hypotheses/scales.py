"""Sizes of a log's signals, by which the coordinates of a fit are scaled and its starting grids placed."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tsa_ctrl.identify.diagnosis.data.frame import Frame
from tsa_ctrl.model.effects.search import Scales
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import Model, RigidDrive, TendonSheath


def scales_of(frame: Frame, model: Model) -> Scales:
    """Speeds, torques and travels that occur in these logs: where the grids of candidates lie."""
    signals = [run.signals for run in frame.runs]
    speed = np.concatenate([np.abs(s.omega_j) for s in signals])
    fast = float(np.quantile(speed, 0.95))
    reach = max((0.5 * float(np.ptp(s.q_j)) for s in signals if s.q_j is not None), default=0.0)
    motor = max((0.5 * float(np.ptp(s.q_m)) for s in signals if s.q_m is not None), default=0.0)
    if not reach:
        reach = max(0.5 * float(np.ptp(np.cumsum(s.omega_j))) * s.period for s in signals)
    plain = isinstance(model, RigidDrive)
    derived = "omega_m" if plain else "omega_j"
    return Scales(
        torque=max(float(np.std(np.concatenate([run.target for run in frame.runs]))), 1e-9),
        motor_torque=max(float(np.std(np.concatenate([s.tau_m for s in signals]))), 1e-9),
        speed=max(fast, 1e-9),
        speed_noise=max(run.velocity_noise for run in frame.runs),
        acceleration=max(float(np.std(np.concatenate([s.acceleration for s in signals]))), 1e-9),
        reach=max(reach, 1e-9),
        middle=float(np.mean(frame.column("q_j"))) if frame.has("q_j") else 0.0,
        motor_reach=max(motor or reach, 1e-9),
        motor_step=_step([s.q_m for s in signals if s.q_m is not None]) if frame.has("q_m") else math.nan,
        seconds=max(float(s.t[-1] - s.t[0]) for s in signals),
        period=signals[0].period,
        heating=max((float(np.ptp(s.temperature)) for s in signals if s.temperature is not None), default=0.0),
        bending=0.0 if isinstance(model, RigidDrive) else _range_of_bending(frame, model),
        derived_velocity=derived if any(derived in run.raw.derived for run in frame.runs) else "",
        plain=plain,
        offset=isinstance(model, RigidDrive) and model.torque_offset is not None,
    )


def _step(angles: Sequence[Array]) -> float:
    """90 % of the steps from sample to sample are below, rad."""
    return float(np.quantile(np.abs(np.concatenate([np.diff(angle) for angle in angles])), 0.9))


def _range_of_bending(frame: Frame, model: TendonSheath) -> float:
    """Range of the column theta over the model's bending angle; 0 where no log has it."""
    angles = [run.signals.theta for run in frame.runs if run.signals.theta is not None]
    return float(np.ptp(np.concatenate(angles))) / max(model.bending_angle, 1e-9) if angles else 0.0
