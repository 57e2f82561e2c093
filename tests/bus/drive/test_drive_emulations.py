"""Each drive emulated by the plant completes the bring-up only with its own profile."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.plant.bench import Bench
from tsa_ctrl.bus.drive.profile import drive_scale, load_profile
from tsa_ctrl.bus.settings import DriveSettings

CONFIG = Path(__file__).resolve().parents[3] / "config"
KINDS = ("generic", "epos4", "elmo_gold", "technosoft_ipos", "kinco", "nanotec", "copley")


def bench(folder: Path, kind: str) -> Bench:
    made = Bench(folder, f"[[axis]]\nname = 'joint'\ndrive.kind = '{kind}'\ndrive.torque_noise = 0.0\n")
    made.set_up()
    return made


def test_epos4_limits_by_current_and_takes_its_units_only_while_it_is_off(tmp_path: Path) -> None:
    made = bench(tmp_path, "epos4")
    assert made.upload(1, 0x6076, 0, "I") == 1_000_000  # uN*m
    assert made.download(1, 0x6076, 0, "I", 5) == 0x06010002
    assert made.download(1, 0x6072, 0, "H", 500) == 0x06020000
    assert made.download(1, 0x1400, 5, "H", 20) == 0x06090011
    assert made.download(1, 0x60C2, 2, "b", -4) == 0x06090030
    assert made.download(1, 0x605A, 0, "h", 0) == 0x06090030
    assert made.download(1, 0x60A9, 0, "I", 0x00B44800) == 0x06090030
    assert made.download(1, 0x60A9, 0, "I", 0xFDB44700) == 0
    assert made.download(1, 0x3001, 2, "I", 2500) == 0
    made.enable(900)
    made.sync(20)
    assert made.unit.axis.command.torque == pytest.approx(0.5)
    assert made.download(1, 0x60A9, 0, "I", 0x00B44700) == 0x08000022


@pytest.mark.parametrize("kind", KINDS)
def test_torque_and_speed_are_those_of_the_motor_in_every_makers_units(tmp_path: Path, kind: str) -> None:
    """Half the rated torque and one revolution per second are converted to drive units and back with the profile."""
    made = bench(tmp_path, kind)
    profile = load_profile(kind, CONFIG)
    scale = drive_scale(DriveSettings(node_id=1, max_torque=1.0), profile, "here")
    assert made.download(1, 0x60A9, 0, "I", profile.units.velocity.si_code or 0) in (0, 0x06020000)
    made.enable(round(0.5 / scale.torque))
    made.sync(50, made.command(0x0F, round(0.5 / scale.torque)))
    drive = made.unit.drive
    assert drive.command.torque == pytest.approx(0.5, rel=1e-3)
    assert drive.values[0x6077, 0] * scale.torque == pytest.approx(0.5, rel=1e-2)
    drive.readings.motor_speed = 6.283185307179586
    drive.sample()
    assert drive.values[0x606C, 0] * scale.velocity == pytest.approx(6.283185307179586, rel=1e-3)
