"""Determine which effects of the catalogue these logs can test, and why they cannot test the others."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tsa_ctrl.identify.diagnosis.data.frame import Frame
from tsa_ctrl.identify.motion import tied_joints
from tsa_ctrl.model.catalogue import CATALOGUE
from tsa_ctrl.model.effects.search import Scales, Variant
from tsa_ctrl.model.effects.specification import Specification, Stage
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import Model, RigidDrive, TendonSheath
from tsa_ctrl.model.predict import missing_for
from tsa_ctrl.model.signals import Signals

LEAST_REACH = 0.02  # rad, least half range of another joint: the effect of less is within the friction's uncertainty
SAME_JOINT = 0.02  # share of the range: columns that differ by less are one joint; smoothing removes encoder noise

Catalogue = Mapping[str, tuple[Variant, ...]]  # variants of each effect that these logs can test


def all_but(names: Sequence[str], catalogue: Catalogue) -> list[Variant]:
    """Return the variants of all effects except those in `names`."""
    return [variant for name, variants in catalogue.items() if name not in names for variant in variants]


@dataclass(frozen=True)
class Candidates:
    """Hold the variants of each testable effect, and the reason for each effect that these logs cannot test."""

    catalogue: Catalogue
    not_testable: Mapping[str, str]


def candidates(frame: Frame, model: Model, scales: Scales) -> Candidates:
    """Return the effects of the catalogue that the torque of these logs can test, and the reasons for the others."""
    found: dict[str, tuple[Variant, ...]] = {}
    refused: dict[str, str] = {}
    for name, spec in CATALOGUE.items():
        if not spec.hypothesis:
            continue  # a formula of the user is not a hypothesis
        reason = _untestable(spec, frame, model, scales)
        if spec.stage is Stage.STRETCH and not reason:
            continue  # the torque does not show it
        variants = () if reason else tuple(variant for variant in spec.search(name, scales) if variant.starts)
        if variants:
            found[name] = variants
        else:
            refused[name] = reason or spec.unresolved
    return Candidates(found, refused)


def _untestable(spec: Specification, frame: Frame, model: Model, scales: Scales) -> str:
    """Return the reason why these logs cannot test an effect; empty if they can."""
    if spec.name in model.effects:
        return "already in the model file"
    clash = [other for other in spec.excludes if other in model.effects]
    if clash:
        return f"the model file has {clash[0]}, which excludes it"
    if model.kind not in spec.kinds:
        return f"has no meaning for a {model.kind.spoken}"
    rigid = isinstance(model, RigidDrive)
    if not isinstance(model, TendonSheath) and getattr(model, spec.name, None) is not None:
        return "part of the base model, which is recalibrated"
    for run in frame.runs:
        missing = missing_for(spec.name, run.signals, rigid=rigid)
        if missing:
            return f"no {' or '.join(missing)} column"
    return spec.untestable(scales)


def scales_of(frame: Frame, model: Model) -> Scales:
    """Return the speeds, torques and travels in these logs, which scale the grids of the candidates."""
    signals = [run.signals for run in frame.runs]
    speed = np.concatenate([np.abs(s.omega_j) for s in signals])
    fast = float(np.quantile(speed, 0.95))
    longest = max(signals, key=lambda s: float(s.t[-1] - s.t[0]))
    reach = max((0.5 * float(np.ptp(s.q_j)) for s in signals if s.q_j is not None), default=0.0)
    motor = max((0.5 * float(np.ptp(s.q_m)) for s in signals if s.q_m is not None), default=0.0)
    if not reach:
        reach = max(0.5 * float(np.ptp(np.cumsum(s.omega_j))) * s.period for s in signals)
    plain = isinstance(model, RigidDrive)
    derived = "omega_m" if plain else "omega_j"
    return Scales(
        torque=max(float(np.std(np.concatenate([run.target for run in frame.runs]))), 1e-9),
        motor_torque=max(float(np.std(np.concatenate([s.tau_m for s in signals]))), 1e-9),
        largest_motor_torque=max(float(np.max(np.abs(s.tau_m))) for s in signals),
        speed=max(fast, 1e-9),
        speed_noise=max(run.velocity_noise for run in frame.runs),
        acceleration=max(float(np.std(np.concatenate([s.acceleration for s in signals]))), 1e-9),
        reach=max(reach, 1e-9),
        middle=float(np.mean(frame.column("q_j"))) if frame.has("q_j") else 0.0,
        motor_reach=max(motor or reach, 1e-9),
        motor_step=_step([s.q_m for s in signals if s.q_m is not None]) if frame.has("q_m") else math.nan,
        begin=float(longest.t[0]),
        seconds=float(longest.t[-1] - longest.t[0]),
        period=signals[0].period,
        heating=max((float(np.ptp(s.temperature)) for s in signals if s.temperature is not None), default=0.0),
        bending=_range_of_bending(frame, model) if isinstance(model, TendonSheath) else 0.0,
        derived_velocity=derived if any(derived in run.raw.derived for run in frame.runs) else "",
        plain=plain,
        offset=isinstance(model, RigidDrive) and model.torque_offset is not None,
        joints=_other_joints(signals) if isinstance(model, TendonSheath) else {},
        tied=tied_joints(_angles(signals, _moving_joints(signals))),
    )


def _other_joints(logs: Sequence[Signals]) -> dict[str, float]:
    """Return the half range (rad) of each other joint that moved and that all logs have as q_j.NAME.

    Of joints that move in proportion, only one is returned.
    """
    moving = _moving_joints(logs)
    tied = tied_joints(_angles(logs, moving))
    return {name: reach for name, reach in moving.items() if name not in tied}


def _angles(logs: Sequence[Signals], names: Iterable[str]) -> dict[str, Array]:
    """Return the angle (rad) of each joint in all logs, (n,)."""
    return {name: np.concatenate([log.joints[name] for log in logs]) for name in names}


def _moving_joints(logs: Sequence[Signals]) -> dict[str, float]:
    names = [name for name in logs[0].joints if all(name in log.joints for log in logs)]
    ranges = {name: max(0.5 * float(np.ptp(log.joints[name])) for log in logs) for name in names}
    own = [name for name in names if all(log.q_j is not None and _alike(log.q_j, log.joints[name]) for log in logs)]
    return {name: reach for name, reach in ranges.items() if reach > LEAST_REACH and name not in own}


def _alike(own: Array, other: Array) -> bool:
    """Return True if both columns are the same joint; q_j is denoised, but q_j.NAME is not."""
    return float(np.std(own - other)) < SAME_JOINT * max(float(np.ptp(own)), 1e-9)


def _step(angles: Sequence[Array]) -> float:
    """Return the 90 % quantile of the steps from sample to sample, rad."""
    return float(np.quantile(np.abs(np.concatenate([np.diff(angle) for angle in angles])), 0.9))


def _range_of_bending(frame: Frame, model: TendonSheath) -> float:
    """Return the range of the column theta divided by the model's bending angle; 0 if no log has the column."""
    angles = [run.signals.theta for run in frame.runs if run.signals.theta is not None]
    return float(np.ptp(np.concatenate(angles))) / max(model.bending_angle, 1e-9) if angles else 0.0
