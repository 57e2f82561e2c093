"""Report the measured columns of a log that a command does not use."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.motion import SHAFTS
from tsa_ctrl.model.catalogue import CATALOGUE
from tsa_ctrl.model.effects.specification import Kind
from tsa_ctrl.model.parameters import Model, TendonSheath
from tsa_ctrl.signals import COLUMNS, JOINT_ANGLE

SETPOINTS = frozenset(("tau_j_des", "tau_m_cmd"))  # commanded, not measured
MOST_NAMES = 8  # names in the sentence


def with_unused(log: Dataset, model: Model, command: str, *more: str, hypotheses: bool = False) -> Dataset:
    """Return the log with a note on the measured columns that `command` does not use; a set-point is not measured.

    Angle, velocity and acceleration of one shaft are one signal.

    Args:
        log: log as it was read.
        model: the model, whose kind and effects require columns.
        command: name of the command, for the note.
        more: columns that the command uses in addition.
        hypotheses: True if the command also tests the effects of the catalogue that are not in the model.
    """
    used = {*_of_the_kind(log, model), *_of_the_effects(model, hypotheses), *more}
    for shaft in SHAFTS:
        if not used.isdisjoint(shaft):
            used.update(shaft)
    given = (name for name in log.columns if name not in log.derived and name != "t")
    unknown = [name for name in log.left_out if name not in COLUMNS and not name.startswith(JOINT_ANGLE)]
    joints = hypotheses and model.kind is Kind.TENDON_SHEATH
    unused = [
        *(name for name in given if name not in used | SETPOINTS and not (joints and name.startswith(JOINT_ANGLE))),
        *unknown,
    ]
    if not unused:
        return log
    further = f" and {len(unused) - MOST_NAMES} more" if len(unused) > MOST_NAMES else ""
    remedies = []
    if model.kind is Kind.RIGID_DRIVE and "tau_j" in unused:
        remedies.append('a joint torque sensor behind a gear needs [actuator] kind = "geared_drive"')
    if unknown:
        remedies.append("tsa log import renames columns whose names are unknown")
    note = f"not used by {command} with a {model.kind.value}: column {', '.join(unused[:MOST_NAMES])}{further}"
    return dataclasses.replace(log, read=(*log.read, "; ".join((note, *remedies))))


def _of_the_kind(log: Dataset, model: Model) -> Iterable[str]:
    """Return the columns that the equation of the model uses."""
    if model.kind is Kind.RIGID_DRIVE:
        return "tau_m", "omega_m"
    if model.kind is Kind.GEARED_DRIVE:
        measured = any(name in log and name not in log.derived for name in ("q_j", "omega_j"))
        return "tau_m", "tau_j", "omega_j" if measured else "omega_m"
    assert isinstance(model, TendonSheath)
    joints = () if model.routing is None else tuple(f"{JOINT_ANGLE}{name}" for name in model.routing.joints)
    by_routing = bool(joints) and all(name in log for name in joints)
    return "tau_m", "tau_j", "omega_j", *(joints if by_routing else ("theta",))


def _of_the_effects(model: Model, hypotheses: bool) -> Iterable[str]:
    """Return the columns that the effects use; a plain drive uses the motion of the motor instead of the joint."""
    needed = [spec.needed_live(model.effects[name]) for name, spec in CATALOGUE.items() if name in model.effects]
    needed += [CATALOGUE[name].columns for name in model.effects]
    if hypotheses:
        needed += [spec.columns for spec in CATALOGUE.values() if spec.hypothesis and model.kind in spec.kinds]
    motor = model.kind is Kind.RIGID_DRIVE
    for alternatives in (columns for each in needed for columns in each):
        if not (motor and not {"q_j", "omega_j"}.isdisjoint(alternatives)):
            yield from alternatives
