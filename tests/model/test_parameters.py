"""The actuator model file: accepted files, one-line errors, and writing without a change of the model."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from tests.model.actuator import ACTUATOR
from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.parameters import (
    GearedDrive,
    RigidDrive,
    TendonSheath,
    dump_model,
    load_model,
    load_tendon_sheath,
    save_model,
)
from tsa_ctrl.model.stretch import compliances, profile_of

EXAMPLE = Path(__file__).parents[2] / "config" / "actuator.toml"
DRIVE = '[actuator]\nkind = "rigid_drive"\ninertia = 0.002\ncoulomb_friction = 0.05\n'


def changed(old: str, new: str) -> str:
    """Return the example file with `old` replaced by `new`."""
    text = EXAMPLE.read_text(encoding="utf-8")
    assert old in text
    return text.replace(old, new)


def loaded(folder: Path, text: str) -> TendonSheath | RigidDrive:
    path = folder / "model.toml"
    path.write_text(text, encoding="utf-8")
    return load_model(path)


def bare(model: TendonSheath | RigidDrive) -> TendonSheath | RigidDrive:
    """Return the model without the name of its file."""
    return dataclasses.replace(model, source="")


def test_example_is_the_reference_actuator() -> None:
    """The commented example contains the values of the reference actuator."""
    assert bare(load_model(EXAMPLE)) == dataclasses.replace(ACTUATOR, bending_centre=0.5)


COURSE = ((0.0, 0.0), (0.1, 0.5), (0.7, 0.5), (0.8, 1.0), (1.0, 1.0))


def with_course(course: str, centre: str = "") -> str:
    return EXAMPLE.read_text().replace("bending_centre = 0.5 ", f"bending_course = {course}\n{centre}# ")


def test_a_course_of_the_bending_has_its_own_centre_and_is_squeezed_to_one_that_is_given(tmp_path: Path) -> None:
    """The centre follows from the middles 0.05 and 0.75 of the two bends. A written file gives the same model."""
    course = str([list(point) for point in COURSE])
    own = loaded(tmp_path, with_course(course))
    assert isinstance(own, TendonSheath)
    assert own.bending_course == COURSE
    assert own.bending_centre == pytest.approx(0.4)
    assert profile_of(own).points == COURSE
    given = loaded(tmp_path, with_course(course, "bending_centre = 0.2"))
    assert isinstance(given, TendonSheath)
    assert profile_of(given).centre == pytest.approx(0.2)
    save_model(given, tmp_path / "again.toml", template=EXAMPLE)
    assert bare(load_model(tmp_path / "again.toml")) == bare(given)


@pytest.mark.parametrize("end", [0.0, 1.0])
def test_all_bends_may_be_at_one_end(tmp_path: Path, end: float) -> None:
    """The compliance of the other end is 0. A course that bends at one end can be moved as well."""
    model = loaded(tmp_path, changed("bending_centre = 0.5 ", f"bending_centre = {end} "))
    assert isinstance(model, TendonSheath)
    assert compliances(model) == pytest.approx((0.5 * end / 50e3, 0.5 * (1.0 - end) / 50e3))
    course = "[[0.0, 1.0], [1.0, 1.0]]" if end == 0.0 else "[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]"
    for text, centre in (("", end), ("bending_centre = 0.4", 0.4)):
        bent = loaded(tmp_path, with_course(course, f"{text}\n"))
        assert isinstance(bent, TendonSheath)
        assert profile_of(bent).centre == pytest.approx(centre)
        save_model(bent, tmp_path / "again.toml", template=EXAMPLE)
        assert bare(load_model(tmp_path / "again.toml")) == bare(bent)


def test_derived_quantities() -> None:
    """x = mu Theta and k_t = 1/(l_us/EA + 1/k_s), so a spring as stiff as the tendon halves it."""
    assert ACTUATOR.friction_angle == pytest.approx(0.26)
    assert ACTUATOR.tendon_stiffness == pytest.approx(50e3)
    assert ACTUATOR.series_length == 0.0
    assert ACTUATOR.pretension_slope == pytest.approx(35.0)  # N/rad: 50 kN/m * 0.7 mm/rad
    assert dataclasses.replace(ACTUATOR, series_stiffness=50e3).pretension_slope == pytest.approx(17.5)


def test_place_of_the_series_spring(tmp_path: Path) -> None:
    """The default is the motor's end."""
    for line, at_joint in (("", False), ('series_position = "motor"\n', False), ('series_position = "joint"\n', True)):
        model = loaded(tmp_path, changed("[sheath]", f"series_stiffness = 2e4\n{line}[sheath]"))
        assert isinstance(model, TendonSheath)
        assert model.series_at_joint is at_joint


@pytest.mark.parametrize(
    ("key", "spring", "pretension"),
    [
        ("unstrained_bending_angle", "", 49.0),
        ("length_change", "", 45.0),
        ("length_change", "series_stiffness = 2e4", 12.857142857),
    ],
)
def test_the_pretension_may_follow_from_a_length(tmp_path: Path, key: str, spring: str, pretension: float) -> None:
    """It is 35 N/rad over 1.4 rad by (3.51) and (3.56), or 0.9 mm of the tensioner times the tendon's stiffness.

    By (3.56), EA/l_us is 50 N/mm, or 14.3 N/mm with a series spring of 20 N/mm. The file stores the pretension.
    """
    text = changed(f"# {key}", key).replace("value = 45.0", "# value")
    model = loaded(tmp_path, text.replace("[sheath]", f"{spring}\n[sheath]"))
    assert isinstance(model, TendonSheath)
    assert model.pretension == pytest.approx(pretension)
    assert "length_change =" not in dump_model(model, tmp_path / "model.toml").replace("# length_change =", "")


def with_effect(name: str, *lines: str) -> str:
    """Return the example file with this effect."""
    return "\n".join([EXAMPLE.read_text(encoding="utf-8"), f"[effects.{name}]", *lines, ""])


GEARED = '[actuator]\nkind = "geared_drive"\n'


WRONG = [
    (changed("diameter", "diametre"), r"tendon: unknown key 'diametre'; did you mean 'diameter'\?"),
    (
        changed("stiffness = 60e3", 'stiffness = "60e3"'),
        "tendon.axial_stiffness: expected a number above 0 N, found '60e3'; write a number in N",
    ),
    (changed("value = 45.0", "# value"), "no pretension; give"),
    (changed("# unstrained_bending_angle", "unstrained_bending_angle"), ".* are given; keep one"),
    (
        changed("# length_change", "length_change"),
        r"\[pretension\] value \(N\) and .*_change \(m\) are given",
    ),
    (
        changed("# length_change = 0.9e-3", "length_change = 9"),
        "length_change: .*from 0 to 0.5 m, found 9 .*millimetres",
    ),
    (changed("# series_position", "series_position"), "series_position needs series_stiffness; give series_stiff"),
    (
        changed("[sheath]", 'series_stiffness = 2e4\nseries_position = "middle"\n[sheath]'),
        "tendon.series_position: .*middle",
    ),
    (
        with_course("[[0.0, 0.0], [0.5, 0.6], [0.4, 1.0], [1.0, 1.0]]"),
        r"bending_course is \[\[0.*; give \[\[frac",
    ),
    (changed("bending_centre = 0.5 ", "bending_centre = 1.01 "), "bending_centre: .*from 0 to 1, found"),
    (with_effect("viscous_friction"), "key 'coefficient' is missing; give a number at least 0"),
    (with_effect("viscous_friction", "coefficient = -0.1"), "coefficient = -0.1; allowed is a number at least 0"),
    (with_effect("viscous_friction", "coeficient = 0.1"), "unknown key 'coeficient'; did you mean 'coefficient'"),
    (with_effect("load_dependent_friction", "coefficient = 1.0"), "below 1"),
    (with_effect("elongation_coupling", 'curvature_profile = "flat"'), 'allowed is "uniform" or "motor_end"'),
    (
        with_effect("elongation_coupling", "curvature_profile = [[0.0, 0.0], [0.5, 0.9]]"),
        r"\[\[0.0, 0.0\], \[0.5, 0.9\]\]; allowed is .* or \[\[fraction of length, fraction of bending\], ...\]",
    ),
    (
        with_effect("elongation_coupling", 'curvature_profile = "uniform"', "[effects.tendon_slack]"),
        "cannot be combined with .*tendon_slack",
    ),
    # effects of tendons have no meaning without tendons
    (f"{DRIVE}[effects.tendon_slack]\n", "has no meaning for a rigid_drive"),
    (f"{DRIVE}[effects.backlash]\ngap = 0.1\n", "has no meaning for a rigid_drive"),
    (GEARED, "ratio"),
    (f"{GEARED}ratio = -9.0\n", "ratio"),
    (f"{GEARED}ratio = 9.0\nefficiency = 90.0\n", "divide per cent by 100"),
    (f"{GEARED}ratio = 9.0\n[effects.tendon_slack]\n", "has no meaning for a geared_drive"),
    (f"{GEARED}ratio = 9.0\nstiffness = 1.0\n", "stiffness"),
    ('[actuator]\nkind = "gears"\n', "give one of tendon_sheath, rigid_drive, geared_drive"),
]


@pytest.mark.parametrize(("text", "message"), WRONG, ids=[message for _, message in WRONG])
def test_wrong_file_is_one_line(tmp_path: Path, text: str, message: str) -> None:
    """The message contains the place, the value and the allowed values. Those of effects are from the catalogue."""
    with pytest.raises(UsageError, match=message) as caught:
        loaded(tmp_path, text)
    assert "\n" not in str(caught.value)
    assert "model.toml" in str(caught.value)


PROFILE = [[0.0, 0.0], [0.3, 0.5], [0.7, 0.5], [1.0, 1.0]]
MODELS = {
    "effects with defaults and choices, and a series element": dataclasses.replace(
        ACTUATOR, series_stiffness=2e4
    ).with_effects(
        {
            "presliding_hysteresis": {"presliding_distance": 0.0313, "displacement": "joint"},
            "tension_dependent_friction": {"exponent": 0.1 + 0.2},
            "tendon_slack": {},
        }
    ),
    "points of the curvature profile and a spring at the joint": dataclasses.replace(
        ACTUATOR, series_stiffness=2e4, series_at_joint=True
    ).with_effects({"elongation_coupling": {"curvature_profile": PROFILE}}),
    "rigid drive with absent keys": RigidDrive(
        0.002, None, 0.01, -0.03, effects={"joint_stiffness": {"stiffness": 0.5, "rest_angle": 0.0}}
    ),
    "geared drive with absent keys": GearedDrive(
        9.0,
        0.9,
        None,
        0.05,
        effects={"torque_saturation": {"limit": 2.0}, "torque_sensor_lag": {"time_constant": 0.1}},
    ),
}


@pytest.mark.parametrize("model", MODELS.values(), ids=list(MODELS))
def test_written_model_is_the_same(tmp_path: Path, model: TendonSheath | RigidDrive) -> None:
    save_model(model, tmp_path / "out.toml", provenance={"logs": ["a.csv"], "rms": {"before": 0.1}})
    assert bare(load_model(tmp_path / "out.toml")) == model


def test_template_keeps_its_comments(tmp_path: Path) -> None:
    """Only changed values are replaced."""
    text = dump_model(ACTUATOR.recalibrated(pretension=47.5), template=EXAMPLE)
    assert "# m, p: tendon's contact line to the sheath's inner arc" in text
    assert "value = 47.5" in text
    reloaded = loaded(tmp_path, text)
    assert bare(reloaded) == ACTUATOR.recalibrated(pretension=47.5)


def test_recalibration_moves_friction_through_mu() -> None:
    """Theta is kept, because the theta column is compared with it."""
    model = ACTUATOR.recalibrated(friction_angle=0.52)
    assert (model.friction_coefficient, model.bending_angle) == pytest.approx((0.2, 2.6))


def test_straight_sheath_cannot_be_recalibrated_in_friction() -> None:
    """x is 0 for any mu."""
    with pytest.raises(UsageError, match="bending_angle is 0"):
        dataclasses.replace(ACTUATOR, bending_angle=0.0).recalibrated(friction_angle=0.1)


def test_reference_tension_stays_when_the_pretension_is_recalibrated() -> None:
    """It defaults to the file's pretension. Otherwise a new pretension would change the friction as well."""
    power = {"tension_dependent_friction": {"exponent": 0.2}}
    model = ACTUATOR.with_effects(power).recalibrated(pretension=60.0)
    assert model.effects["tension_dependent_friction"]["reference_tension"] == 45.0
    with pytest.raises(UsageError, match="give reference_tension"):  # a power of T/0 is undefined
        dataclasses.replace(ACTUATOR, pretension=0.0).with_effects(power)


def test_absent_parameters_of_a_rigid_drive_are_none(tmp_path: Path) -> None:
    """An absent parameter is not 0, because it can be a cause."""
    assert bare(loaded(tmp_path, DRIVE)) == RigidDrive(inertia=0.002, coulomb_friction=0.05)


def test_a_drive_is_rejected_where_a_controller_requires_tendons(tmp_path: Path) -> None:
    (tmp_path / "drive.toml").write_text(DRIVE, encoding="utf-8")
    with pytest.raises(UsageError, match="give a tendon-sheath model"):
        load_tendon_sheath(tmp_path / "drive.toml")
