"""Test plant.toml: defaults, and one-line errors."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.plant.bench import plant_file
from tsa_ctrl.errors import UsageError
from tsa_ctrl.plant import process
from tsa_ctrl.plant.settings import load_plant

ROOT = Path(__file__).resolve().parents[2]


def test_nodes_are_numbered_by_axis(tmp_path: Path) -> None:
    plant = load_plant(plant_file(tmp_path, "[[axis]]\nname='a'\n[[axis]]\nname='b'\n"))
    ids = [(axis.drive.node_id, axis.encoder.node_id, axis.torque_sensor.node_id) for axis in plant.axis]
    assert ids == [(1, 32, 64), (2, 33, 65)]


def test_the_example_is_valid() -> None:
    assert len(process.check(ROOT / "config" / "plant.toml").axis) == 1


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "axis"),
        ("[[axis]]\nname='a'\nspeed=1\n", "unknown key 'speed'"),
        ("[[axis]]\nname='a'\n[axis.motion]\nkind='file'\n", "without file"),
        ("[[axis]]\nname='a'\n[[axis]]\nname='a'\n", "two axes"),
        ("[[axis]]\nname='a'\n[axis.encoder]\nnode_id=1\n", "already"),
        ("[[axis]]\nname='a'\nactuator='gone.toml'\n", "no such file"),
        ("[[axis]]\nname='a'\n[axis.effects.stribek_friction]\n", "did you mean 'stribeck_friction'"),
        ("[[axis]]\nname='a'\n[axis.tendon]\ncurvature=[[0.0,0.0],[0.5,0.2]]\n", "that never decrease"),
        ("[[axis]]\nname='a'\njoint.load='limb'\njoint.hand=[[1,1,1,0],[0.5,1,1,0]]\n", "hand: times must increase"),
        (
            "[[axis]]\nname='a'\njoint.load='held'\njoint.hand=[[0,1,1,0]]\n",
            'hand cannot move a joint with load "held".*choose a load that moves',
        ),
        (
            "[[axis]]\nname='a'\ndrive.absent=[0x6040]\n",
            "plant.toml: axis 'a': .* the PDO 0x1400 contains 0x6040 at power-on; remove it from absent",
        ),
        (
            "[[axis]]\nname='a'\ndrive.objects={'0x6072:0'=70000}\n",
            "plant.toml: axis 'a': object 0x6072:0 is 70000 at power-on; allowed is 0 to 65535",
        ),
    ],
)
def test_a_mistake_is_one_line(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(UsageError, match=said) as raised:
        process.check(plant_file(tmp_path, text))
    assert "\n" not in str(raised.value)
