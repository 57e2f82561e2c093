"""Test the controller's configuration: the example is valid, and each mistake gives a one-line error."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

from tsa_ctrl.cli import cli
from tsa_ctrl.config import load_configuration
from tsa_ctrl.daemon.build import bound_for, describe, joint_torque_of
from tsa_ctrl.errors import UsageError

CONFIG = Path(__file__).resolve().parents[2] / "config"
SECOND_AXIS = """
[[axis]]
name = "{name}"
model = "actuator.toml"
[axis.drive]
node_id = {drive}
max_torque = 3.0
[axis.encoder]
node_id = {encoder}
[axis.limits]
torque = 2.0
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with a copy of the example configuration."""
    for name in ("controller.toml", "actuator.toml"):
        shutil.copy(CONFIG / name, tmp_path)
    return tmp_path


ENCODER = r"^\[axis.encoder\][^\n]*\nnode_id = 32\ncounts_per_revolution[^\n]*\n"
SENSOR = r"^\[axis.torque_sensor\][^\n]*\n[^\n]*\nnode_id = 64\n"


def edit(folder: Path, pattern: str, text: str) -> Path:
    path = folder / "controller.toml"
    before = path.read_text(encoding="utf-8")
    after = re.sub(pattern, text.replace("\\", "\\\\"), before, count=1, flags=re.MULTILINE)
    assert after != before, f"the example has no {pattern}"
    path.write_text(after, encoding="utf-8")
    return path


def test_example_is_good(folder: Path) -> None:
    """The example contains one axis at 1 kHz, whose bus load is between 40 and 70 %. The check reports both."""
    configuration = load_configuration(folder / "controller.toml")
    assert [axis.name for axis in configuration.file.axes] == ["knee"]
    assert configuration.period == pytest.approx(1e-3)
    assert 0.4 < configuration.load.least < configuration.load.worst < 0.7
    result = CliRunner().invoke(cli, ["run", "--check", str(folder / "controller.toml")])
    assert result.exit_code == 0
    assert "knee at 1000 Hz, bus load" in result.output


def test_every_commented_default_is_the_default(folder: Path) -> None:
    """Uncommenting the defaults of the example changes nothing. The keys in the pattern are skipped."""
    path = folder / "controller.toml"
    before = load_configuration(path).file
    lines = []
    for line in path.read_text(encoding="utf-8").splitlines():
        default = re.match(r"# (\w+ = .+|\[bus\.supervision\])", line)
        keep = default is None or re.match(
            r"# (cpu|options|group|watch_group|eds|vendor_id|product_code|serial_number|pdo_node_id|boot_timeout"
            r"|answer_timeout|polarity|distance|travel|offset = 2|gains|components|file =|file_age|folder_size"
            r"|enabled = false|output|wearer_speed|emergency_stop|zero_torque_within"
            r"|torque|joint_torque|slip|motor_inertia|delay|turn|lead|ringing|damping) ?=?",
            line,
        )
        lines.append(line if keep or default is None else default.group(1))
    path.write_text("\n".join(lines), encoding="utf-8")
    assert load_configuration(path).file == before


MISTAKES = [
    (r"^rate = 1000.0", "rat = 1000.0", "unknown key 'rat'; did you mean 'rate'"),
    (r"^rate = 1000.0", "rate = 2000.0", r"bitrate 1000000: 2000 Hz.*needs .* %"),
    (r"^node_id = 32", "node_id = 1", r"axis 'knee' encoder: node_id 1 is also used by axis 'knee' drive"),
    (r"^node_id = 64", "node_id = 127", r"node_id 127 is also used by \[bus\] host_node_id"),
    (r"^torque = 2.0", "torque = 3.5", "limits.torque 3.5 N.m is above the drive's own clamp of 3"),
    (r"^torque = 2.0", "torque = nan", "limits.torque"),
    (r"^torque = 2.0", "torque_share = 12.0", r"limits.torque_share: .* at most 10, found 12"),
    (r"^torque = 2.0", "torque_share = 5.0", r"limits.torque_share 5, .* is above the drive's own clamp of 3"),
    (r'^model = "actuator.toml"', 'model = "none.toml"', "none.toml: no such file"),
    (r'^kind = "sine"', 'kind = "file"', 'kind "file" with file ""'),
    (r'^kind = "sine"', 'kind = "file"\nfile = "none.csv"', "none.csv"),
    (r"^\[axis.law\]", "[axis.law]\nmotor_inertia = 1e-4\ndamping = 0.5\n#", r"law.damping 0.5 .* gain margin of"),
    (r"^# over_speed = 12.0 ", "over_speed = 9.0 ", "over_speed 9 rad/s is not above joint_speed"),
    (r"^# max_speed = 20.0 ", "max_speed = 15.0 ", "motor_over_speed 20 rad/s is above drive.max_speed 15 rad/s"),
    (r"^# rpdo_timeout = 0.02 ", "rpdo_timeout = 0.001 ", "rpdo_timeout 0.001 s is less than two periods"),
    (r'^# kind = "sensor" ', 'kind = "map" ', 'kind "map" needs the source'),
    (r"^\[axis.bending\]", '[axis.bending]\nsource = "joints"', "gains .* belong to"),
    (r'^channel = "vcan0"', r'channel = "can\u0000"', "bus.channel"),
    (r'^name = "knee"', 'name = "the knee"', "name"),
    (r'^# profile = "generic"', 'profile = "epos9"', "no such drive profile 'epos9'"),
    (r"^rate = 1000.0", "rate = 933.3", "cannot be written to the drive .* choose a rate such as"),
    (r"^# host_timeout = 0.1 ", "host_timeout = 0.03 ", "host_timeout 0.03 s is shorter than two heartbeat"),
]


@pytest.mark.parametrize(("pattern", "text", "words"), MISTAKES)
def test_wrong_is_one_line_and_exit_code_2(folder: Path, pattern: str, text: str, words: str) -> None:
    """`tsa run --check` rejects each mistake with a one-line error and exit code 2, without a drive."""
    result = CliRunner().invoke(cli, ["run", "--check", str(edit(folder, pattern, text))])
    assert isinstance(result.exception, UsageError)
    assert re.search(words, str(result.exception))
    assert "\n" not in str(result.exception)
    assert result.exception.exit_code == 2


def test_what_no_drive_can_be_told_is_found_by_the_doctor_too(folder: Path) -> None:
    result = CliRunner().invoke(cli, ["doctor", str(edit(folder, *MISTAKES[-1][:2]))])
    assert isinstance(result.exception, UsageError)
    assert re.search(f"controller.toml: .*{MISTAKES[-1][2]}", str(result.exception))


def second(folder: Path, name: str, drive: int, encoder: int) -> Path:
    """Append an axis to the controller's file, and return its path."""
    path = folder / "controller.toml"
    with path.open("a", encoding="utf-8") as file:
        file.write(SECOND_AXIS.format(name=name, drive=drive, encoder=encoder))
    return path


@pytest.mark.parametrize(
    ("name", "drive", "words"),
    [
        ("knee", 2, "2 axes are named 'knee'"),
        ("hip", 1, "axis 'hip' drive: node_id 1 is also used by axis 'knee' drive"),
    ],
)
def test_axes_do_not_share(folder: Path, name: str, drive: int, words: str) -> None:
    """Two axes with the same name or the same node id are rejected."""
    with pytest.raises(UsageError, match=words):
        load_configuration(second(folder, name, drive, 33))


def test_four_axes_fit_a_bus_at_a_lower_rate(folder: Path) -> None:
    """Four axes at 1 kHz are rejected with the highest possible rate. At that rate they are accepted."""
    for n, name in enumerate(("hip", "ankle", "toe"), start=2):
        path = second(folder, name, n, 31 + n)
    with pytest.raises(UsageError) as caught:
        load_configuration(path)
    highest = re.search(r"at most (\d+) Hz", str(caught.value))
    assert highest is not None
    edit(folder, r"^rate = 1000.0", f"rate = {highest.group(1)}")
    assert len(load_configuration(path).models) == 4


@pytest.mark.parametrize(
    ("kind", "missing", "words"),
    [
        ("sensor", r"^\[axis.torque_sensor\][^\n]*\n(?: +#[^\n]*\n)*node_id = 64", r"without \[axis.torque_sensor\]"),
        ("stretch", ENCODER, r"without \[axis.encoder\]"),
    ],
)
def test_an_estimator_needs_its_sensors(folder: Path, kind: str, missing: str, words: str) -> None:
    edit(folder, r'^# kind = "sensor" ', f'kind = "{kind}" ')
    with pytest.raises(UsageError, match=words):
        load_configuration(edit(folder, missing, ""))


def test_sensor_estimator_needs_the_temperature_of_the_models_formula(folder: Path) -> None:
    """The estimator kind "sensor" is rejected, and not selected, if a formula needs an unmeasured temperature."""
    with (folder / "actuator.toml").open("a") as model:
        model.write('\n[effects.custom]\nexpression = "0.01*(temperature - 25)*omega_j"\n')
    selected = load_configuration(folder / "controller.toml").file.axes[0].estimator
    assert selected.kind == "stretch"
    path = edit(folder, r'^# kind = "sensor" ', 'kind = "sensor"\nuse = true ')
    with pytest.raises(UsageError, match=r"custom depends on the temperature.*\[axis.temperature\] a source"):
        load_configuration(path)


def test_stretch_estimator_needs_a_sheath_that_bends_away_from_the_joint(folder: Path) -> None:
    path = edit(folder, r'^# kind = "sensor" ', 'kind = "stretch" ')
    with (folder / "actuator.toml").open("a") as model:
        model.write('\n[effects.elongation_coupling]\ncurvature_profile = "joint_end"\n')
    with pytest.raises(UsageError, match="all bends are at the joint"):
        load_configuration(path)


@pytest.mark.parametrize(
    ("model", "axes", "told"),
    [
        ("", (), "sensor, in use"),
        ("", (SENSOR,), "stretch, in use"),
        (
            r"^bending_centre",
            (SENSOR,),
            r"fixed \(.*does not state where the sheath bends; give \[sheath\] bending_centre",
        ),
        ("", (ENCODER, SENSOR), r"fixed \(.*needs an \[axis.encoder\]"),
    ],
    ids=["default", "stretch", "shape", "encoder"],
)
def test_the_default_estimator_and_what_stands_against_it_are_told(
    folder: Path, model: str, axes: tuple[str, ...], told: str
) -> None:
    """The status shows the estimator. If it is "fixed", the status shows the reason and a note reports it."""
    path = folder / "controller.toml"
    if model:
        text = (folder / "actuator.toml").read_text()
        (folder / "actuator.toml").write_text(re.sub(model, "# bending_centre", text, flags=re.MULTILINE))
    for axis in axes:
        edit(folder, axis, "")
    configuration = load_configuration(path)
    (found,) = describe(configuration, []).estimators
    assert re.fullmatch(f"{told}.*", found)
    notes = bound_for(
        configuration.file.axes[0],
        configuration.models[0],
        joint_torque_of(configuration.file.axes[0], configuration.models[0], 0.0, 1e-3),
        configuration.estimators[0],
    ).notes
    assert any("estimator fixed" in note for note in notes) is told.startswith("fixed")


def test_check_compares_the_plan_with_the_eds(folder: Path) -> None:
    """`tsa run --check` rejects a value outside the limits of the EDS without a connected drive."""
    (folder / "drives").mkdir(exist_ok=True)
    (folder / "drives" / "mine.toml").write_text('eds = "mine.eds"\n', encoding="utf-8")
    (folder / "drives" / "mine.eds").write_text(
        "[6072]\nParameterName=Max torque\nDataType=0x0006\nAccessType=rw\nLowLimit=0\nHighLimit=500\n",
        encoding="utf-8",
    )
    path = edit(folder, r'^# profile = "generic"', 'profile = "mine"')
    result = CliRunner().invoke(cli, ["run", "--check", str(path)])
    assert isinstance(result.exception, UsageError)
    assert "mine.eds: section [6072]: 0x6072:0 max torque must be 2000, but the EDS allows 0 to 500" in str(
        result.exception
    )
