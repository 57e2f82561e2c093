"""Errors in settings files: the wrong kind of file, unknown or misplaced keys, and numbers outside their bounds."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from msgspec import inspect

from tsa_ctrl import settings
from tsa_ctrl.bus.drive.profile import DriveProfile, load_profile
from tsa_ctrl.config import ControllerFile, load_configuration
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
        ("joint", "phase", r"axis 'a' joint: .*; it belongs in \[axis\.motion\], or did you mean 'weight_phase'\?$"),
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


@pytest.mark.parametrize(
    ("table", "key", "value", "words"),
    [
        (
            "controller",
            "stop_time",
            300,
            "a number above 0 and of at most 5 s, found 300 s; lower it, or divide it by 1000",
        ),
        (
            "controller",
            "stop_time",
            -1.0,
            "a number above 0 and of at most 5 s, found -1 s; raise it (duration of the ramp",
        ),
        (
            "controller",
            "stop_time",
            "0.3 s",
            "a number above 0 and of at most 5 s, found '0.3 s'; write a number in s (",
        ),
        ("controller", "stop_time", [1.0], "found a list; write a number in s (duration of the ramp"),
        ("controller", "stop_time", True, "found true; write a number in s (duration of the ramp"),
        (
            "axis.law",
            "compensation",
            95,
            "a number from 0 to 1.2, found 95; lower it, or divide it by 100 if it is in per",
        ),
        (
            "axis.limits",
            "over_speed",
            1e9,
            "of at most 1000 rad/s, found 1e+09 rad/s; lower it, or multiply it by 0.1047",
        ),
        ("axis.encoder", "heartbeat_timeout", 200, "from 0.001 to 10 s, found 200 s; lower it, or divide it by 1000"),
        ("axis.drive", "node_id", 200, "a whole number from 1 to 127, found 200; lower it (1 to 127)"),
        ("axis.torque_sensor", "offset", "x", "from -10000 to 10000 N*m, found 'x'; write a number in N*m (subtracted"),
    ],
)
def test_a_wrong_number_is_reported_with_unit_range_and_remedy(table: str, key: str, value: object, words: str) -> None:
    data = settings.read_toml(CONFIG / "controller.toml")
    section = data["axis"][0][table.removeprefix("axis.")] if table.startswith("axis.") else data[table]
    section[key] = value
    place = table.replace("axis.", "axis 'knee' ")
    with pytest.raises(UsageError, match=re.escape(f"x.toml: {place}.{key}: expected ")) as caught:
        settings.convert(data, ControllerFile, "x.toml")
    assert words in str(caught.value), str(caught.value)


@pytest.mark.parametrize(
    ("place", "expected"),
    [
        ("$.axis[0].drive.node_id", "axis 'hip' drive.node_id"),
        ("$.axis[0].fault[0].at", "axis 'hip' fault 'dead' at"),
        ("$.axis[1].model", "axis[1].model"),  # two axes have the name
        ("$.axis[3].model", "axis[3].model"),  # no name
        ("$.bus[0].options[...]", "bus 'left' options[...]"),
        ("$.controller.rate", "controller.rate"),
    ],
)
def test_a_table_of_a_list_is_called_by_its_name(place: str, expected: str) -> None:
    axes = [{"name": "hip", "fault": [{"name": "dead"}]}, {"name": "knee"}, {"name": "knee"}, {"name": ""}]
    assert settings.named(place, {"axis": axes, "bus": [{"name": "left", "options": {}}]}) == expected


def test_every_message_about_a_file_calls_an_axis_by_its_name(tmp_path: Path) -> None:
    path = tmp_path / "controller.toml"
    text = (CONFIG / "controller.toml").read_text(encoding="utf-8")
    for value in ('""', "nan", "0", '"x"'):
        path.write_text(text.replace("torque = 2.0 ", f"torque = {value} "), encoding="utf-8")
        with pytest.raises(UsageError, match=r"axis 'knee' limits"):
            load_configuration(path)


@pytest.mark.parametrize(
    ("table", "key", "value", "words"),
    [
        ("motion", "amplitude", 120.0, "from -100 to 100 rad, found 120 rad; lower it, or multiply it by 0.01745"),
        ("drive", "boot_time", 5000.0, "from 0 to 3600 s, found 5000 s; lower it, or divide it by 1000"),
        ("drive", "peak_torque", 2e4, "at most 10000 N*m, found 20000 N*m; lower it, or divide it by 1000"),
    ],
)
def test_a_value_of_the_plant_in_another_unit_is_rejected(table: str, key: str, value: float, words: str) -> None:
    with pytest.raises(UsageError, match=re.escape(words)):
        settings.convert({"axis": [{"name": "a", table: {key: value}}]}, PlantSettings, "x.toml")
