"""A model file belongs to the joint that it was tuned on. Startup compares the serial numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.virtual.files import controller, merged, plant, write, write_provenance
from tsa_ctrl.config import load_configuration
from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.plant.process import check
from tsa_ctrl.virtual.simulation import Run

NODES = {"drive": {"serial_number": 4711, "node_id": 1}, "encoder": {"serial_number": 815, "node_id": 32}}
PLANT = {"drive": {"serial_number": 4711}, "encoder": {"serial_number": 815}}


def trusted(
    folder: Path, provenance: dict[str, Any], nodes: dict[str, Any] = PLANT, axis: dict[str, Any] | None = None
) -> bool:
    """Return True if the axis' file is trusted after the bring-up with these nodes. A rejected drive is not written."""
    paths = write(folder, controller(**(axis or {})), plant(**nodes))
    if provenance:
        write_provenance(folder / "actuator.toml", **provenance)
    run = Run(load_configuration(paths[0]), check(paths[1]), 0.1)
    assert not run.axes[0].trusted
    try:
        run.play([], [], lambda share: None)
        return run.axes[0].trusted
    except UsageError:
        assert run.machine.axes[0].drive.node.values[0x6060, 0] == 0
        raise
    finally:
        run.close()


MOVED = {"drive": {"serial_number": 4711, "node_id": 9}, "encoder": {"serial_number": 815, "node_id": 40}}
NAMELESS = merged(PLANT, {"drive": {"serial_number": None, "absent": ["0x1018:4"]}})  # a drive without serial number
BY_NODE = merged(NODES, {"drive": {"serial_number": 0}})


@pytest.mark.parametrize(
    ("provenance", "expected"),
    [
        ({"source": "measured", **NODES}, True),
        ({"source": "simulated", **NODES}, True),
        ({"source": "measured", **MOVED}, True),  # a node with a serial number may get another node id
        ({}, False),
        ({"source": "measured"}, False),
        ({"source": "logs", **NODES}, False),
        ({**NODES}, False),
        ({"source": "measured", "drive": NODES["drive"]}, False),
    ],
    ids=["measured", "simulated", "moved", "none", "no-nodes", "from-logs", "no-source", "no-encoder"],
)
def test_only_a_tuning_of_these_very_nodes_is_trusted(
    tmp_path: Path, provenance: dict[str, Any], expected: bool
) -> None:
    assert trusted(tmp_path, provenance) is expected


def test_a_missing_encoder_or_serial_number_costs_the_trust(tmp_path: Path) -> None:
    assert not trusted(tmp_path, {"source": "measured", **NODES}, axis={"encoder": None})
    assert not trusted(tmp_path, {"source": "measured", **BY_NODE}, NAMELESS)


@pytest.mark.parametrize(
    ("nodes", "plant_nodes", "words"),
    [
        (
            NODES,
            merged(PLANT, {"drive": {"serial_number": 23}}),
            r"actuator.toml was .* its drive has serial number 4711, found .* 23 at .*tsa tune",
        ),
        (
            NODES,
            merged(PLANT, {"encoder": {"serial_number": 23}}),
            r"actuator.toml was .* its joint encoder has serial number 815, found .* 23 at .*tsa tune",
        ),
        (
            NODES,
            merged(PLANT, {"drive": {"serial_number": 0}}),
            "serial number 4711, found no serial number",
        ),
        (NODES, NAMELESS, "serial number 4711, found no serial number"),
        (merged(BY_NODE, {"drive": {"node_id": 2}}), NAMELESS, r"node 2 \(no serial number\), found node 1"),
        (merged(NODES, {"drive": {"slot": 2}}), PLANT, "slot 2 of serial number 4711, found slot 1"),
        ({"source": "guessed"}, PLANT, r"actuator.toml: \[provenance"),
        ({"drive": {"serial_number": "x", "node_id": 1}}, PLANT, r"actuator.toml: \[provenance"),
        ({"drive": {"serial": 1, "node_id": 1}}, PLANT, r"actuator.toml: \[provenance"),
    ],
)
def test_a_file_of_another_joint_is_rejected_in_one_line_before_anything_is_written(
    tmp_path: Path, nodes: dict[str, Any], plant_nodes: dict[str, Any], words: str
) -> None:
    with pytest.raises((UsageError, BusError), match=words) as error:
        trusted(tmp_path, {"source": "measured", **nodes}, plant_nodes)
    assert "\n" not in str(error.value)
