"""Read and write the `[provenance]` table of a model file: the source of its numbers, and the measured joint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import msgspec
import tomlkit
from msgspec import Meta

from tsa_ctrl import settings

Source = Literal["measured", "simulated", "logs", ""]
NODES = ("drive", "encoder")  # the nodes that identify a joint, by their tables in [provenance]


class NodeIdentity(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Identify one node of a joint by its serial number, or by its node id if it has no serial number."""

    serial_number: Annotated[int, Meta(ge=0, le=0xFFFFFFFF)] = 0  # 0x1018:4; 0: the node has none
    node_id: Annotated[int, Meta(ge=1, le=127)]
    slot: Annotated[int, Meta(ge=1, le=8)] = 1  # axis within a device of several axes

    def difference(self, found: NodeIdentity) -> str:
        """Return how `found` differs from this node, with both numbers; return "" for the same node."""
        if self.serial_number != found.serial_number:
            return f"{self._serial()}, found {found._serial()}"
        if self.slot != found.slot:
            return f"slot {self.slot} of {self._serial()}, found slot {found.slot}"
        if not self.serial_number and self.node_id != found.node_id:
            return f"node {self.node_id} ({self._serial()}), found node {found.node_id}"
        return ""

    def _serial(self) -> str:
        return f"serial number {self.serial_number}" if self.serial_number else "no serial number"


@dataclass(frozen=True)
class Origin:
    """Hold the source of a model file's numbers, and the nodes of the joint that it describes."""

    source: Source = ""  # "": not stated, as in a file that a person wrote
    nodes: Mapping[str, NodeIdentity] = field(default_factory=dict)  # by NODES


def origin_of(provenance: Mapping[str, Any], where: str) -> Origin:
    """Return the origin that `[provenance]` states.

    Raises:
        UsageError: `source` or a node's table is wrong.
    """
    source = settings.convert({"source": provenance.get("source", "")}, _Stated, f"{where}: [provenance]").source
    nodes = {
        name: settings.convert(provenance[name], NodeIdentity, f"{where}: [provenance.{name}]")
        for name in NODES
        if name in provenance
    }
    return Origin(source, nodes)


class _Stated(msgspec.Struct):
    source: Source


def with_origin(text: str, origin: Origin) -> str:
    """Return the text of a model file with this origin. Everything else is unchanged."""
    document: Any = tomlkit.parse(text)
    table = document.setdefault("provenance", tomlkit.table())
    for key in ("source", *NODES):
        table.pop(key, None)
    for key, value in origin_table(origin).items():
        table[key] = toml_table(value) if isinstance(value, Mapping) else value
    if not table:
        del document["provenance"]
    return str(tomlkit.dumps(document))


def origin_table(origin: Origin) -> dict[str, Any]:
    """Return an origin as plain values for `[provenance]`; an empty origin has no values."""
    stated = {"source": origin.source} if origin.source else {}
    return {**stated, **nodes_table(origin.nodes)}


def nodes_from(table: Mapping[str, Mapping[str, int]]) -> dict[str, NodeIdentity]:
    """Return the nodes that `nodes_table` wrote."""
    return {name: NodeIdentity(**node) for name, node in table.items() if name in NODES}


def nodes_table(nodes: Mapping[str, NodeIdentity]) -> dict[str, dict[str, int]]:
    """Return the nodes as plain values for `[provenance]`."""
    return {name: msgspec.structs.asdict(node) for name, node in nodes.items()}


def interval_low(provenance: Mapping[str, Any], name: str) -> float | None:
    """Return the lower end of an interval that a calibration wrote; None without a valid one."""
    intervals = provenance.get("intervals")
    ends = intervals.get(name) if isinstance(intervals, Mapping) else None
    if not isinstance(ends, list) or len(ends) != 2 or not all(isinstance(end, int | float) for end in ends):
        return None
    low, high = float(ends[0]), float(ends[1])
    return low if 0.0 <= low <= high else None


def toml_table(values: Mapping[str, Any]) -> Any:
    """Return plain values and mappings as a table of tomlkit."""
    table = tomlkit.table()
    for key, value in values.items():
        table[key] = toml_table(value) if isinstance(value, Mapping) else value
    return table
