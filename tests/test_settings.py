"""A file of another kind is called by its name, not by the first key that does not fit."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tsa_ctrl import settings
from tsa_ctrl.bus.drive.profile import load_profile
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


@pytest.mark.parametrize("name", KINDS)
def test_the_shipped_files_are_known_by_their_tables(name: str) -> None:
    assert settings.file_kind(settings.read_toml(CONFIG / name)) == KINDS[name]


@pytest.mark.parametrize("wanted", KINDS)
@pytest.mark.parametrize("given", KINDS)
def test_another_kind_of_file_is_named_with_the_kind_that_is_wanted(given: str, wanted: str) -> None:
    if given == wanted:
        READERS[wanted](CONFIG / given)
        return
    with pytest.raises(UsageError, match=f"this is {KINDS[given]}; {KINDS[wanted]} is required here$"):
        READERS[wanted](CONFIG / given)


def test_an_unknown_key_in_the_right_kind_of_file_is_still_told_with_the_nearest() -> None:
    data = {**settings.read_toml(CONFIG / "plant.toml"), "phsics": {}}
    with pytest.raises(UsageError, match="unknown key 'phsics'; did you mean 'physics'"):
        settings.convert(data, type(load_plant(CONFIG / "plant.toml")), "x.toml")


@pytest.mark.parametrize(
    ("table", "key", "words"),
    [
        ("joint", "phase", r"axis\[0\]\.joint: .*; it belongs in \[axis\.motion\], or did you mean 'weight_phase'\?$"),
        ("joint", "curvature", r"; it belongs in \[axis\.tendon\]$"),
        ("joint", "duration", r"; it belongs in \[\[axis\.fault\]\]"),
        ("tendon", "bus", r"; it belongs in the top level$"),
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
