"""List the effects by name, and check the `[effects.NAME]` tables of model files.

Source: the catalogue of effects by which measured data differ from (3.55)-(3.56). The facts of an effect are on its
class, in `tsa_ctrl.model.effects`.
"""

from __future__ import annotations

import difflib
from collections.abc import Collection, Iterable, Mapping
from types import MappingProxyType
from typing import Any

from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.effects import EFFECTS
from tsa_ctrl.model.effects.custom import NAMES
from tsa_ctrl.model.effects.specification import Setting, Specification, Stage
from tsa_ctrl.model.expression import FUNCTIONS, INSIDE, REMEMBERING

CATALOGUE: Mapping[str, Specification] = MappingProxyType(
    {spec.name: spec for spec in map(Specification.of, EFFECTS)}  # in the order of composition
)

# Not effects, but competing hypotheses: wrong parameters only, and a torque sensor whose error depends on its load
PARAMETER_ERROR, SENSOR_ERROR = "parameter_error", "torque_sensor_error"


def of_the_stretch(names: Collection[str]) -> tuple[list[str], list[str]]:
    """Return the effects that act only on the tendon elongation: those in `names`, and those not in `names`."""
    every = [spec.name for spec in CATALOGUE.values() if spec.stage is Stage.STRETCH]
    return [name for name in every if name in names], [name for name in every if name not in names]


def twins_of(name: str) -> frozenset[str]:
    """Return the effects that some logs cannot distinguish from this one; one effect of each pair lists the other."""
    own = {other for twins in CATALOGUE[name].twins for other in twins.names} if name in CATALOGUE else set()
    others = {spec.name for spec in CATALOGUE.values() for twins in spec.twins if name in twins.names}
    return frozenset(own | others)


def check_effects(effects: Mapping[str, Mapping[str, Any]], where: str) -> dict[str, dict[str, Setting]]:
    """Validate `[effects.NAME]` tables and fill in constant defaults, in the order of composition.

    Raises UsageError with the effect, the parameter, the value found and the allowed range.
    """
    for name in effects:
        if name not in CATALOGUE:
            near = difflib.get_close_matches(name, CATALOGUE, n=1, cutoff=0.5)
            advice = f"did you mean '{near[0]}'?" if near else f"known effects are {', '.join(CATALOGUE)}"
            raise UsageError(f"{where}: [effects.{name}]: unknown effect; {advice}")
    checked: dict[str, dict[str, Setting]] = {}
    for spec in CATALOGUE.values():
        if spec.name not in effects:
            continue
        clash = [other for other in spec.excludes if other in effects]
        if clash:
            raise UsageError(
                f"{where}: [effects.{spec.name}] cannot be combined with {_listed(clash)}; remove one of them"
            )
        checked[spec.name] = _check_parameters(spec, effects[spec.name], f"{where}: [effects.{spec.name}]")
    return checked


def _check_parameters(spec: Specification, given: Mapping[str, Any], where: str) -> dict[str, Setting]:
    if not isinstance(given, Mapping):
        raise UsageError(f"{where}: found {given!r}; write a table [effects.{spec.name}]")
    known = [p.name for p in spec.parameters]
    values: dict[str, Setting] = {}
    for key in given:
        if key not in known and spec.named:
            values[key] = _constant(spec, key, given[key], where)
        elif key not in known:
            near = difflib.get_close_matches(key, known, n=1, cutoff=0.4)
            advice = f"did you mean '{near[0]}'?" if near else f"known keys are {', '.join(known) or 'none'}"
            raise UsageError(f"{where}: unknown key '{key}'; {advice}")
    for parameter in spec.parameters:
        value = given.get(parameter.name, parameter.default)
        if value is None:
            if parameter.optional:
                continue
            raise UsageError(f"{where}: key '{parameter.name}' is missing; give {parameter.describe()}")
        if not parameter.accepts(value):
            raise UsageError(f"{where}: {parameter.name} = {value!r}; allowed is {parameter.describe()}")
        values[parameter.name] = parameter.taken(value)
    if "expression" in values:
        try:
            _ = spec.build(values).program  # a wrong formula is reported before it is used
        except UsageError as error:
            raise UsageError(f"{where.removesuffix(f'[effects.{spec.name}]')}{error}") from None
    return values


def formula_of(parameters: Mapping[str, Any]) -> list[tuple[float, ...]]:
    """Return the steps of a checked `[effects.custom]` for another stack machine: operation, argument, two constants.

    For a function with a memory, the argument is the index of the memory. Only these functions use the constants.
    """
    program = CATALOGUE["custom"].build(parameters).program
    constants = [
        program.memories[int(number)].constants if op in REMEMBERING.values() else ()
        for op, number in zip(program.operations, program.arguments, strict=True)
    ]
    steps = zip(program.operations, program.arguments, constants, strict=True)
    return [(op, number, *more, *[0.0] * (2 - len(more))) for op, number, more in steps]


def _constant(spec: Specification, key: str, value: object, where: str) -> float:
    if spec.name == "custom" and (key in (*NAMES, *FUNCTIONS, *REMEMBERING, INSIDE)):
        raise UsageError(f"{where}: '{key}' is a signal or a function already; give the constant another name")
    allowed = spec.parameter(key)
    if not allowed.accepts(value):
        raise UsageError(f"{where}: {key} = {value!r}; allowed is {allowed.describe()}")
    return float(value)  # type: ignore[arg-type]


def _listed(names: Iterable[str]) -> str:
    return ", ".join(f"[effects.{name}]" for name in names)
