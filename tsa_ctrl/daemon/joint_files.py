"""Check that model files belong to their joints: compare the nodes on the bus with the nodes of each tuning.

A file of another joint is rejected before anything is written to a node. A file is trusted if it was written by a
tuning of this joint: the serial numbers of drive and encoder match, and the numbers were measured. A file that is not
trusted is reported at startup, and has the smaller energy credit of `control.compensation_limit` until motion confirms
its friction.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

from tsa_ctrl.bus.settings import AxisNodes, EncoderSettings, Role
from tsa_ctrl.bus.wire.link import is_simulated
from tsa_ctrl.config import Configuration
from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.provenance import NODES, NodeIdentity

REMEDY = "give the model file of this joint, or tune this joint again (tsa tune)"


def nodes_simulated(configuration: Configuration) -> bool:
    """Return True if no real drive can be on any bus of the configuration."""
    return all(is_simulated(bus.interface, bus.channel) for bus in configuration.file.buses)


def admitted(configuration: Configuration, allow_simulated: bool) -> Configuration:
    """Return the configuration for a run on its bus. On hardware, simulated numbers do not count as calibrated.

    Raises:
        UsageError: a simulated model file is used on hardware, and `allow_simulated` is False.
    """
    simulated = [
        (axis, model)
        for axis, model in zip(configuration.file.axes, configuration.models, strict=True)
        if model.origin.source == "simulated"
    ]
    if not simulated or nodes_simulated(configuration):
        return configuration
    if not allow_simulated:
        axis, model = simulated[0]
        raise UsageError(
            f"{model.source}: axis '{axis.name}': the numbers are simulated ([provenance] source), and "
            f"{configuration.file.channels} is a bus with real drives; run tsa tune on this joint, or add "
            "--allow-simulated"
        )
    models = tuple(
        dataclasses.replace(model, half_loop_low=None) if model.origin.source == "simulated" else model
        for model in configuration.models
    )
    return dataclasses.replace(configuration, models=models)


class JointFiles:
    """Compare the model files of a configuration with the nodes that a bring-up found."""

    def __init__(self, configuration: Configuration, simulated: bool) -> None:
        """`simulated` is True if the nodes are simulated; then files tuned on simulated nodes are accepted."""
        axes = zip(configuration.file.axes, configuration.models, strict=True)
        self._models = {axis.name: model for axis, model in axes}
        self._accepted = {"measured", "simulated"} if simulated else {"measured"}
        self._found: dict[str, dict[str, NodeIdentity]] = {name: {} for name in self._models}

    def identify(self, axis: AxisNodes, role: Role, serial_number: int | None) -> None:
        """Compare one node with the axis' model file.

        Args:
            axis: the nodes of the axis.
            role: role of the node in the axis.
            serial_number: 0x1018:4; None or 0 for a node without one.

        Raises:
            UsageError: the file was tuned on another node.
        """
        if role.key not in NODES:
            return
        node = axis.drive if role is Role.DRIVE else axis.encoder
        assert node is not None
        slot = 1 if isinstance(node, EncoderSettings) else node.slot
        found = NodeIdentity(serial_number=serial_number or 0, node_id=node.node_id, slot=slot)
        self._found[axis.name][role.key] = found
        model = self._models[axis.name]
        tuned = model.origin.nodes.get(role.key)
        difference = "" if tuned is None else tuned.difference(found)
        if difference:
            raise UsageError(
                f"axis '{axis.name}': {model.source} was tuned on another joint: its {role.value} has {difference} at "
                f"node {node.node_id} (0x1018:4); {REMEDY}"
            )

    def trusted(self, axis: str) -> bool:
        """Return True if the axis' model file was written by a tuning of this joint."""
        return not self.doubt(axis)

    def doubt(self, axis: str) -> str:
        """Return the reason why the axis' model file is not trusted, or an empty text if it is."""
        origin, found = self._models[axis].origin, self._found[axis]
        if not found:
            return "the serial numbers were not read"
        if origin.source not in self._accepted:
            stated = origin.source or "not stated"
            return f"its numbers were not measured on this joint by tsa tune ([provenance] source: {stated})"
        missing = [name for name in NODES if (name in found) is not (name in origin.nodes)]
        if missing:
            where = "the file" if missing[0] in found else "the controller file"
            return f"{where} has no {missing[0]} to compare"
        nameless = [f"{name} (node {node.node_id})" for name, node in found.items() if not node.serial_number]
        if nameless:
            return f"{' and '.join(nameless)} has no serial number (0x1018:4) and is identified by its node id alone"
        return ""

    def notes(self) -> list[str]:
        """Return one line for each file that is not trusted."""
        return [
            f"axis '{name}': {model.source} is not trusted: {doubt}; run tsa tune on this joint"
            for name, model in self._models.items()
            if (doubt := self.doubt(name))
        ]

    @property
    def nodes(self) -> Mapping[str, Mapping[str, NodeIdentity]]:
        """Return the nodes that were found, by axis and node."""
        return self._found
