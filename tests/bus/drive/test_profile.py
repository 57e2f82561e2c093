"""Test drive profiles and scale factors."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from tests.bus.nodes import axis_nodes
from tsa_ctrl.bus.canopen import objects
from tsa_ctrl.bus.drive.checks import cure
from tsa_ctrl.bus.drive.plan import drive_plan, interpolation_period
from tsa_ctrl.bus.drive.profile import DriveProfile, TorqueClamp, Units, drive_scale, load_profile
from tsa_ctrl.bus.settings import BusSettings, DriveSettings
from tsa_ctrl.errors import UsageError

CONFIG = Path(__file__).parents[3] / "config"
_OFFSET = "[[extra]]\nindex = {}\ntype = 'i16'\nvalue = 5\nname = 'mine'"
_EXTRA = "[[extra]]\nindex = 0x2100\ntype = '{}'\nvalue = {}\nname = 'mine'"
NAMES = sorted(path.stem for path in (CONFIG / "drives").glob("*.toml"))


@pytest.mark.parametrize("name", NAMES)
def test_every_profile_limits_the_drives_torque_and_speed_and_sets_the_mode(name: str) -> None:
    """It also lists its sources and their gaps."""
    profile, axis = load_profile(name, CONFIG), axis_nodes()
    assert profile.name
    assert profile.sources
    assert "\nunknown = [" in (CONFIG / "drives" / f"{name}.toml").read_text(encoding="utf-8")
    assert all(profile.unknown)
    scale = drive_scale(axis.drive, profile, "axis")
    plan = drive_plan(axis, profile, scale, BusSettings(), 0.001)
    instead = profile.torque_clamp
    clamp = objects.MAX_TORQUE.key if instead is None else (instead.index, instead.subindex)
    written = [write.entry for write in plan]
    assert [write.entry.key for write in plan].count(clamp) == 1
    assert (objects.MAX_MOTOR_SPEED in written) is profile.has(objects.MAX_MOTOR_SPEED)
    assert written[-1] is objects.MODE


@pytest.mark.parametrize(("share", "value"), [(0.0011, 32751), (0.5, 24577), (1.0, 16387), (2.0, 7)])
def test_a_clamp_that_counts_downwards_is_rounded_towards_no_torque(share: float, value: int) -> None:
    """Object 0x207F of an iPOS is 32767 minus the current, where 16380 digits are the rated current."""
    assert clamped(share, Units(torque=16380.0)) == [value]


def test_a_clamp_beyond_its_object_is_refused() -> None:
    with pytest.raises(UsageError, match=r"whose range is 0 to 65535; lower torque in \[axis.limits\]"):
        clamped(2.1, Units())


def clamped(max_torque: float, units: Units) -> list[int]:
    """Return the values that a bring-up writes to the torque clamp of an iPOS."""
    clamp = TorqueClamp(index=0x207F, type="u16", rated=32767 - 16380, zero=32767)
    profile = DriveProfile(absent=["max torque"], torque_clamp=clamp, units=units)
    axis = axis_nodes(max_torque=max_torque)
    plan = drive_plan(axis, profile, drive_scale(axis.drive, profile, "axis"), BusSettings(), 0.001)
    return [write.value for write in plan if write.entry.index == 0x207F]


def test_generic_file_says_what_is_assumed_without_one() -> None:
    file, default = load_profile("generic", CONFIG), DriveProfile()
    assert msgspec.structs.replace(file, name=default.name, sources=[]) == default


def test_unknown_profile_is_answered_with_the_known_ones() -> None:
    with pytest.raises(UsageError, match=r"no such drive profile 'epos5'; available: copley, elmo_gold, "):
        load_profile("epos5", CONFIG)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[torque_clamp]\nindex = 0x207F", "torque_clamp: give either rated_index"),
        ("[torque_clamp]\nindex = 0x207F\nrated = 1\nrated_index = 0x2000", "or rated (that value itself)"),
        ("absent = ['max torqe']", "absent: unknown object 'max torqe'; did you mean 'max torque'?"),
        (_OFFSET.format(0x60B2), "'mine' writes 5 to 0x60B2, which the drive adds to the command; allowed is 0"),
        (_OFFSET.format(0x70B1), "[[extra]] 'mine' writes 5 to 0x70B1"),
        (_EXTRA.format("u24", 1 << 24), "'mine': value 16777216 does not fit u24 (whole numbers from 0 to 16777215)"),
        (_EXTRA.format("f32", "inf"), "extra 'mine' value: found inf; give a finite number"),
        (_EXTRA.format("f32", 1e39), "'mine': value 1e+39 does not fit f32 (-3.40282e+38 to 3.40282e+38)"),
        ("absent = ['max torque']", "no object limits the drive's torque"),
        ("[units]\nvelocity = 'furlong'", "units.velocity: invalid enum value 'furlong'"),
        ("eds = 'none.eds'", "EDS file cannot be read"),
    ],
)
def test_profile_with_a_mistake_is_one_line(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "drives").mkdir()
    (tmp_path / "drives" / "mine.toml").write_text(text)
    with pytest.raises(UsageError) as error:
        load_profile("mine", tmp_path)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_clamps_never_exceed_what_is_configured() -> None:
    drive = DriveSettings(node_id=1, rated_torque=0.3, gear_ratio=4.0, max_torque=1.0, max_speed=10.0)
    scale = drive_scale(drive, DriveProfile(), "axis")
    assert scale.max_torque_digits == 833  # per mille of 1.2 N*m at the pulley
    assert scale.max_speed_digits == 381  # motor speed in rpm: 40 rad/s are 381.97 rpm


def test_torque_limit_beyond_the_object_is_refused() -> None:
    with pytest.raises(UsageError, match=r"allowed are 1 to 32767; correct limits\.torque or rated_torque"):
        drive_scale(DriveSettings(node_id=1, max_torque=50.0), DriveProfile(), "axis 'knee'")


@pytest.mark.parametrize(
    ("period", "mantissa", "exponent"),
    [(1e-3, 1, -3), (1.25e-3, 125, -5), (0.1, 100, -3), (0.5, 5, -1)],
)
def test_interpolation_period_as_the_drive_wants_it(period: float, mantissa: int, exponent: int) -> None:
    assert interpolation_period(period) == (mantissa, exponent)


@pytest.mark.parametrize("rate", [333.0, 3000.0])
def test_rate_that_the_drive_cannot_be_told_is_refused(rate: float) -> None:
    with pytest.raises(UsageError, match="choose a rate such as 1000"):
        interpolation_period(1.0 / rate)


@pytest.mark.parametrize(
    ("entry", "key"), [(objects.MAX_TORQUE, "torque in"), (objects.MAX_MOTOR_SPEED, "motor_over_speed in")]
)
def test_a_rejected_clamp_names_the_limit_that_determines_it(entry: objects.Object, key: str) -> None:
    assert f"correct {key} [axis.limits]" in cure(entry, DriveSettings(node_id=1), DriveProfile(), 0x06090030)
