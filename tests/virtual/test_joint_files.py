"""A model file belongs to the joint that it was tuned on. Startup compares the serial numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import tomlkit

from tests.virtual.files import controller, merged, plant, write
from tsa_ctrl.config import load_configuration
from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.plant.process import check
from tsa_ctrl.virtual.simulation import Run

NODES = {"drive": {"serial_number": 4711, "node_id": 1}, "encoder": {"serial_number": 815, "node_id": 32}}
PLANT = {"drive": {"serial_number": 4711}, "encoder": {"serial_number": 815}}


def tuned(path: Path, **provenance: Any) -> None:
    """Write this `[provenance]` to a model file."""
    document = tomlkit.parse(path.read_text(encoding="utf-8"))
    document["provenance"] = provenance
    path.write_text(tomlkit.dumps(document), encoding="utf-8")


def trusted(
    folder: Path, provenance: dict[str, Any], nodes: dict[str, Any] = PLANT, axis: dict[str, Any] | None = None
) -> bool:
    """Return True if the axis' file is trusted after the bring-up with these nodes."""
    paths = write(folder, controller(**(axis or {})), plant(**nodes))
    if provenance:
        tuned(folder / "actuator.toml", **provenance)
    run = Run(load_configuration(paths[0]), check(paths[1]), 0.1)
    assert not run.axes[0].trusted
    try:
        run.play([], [], lambda share: None)
        return run.axes[0].trusted
    finally:
        run.close()


@pytest.mark.parametrize("source", ["measured", "simulated"])
def test_a_tuning_of_these_very_nodes_is_trusted(tmp_path: Path, source: str) -> None:
    assert trusted(tmp_path, {"source": source, **NODES})


def test_a_node_with_a_serial_number_may_get_another_node_id(tmp_path: Path) -> None:
    moved = {"drive": {"serial_number": 4711, "node_id": 9}, "encoder": {"serial_number": 815, "node_id": 40}}
    assert trusted(tmp_path, {"source": "measured", **moved})


@pytest.mark.parametrize(
    "provenance",
    [
        {},
        {"source": "measured"},
        {"source": "logs", **NODES},
        {**NODES},
        {"source": "measured", "drive": NODES["drive"]},
    ],
    ids=["none", "no-nodes", "from-logs", "no-source", "no-encoder"],
)
def test_any_other_file_loads_and_is_not_trusted(tmp_path: Path, provenance: dict[str, Any]) -> None:
    assert not trusted(tmp_path, provenance)


def test_a_file_with_an_encoder_is_not_trusted_without_it(tmp_path: Path) -> None:
    assert not trusted(tmp_path, {"source": "measured", **NODES}, axis={"encoder": None})


@pytest.mark.parametrize(("node", "role"), [("drive", "drive"), ("encoder", "joint encoder")], ids=["drive", "encoder"])
def test_a_file_of_another_serial_number_is_rejected_with_both_numbers_and_the_remedy(
    tmp_path: Path, node: str, role: str
) -> None:
    nodes = merged(PLANT, {node: {"serial_number": 23}})
    tuned_on = NODES[node]["serial_number"]
    with pytest.raises(
        UsageError, match=rf"actuator.toml was .* its {role} has serial number {tuned_on}, found .* 23 at .*tsa tune"
    ) as error:
        trusted(tmp_path, {"source": "measured", **NODES}, nodes)
    assert "\n" not in str(error.value)


def test_nothing_was_written_to_the_nodes_of_another_joint(tmp_path: Path) -> None:
    paths = write(tmp_path, controller(), plant(drive={"serial_number": 23}))
    tuned(tmp_path / "actuator.toml", source="measured", **NODES)
    run = Run(load_configuration(paths[0]), check(paths[1]), 0.1)
    with pytest.raises(UsageError):
        run.play([], [], lambda share: None)
    drive = run.machine.axes[0].drive
    assert drive.node.values[0x6060, 0] == 0
    run.close()


def test_a_drive_without_serial_number_is_identified_by_its_node_id_and_not_trusted(tmp_path: Path) -> None:
    nameless = merged(PLANT, {"drive": {"serial_number": None, "absent": ["0x1018:4"]}})
    nodes = merged(NODES, {"drive": {"serial_number": 0}})
    assert not trusted(tmp_path, {"source": "measured", **nodes}, nameless)
    other = merged(nodes, {"drive": {"node_id": 2}})
    with pytest.raises(UsageError, match=r"node 2 \(no serial number\), found node 1"):
        trusted(tmp_path, {"source": "measured", **other}, nameless)


@pytest.mark.parametrize("number", [0, None], ids=["zero", "absent"])
def test_a_drive_that_has_no_serial_number_is_not_the_one_of_a_file_with_one(
    tmp_path: Path, number: int | None
) -> None:
    drive = {"serial_number": 0} if number == 0 else {"absent": ["0x1018:4"]}
    with pytest.raises(UsageError, match="serial number 4711, found no serial number"):
        trusted(tmp_path, {"source": "measured", **NODES}, merged(PLANT, {"drive": drive}))


def test_the_file_of_axis_2_is_rejected_at_axis_1_of_one_device(tmp_path: Path) -> None:
    second = merged(NODES, {"drive": {"slot": 2}})
    with pytest.raises(UsageError, match="slot 2 of serial number 4711, found slot 1"):
        trusted(tmp_path, {"source": "measured", **second})


@pytest.mark.parametrize(
    "wrong",
    [{"source": "guessed"}, {"drive": {"serial_number": "x", "node_id": 1}}, {"drive": {"serial": 1, "node_id": 1}}],
    ids=["source", "type", "key"],
)
def test_a_wrong_provenance_is_one_line_with_its_place(tmp_path: Path, wrong: dict[str, Any]) -> None:
    with pytest.raises((UsageError, BusError), match=r"actuator.toml: \[provenance") as error:
        trusted(tmp_path, wrong)
    assert "\n" not in str(error.value)
