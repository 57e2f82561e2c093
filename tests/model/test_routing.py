"""The `[routing]` table of a model file, its functions, and its one-line errors."""

from __future__ import annotations

import dataclasses
import math
import re
from pathlib import Path

import numpy as np
import pytest

from tests.model.actuator import ACTUATOR
from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.parameters import TendonSheath, load_tendon_sheath, save_model
from tsa_ctrl.model.routing import Routing

EXAMPLE = Path(__file__).parents[2] / "config" / "actuator.toml"
BOTH = "[routing]\njoints = { hip = 0.8, knee = -0.3 }\n"
TABLE = BOTH + "table.ankle = [[-0.5, 0.2], [0.0, 0.0], [1.0, 0.6]]\n"
APART = TABLE + "[routing.tendon_b]\njoints = { hip = 0.5 }\n"


def loaded(folder: Path, routing: str) -> TendonSheath:
    path = folder / "model.toml"
    path.write_text(f"{EXAMPLE.read_text(encoding='utf-8')}\n{routing}", encoding="utf-8")
    return load_tendon_sheath(path)


def routed(folder: Path, routing: str) -> Routing:
    found = loaded(folder, routing).routing
    assert found is not None
    return found


def test_gains_bend_both_sheaths_in_proportion_to_the_joints(tmp_path: Path) -> None:
    """The wrap angle exceeds Theta_0 by 0.8 * 0.5 - 0.3 * 0.2 = 0.34 rad."""
    routing = routed(tmp_path, BOTH)
    assert routing.joints == ("hip", "knee")
    assert routing.alike
    angles = {name: np.array([angle]) for name, angle in {"hip": 0.5, "knee": 0.2, "other": 9.0}.items()}
    assert routing.wrap_angles(angles) == (pytest.approx([0.34]), pytest.approx([0.34]))


@pytest.mark.parametrize(
    ("ankle", "added"), [(-2.0, 0.2), (-0.5, 0.2), (-0.25, 0.1), (0.0, 0.0), (0.5, 0.3), (3.0, 0.6)]
)
def test_a_table_is_linear_between_its_points_and_constant_beyond(tmp_path: Path, ankle: float, added: float) -> None:
    route = routed(tmp_path, TABLE).a
    angles = {"hip": 0.0, "knee": 0.0, "ankle": ankle}
    assert route.added(angles) == pytest.approx(added)


def test_the_second_tendon_may_be_routed_differently(tmp_path: Path) -> None:
    routing = routed(tmp_path, APART)
    assert not routing.alike
    assert routing.joints == ("hip", "knee", "ankle")
    angles = {name: np.ones(1) for name in ("hip", "knee", "ankle")}
    assert routing.wrap_angles(angles) == (pytest.approx([0.8 - 0.3 + 0.6]), pytest.approx([0.5]))


@pytest.mark.parametrize("routing", [BOTH, TABLE, APART])
def test_a_written_file_has_the_same_routing(tmp_path: Path, routing: str) -> None:
    model = loaded(tmp_path, routing)
    for template in (None, EXAMPLE, tmp_path / "model.toml"):
        save_model(model, tmp_path / "again.toml", template)
        assert load_tendon_sheath(tmp_path / "again.toml").routing == model.routing
    save_model(dataclasses.replace(model, routing=None), tmp_path / "none.toml", tmp_path / "model.toml")
    assert load_tendon_sheath(tmp_path / "none.toml").routing is None
    assert ACTUATOR.routing is None


@pytest.mark.parametrize(
    ("routing", "words"),
    [
        (
            "[routing]\njoints = { hip = 80.0 }\n",
            r"joints.hip = 80; allowed is -10 to 10, rad of wrap angle per rad of the joint",
        ),
        ("[routing]\njoint = { hip = 0.8 }\n", r"routing: unknown key 'joint'; did you mean 'joints'"),
        (TABLE.replace("knee", "ankle"), r"joint 'ankle' has a gain and a table; keep one of them"),
        ("[routing]\ntable.hip = [[0.0, 0.0]]\n", r"table.hip = \[\[0.0, 0.0\]\]; give two or more points"),
        ("[routing]\ntable.hip = [[0.0, 0.0], [0.0, 1.0]]\n", r"give two or more points .* increasing"),
        (
            "[routing]\ntable.hip = [[-0.5, -0.4], [0.5, 40.0]]\n",
            r"table.hip changes by 40.4 rad from -0.5 to 0.5 rad; allowed is a slope of -10 to 10 rad/rad",
        ),
        (
            "[routing]\ntable.hip = [[-30.0, 0.4], [20.0, -0.4]]\n",
            r"table.hip has a joint angle of -30 rad; allowed is at most 18.85 rad either way",
        ),
    ],
)
def test_what_is_no_routing_is_refused_in_one_line(tmp_path: Path, routing: str, words: str) -> None:
    with pytest.raises(UsageError) as caught:
        loaded(tmp_path, routing)
    assert re.search(words, str(caught.value))
    assert "\n" not in str(caught.value)


def test_a_joint_that_is_no_axis_is_refused_with_the_names_of_those_that_are(tmp_path: Path) -> None:
    routing = routed(tmp_path, BOTH)
    routing.check_joints(["hip", "knee", "ankle"], "plant.toml")
    with pytest.raises(UsageError) as caught:
        routing.check_joints(["knee", "foot"], "plant.toml: axis 'knee'")
    assert str(caught.value) == (
        "plant.toml: axis 'knee': [routing] names joint 'hip'; the axes are knee, foot; "
        "give the name of one of them, or add an axis of that name"
    )


def test_the_extremes_over_the_travel_are_those_of_a_fine_grid(tmp_path: Path) -> None:
    """The minimum of the table at 0 lies within the travel of the ankle."""
    route = routed(tmp_path, TABLE).a
    travel = {"hip": (-0.5, 0.7), "knee": (0.0, 1.2), "ankle": (-0.4, 2.0)}
    grid = {name: [low + (high - low) * i / 40 for i in range(41)] for name, (low, high) in travel.items()}
    sums = [
        route.added({"hip": hip, "knee": knee, "ankle": ankle})
        for hip in grid["hip"]
        for knee in grid["knee"]
        for ankle in [*grid["ankle"], 0.0]
    ]
    assert route.extremes(travel) == pytest.approx((min(sums), max(sums)))


def test_a_sheath_that_would_be_bent_less_than_straight_is_refused_with_place_and_remedy(tmp_path: Path) -> None:
    """The wrap angle would be 2.6 - 0.8 * 4 = -0.6 rad."""
    routing = routed(tmp_path, BOTH)
    routing.check_travel(2.6, {"hip": (-1.0, 1.0), "knee": (-math.pi, math.pi)}, "plant.toml")
    routing.check_travel(2.6, {}, "plant.toml")
    with pytest.raises(UsageError) as caught:
        routing.check_travel(2.6, {"hip": (-4.0, 1.0)}, "plant.toml")
    assert str(caught.value) == (
        "plant.toml: [routing] tendon a has a wrap angle of -0.6 rad over the travel (hip from -4 to 1 rad); "
        "allowed is 0 to 18.85 rad; correct gains, tables or [sheath] bending_angle, or the travel"
    )


def test_a_sheath_wound_by_more_than_three_turns_is_refused(tmp_path: Path) -> None:
    """A table with wrap angles in degrees gives 2.6 + 23 rad, without any travel."""
    routing = routed(tmp_path, "[routing]\ntable.hip = [[-0.5, -2.0], [2.5, 23.0]]\n")
    with pytest.raises(UsageError, match=r"tendon a has a wrap angle of 25.6 rad; allowed is 0 to 18.85 rad"):
        routing.check_travel(2.6, {}, "plant.toml")


def test_a_wrap_angle_outside_its_range_in_a_log_is_refused_with_the_ranges_of_the_joints(tmp_path: Path) -> None:
    """The angles of both joints compensate each other, so the sums of their extremes do not count."""
    routing = routed(tmp_path, "[routing]\njoints = { hip = 2.0, knee = -2.0 }\n")
    angle = np.linspace(-1.0, 1.0, 5)
    routing.check_log(2.6, {"hip": angle, "knee": angle}, "run.csv: model.toml")
    with pytest.raises(UsageError) as caught:
        routing.check_log(2.6, {"hip": angle, "knee": -angle}, "run.csv: model.toml")
    assert str(caught.value) == (
        "run.csv: model.toml: [routing] tendon a has a wrap angle of -1.4 rad over the columns q_j.NAME (hip from -1 "
        "to 1 rad, knee from -1 to 1 rad); allowed is 0 to 18.85 rad; correct gains, tables or [sheath] bending_angle, "
        "or the columns q_j.NAME"
    )


@pytest.mark.parametrize("routing", ["[routing]\n", "[routing]\njoints = {}\n[routing.tendon_b]\n"])
def test_a_routing_without_joints_is_none(tmp_path: Path, routing: str) -> None:
    assert loaded(tmp_path, routing).routing is None
