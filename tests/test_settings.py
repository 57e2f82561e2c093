"""Errors in settings files: the wrong kind of file, unknown or misplaced keys, and numbers outside their bounds."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from msgspec import inspect

from tsa_ctrl import settings
from tsa_ctrl.bus.drive.profile import DriveProfile, load_profile
from tsa_ctrl.config import load_configuration
from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.parameters import load_model
from tsa_ctrl.plant.settings import PlantSettings, load_plant

CONFIG = Path(__file__).parents[1] / "config"
KINDS = {
    "controller.toml": "a controller file",
    "plant.toml": "a plant file",
    "actuator.toml": "an actuator model",
    "drives/generic.toml": "a drive profile",
}
READERS = {
    "controller.toml": load_configuration,
    "plant.toml": load_plant,
    "actuator.toml": load_model,
    "drives/generic.toml": lambda path: load_profile(str(path), CONFIG),
}


def test_a_file_without_an_end_is_one_error() -> None:
    with pytest.raises(UsageError, match=r"/dev/zero: is larger than 20 MB"):
        settings.read_toml("/dev/zero")


@pytest.mark.parametrize("wanted", KINDS)
@pytest.mark.parametrize("given", KINDS)
def test_another_kind_of_file_is_named_with_the_kind_that_is_wanted(given: str, wanted: str) -> None:
    if given == wanted:
        READERS[wanted](CONFIG / given)
        return
    with pytest.raises(UsageError, match=f"this is {KINDS[given]}; {KINDS[wanted]} is required here$"):
        READERS[wanted](CONFIG / given)


@pytest.mark.parametrize(
    ("table", "key", "words"),
    [
        ("joint", "phase", r"axis\[0\]\.joint: .*; it belongs in \[axis\.motion\], or did you mean 'weight_phase'\?$"),
        ("joint", "curvature", r"; it belongs in \[axis\.tendon\]$"),
        ("joint", "interface", r"; it belongs in \[bus\], or did you mean 'inertia'\?$"),
        ("joint", "duration", r"; it belongs in \[\[axis\.fault\]\]"),
        ("tendon", "bus", r"; it belongs in \[\[axis\]\] or the top level$"),
        ("joint", "node_id", r"; it belongs in \[axis\.drive\], \[axis\.encoder\] or \[axis\.torque_sensor\]$"),
        ("joint", "curvatur", r"; did you mean 'curvature' of \[axis\.tendon\]\?$"),
        ("joint", "stifness", r"; did you mean 'stiffness'\?$"),
        ("environment", "zzzzzz", "; known keys are bending, temperature$"),
    ],
)
def test_a_key_in_the_wrong_table_is_told_where_it_belongs(table: str, key: str, words: str) -> None:
    data = {"axis": [{"name": "a", table: {key: 1.0}}]}
    with pytest.raises(UsageError, match=f"unknown key '{key}'") as caught:
        settings.convert(data, PlantSettings, "x.toml")
    assert re.search(words, str(caught.value)), str(caught.value)


def test_a_suggestion_is_never_what_was_given() -> None:
    keys = {key for table in settings.tables_of(PlantSettings) for key in table.keys}
    for table in ("joint", "motion", "motor", "drive"):
        allowed = next(each.keys for each in settings.tables_of(PlantSettings) if each.path == ("axis", table))
        for key in keys - set(allowed):
            with pytest.raises(UsageError) as caught:
                settings.convert({"axis": [{"name": "a", table: {key: 1.0}}]}, PlantSettings, "x.toml")
            assert f"did you mean '{key}'" not in str(caught.value)


def bounds_of(kind: inspect.Type, found: dict[tuple[type, str, float], None]) -> None:
    """Collect a value just outside each bound, for every number in a type of settings and its nested types.

    A key of `found` consists of the class, the name of the number and the value.
    """
    if isinstance(kind, inspect.StructType) and not any(cls is kind.cls for cls, *_ in found):
        for field in kind.fields:
            for part in (field.type, *getattr(field.type, "types", ())):
                if isinstance(part, inspect.IntType | inspect.FloatType):
                    step = 1.0 if isinstance(part, inspect.IntType) else 1e-6
                    for bound, way in ((part.ge, -step), (part.gt, 0.0), (part.le, step), (part.lt, 0.0)):
                        if bound is not None:
                            value = bound + way * max(1.0, abs(bound) if step < 1.0 else 1.0)
                            found[kind.cls, field.encode_name, type(bound)(value)] = None
            bounds_of(field.type, found)
    for name in ("types", "item_types"):
        for part in getattr(kind, name, ()):
            bounds_of(part, found)
    for name in ("item_type", "value_type"):
        if isinstance(part := getattr(kind, name, None), inspect.Type):
            bounds_of(part, found)


def test_a_number_outside_its_bounds_is_one_line_with_key_and_value() -> None:
    """Each number of the controller, plant and profile files is set just outside each of its bounds."""
    found: dict[tuple[type, str, float], None] = {}
    for kind in (type(load_configuration(CONFIG / "controller.toml").file), PlantSettings, DriveProfile):
        bounds_of(inspect.type_info(kind), found)
    assert len(found) > 300
    for kind, key, value in found:
        with pytest.raises(UsageError, match=rf"^x.toml: {key}: expected .*, found {re.escape(f'{value:g}')}[^\n]*$"):
            settings.convert({key: value}, kind, "x.toml")
