"""Test the usable sections of a run on a machine that stalls occasionally."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.virtual.files import write
from tsa_ctrl.config import load_configuration
from tsa_ctrl.errors import BusError
from tsa_ctrl.model.provenance import NodeIdentity, Origin, with_origin
from tsa_ctrl.tune.excitation import Bounds, Waveform
from tsa_ctrl.tune.procedure import PHASES, phase
from tsa_ctrl.tune.run import SHORTEST_PIECE, RigRunner, Run, _pieces

PERIOD = 1e-3  # s


def columns(t: np.ndarray) -> dict[str, np.ndarray]:
    angle = 2.0 * np.pi * 0.5 * t
    return {"t": t, "tau_m": np.sin(angle), "tau_j": np.sin(angle), "omega_j": np.cos(angle)}


def test_a_long_gap_parts_a_run_and_short_ends_are_left_out() -> None:
    t = np.concatenate([PERIOD * np.arange(4000), 4.5 + PERIOD * np.arange(3000), 8.0 + PERIOD * np.arange(500)])
    pieces = _pieces(columns(t), "run", "hash")
    assert [len(piece) for piece in pieces] == [4000, 3000]
    assert [piece.name for piece in pieces] == ["run-1", "run-2"]
    assert SHORTEST_PIECE > 500 * PERIOD


def test_a_stretch_with_so_many_missing_cycles_that_it_is_on_no_grid_is_left_out() -> None:
    sparse = 2.0 * PERIOD * np.arange(1500)  # every other cycle at first, and then all cycles
    t = np.concatenate([sparse, sparse[-1] + PERIOD * np.arange(1, 900), 6.0 + PERIOD * np.arange(3000)])
    (piece,) = _pieces(columns(t), "run", "hash")
    assert len(piece) == 3000


def test_a_file_of_another_joint_is_played_as_one_of_the_joint_that_is_tuned(tmp_path: Path) -> None:
    """The runs of a tuning have no friction term until the excitation has determined the friction."""
    controller, _ = write(tmp_path)
    path = tmp_path / "actuator.toml"
    other = Origin("measured", {"drive": NodeIdentity(serial_number=4711, node_id=1)})
    path.write_text(with_origin(path.read_text(), other))
    configuration = load_configuration(controller)
    played: list[Origin] = []

    def run(folder: Path, name: str, seconds: float, tick: object) -> dict[str, Any]:
        copy = load_configuration(folder / f"controller-{name}.toml").models[0]
        played.append(copy.origin)
        raise BusError("not here")

    (axis,) = configuration.file.axes
    runner = RigRunner(configuration, axis, Bounds(0.5, 5.0, None), tmp_path, run)
    this = Origin("measured", {"drive": NodeIdentity(serial_number=17, node_id=1)})
    for runner.origin in (Origin(), this):
        with pytest.raises(BusError):
            runner.play("before", path, 0.0, Waveform(np.arange(3.0), np.zeros(3)), lambda share: None)
    assert played == [Origin(), this]


@pytest.mark.parametrize(("off", "expected"), [(0.0, 0.0), (0.02, 0.02), (float("nan"), float("inf"))])
def test_sensor_and_elongation_are_compared_after_the_tendons_have_slid(off: float, expected: float) -> None:
    """The first half of a run does not count, because the tendons may not have slid yet."""
    t = PERIOD * np.arange(2000)
    delivered = np.sin(t)
    other = delivered + np.where(t < 1.0, 1.0, off)
    assert Run("after", Path(), t, delivered, delivered, (), other).disagreement() == pytest.approx(expected)
    assert Run("after", Path(), t, delivered, delivered, ()).disagreement() == float("inf")


def test_each_phase_says_its_place() -> None:
    assert phase("probe-2") == f"phase 1 of {len(PHASES)}: probe-2"
    assert [phase(name).split()[1] for name in PHASES] == [str(1 + n) for n in range(len(PHASES))]
