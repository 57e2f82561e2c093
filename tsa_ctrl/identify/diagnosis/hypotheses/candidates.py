"""The catalogue's effects as candidates on these logs: what can be tested, and why the rest cannot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from tsa_ctrl.identify.diagnosis.data.frame import Frame
from tsa_ctrl.model.catalogue import CATALOGUE
from tsa_ctrl.model.effects.search import Scales, Variant
from tsa_ctrl.model.effects.specification import Specification
from tsa_ctrl.model.parameters import Model, RigidDrive
from tsa_ctrl.model.predict import missing_for

Catalogue = Mapping[str, tuple[Variant, ...]]  # of each effect that these logs can test


def all_but(names: Sequence[str], catalogue: Catalogue) -> list[Variant]:
    """The variants of every effect but these."""
    return [variant for name, variants in catalogue.items() if name not in names for variant in variants]


@dataclass(frozen=True)
class Candidates:
    """Variants by effect, and the effects that these logs cannot test, with the reason: together the catalogue."""

    catalogue: Catalogue
    not_testable: Mapping[str, str]


def candidates(frame: Frame, model: Model, scales: Scales) -> Candidates:
    """What the catalogue says of these logs."""
    found: dict[str, tuple[Variant, ...]] = {}
    refused: dict[str, str] = {}
    for name, spec in CATALOGUE.items():
        if spec.named:
            continue  # the user's own formula is no hypothesis
        reason = _untestable(spec, frame, model, scales)
        variants = () if reason else tuple(variant for variant in spec.search(name, scales) if variant.starts)
        if variants:
            found[name] = variants
        else:
            refused[name] = reason or spec.unresolved
    return Candidates(found, refused)


def _untestable(spec: Specification, frame: Frame, model: Model, scales: Scales) -> str:
    """Why these logs cannot test an effect; empty when they can."""
    if spec.name in model.effects:
        return "already in the model file"
    clash = [other for other in spec.excludes if other in model.effects]
    if clash:
        return f"the model file has {clash[0]}, which excludes it"
    rigid = isinstance(model, RigidDrive)
    if rigid and not spec.rigid_drive:
        return "has no meaning for a plain drive"
    if rigid and getattr(model, spec.name, None) is not None:
        return "part of the base model, which is recalibrated"
    for run in frame.runs:
        missing = missing_for(spec.name, run.signals, rigid=rigid)
        if missing:
            return f"no {' or '.join(missing)} column"
    return spec.untestable(scales)
