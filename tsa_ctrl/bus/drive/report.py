"""What a bring-up found at each node and what it changed there."""

from __future__ import annotations

from dataclasses import dataclass, field

from tsa_ctrl.bus.canopen.objects import SERIAL_NUMBER, Object


@dataclass(frozen=True)
class Row:
    """One object written: what the node had, and what it has now. `after` is None for an object that it lacks."""

    entry: Object
    before: int | None
    after: int | None

    @property
    def changed(self) -> bool:
        return self.after is not None and self.before != self.after

    def __str__(self) -> str:
        if self.after is None:
            return f"{self.entry}: not there"
        before = "?" if self.before is None else self.entry.shown(self.before)
        after = self.entry.shown(self.after)
        return f"{self.entry}: {before} -> {after}" if self.changed else f"{self.entry}: {after}"


@dataclass
class NodeReport:
    """What was found at one node, and what was written to it."""

    name: str  # axis, role and node id
    node_id: int = 0
    identity: dict[str, int] = field(default_factory=dict)
    rows: list[Row] = field(default_factory=list)
    digital_inputs: Object | None = None  # 0x60FD, of a drive that has it
    notes: list[str] = field(default_factory=list)  # errors that the node remembers, things that could not be checked

    @property
    def serial_number(self) -> int | None:
        """0x1018:4; None where the node has no such object."""
        return self.identity.get(SERIAL_NUMBER.name)

    def lines(self) -> list[str]:
        """The report as text: identity, notes, and each object that was changed."""
        identity = ", ".join(f"{name} {value:#x}" for name, value in self.identity.items())
        changed = [str(row) for row in self.rows if row.changed]
        absent = [row.entry.name for row in self.rows if row.after is None]
        lines = [f"{self.name}: {identity}; {len(self.rows) - len(absent)} objects verified, {len(changed)} changed"]
        lines += [f"  {text}" for text in [*self.notes, *changed]]
        if absent:
            lines.append(f"  not there: {', '.join(absent)}")
        return lines


@dataclass(frozen=True)
class Report:
    """All nodes of one bus."""

    nodes: tuple[NodeReport, ...]

    def lines(self) -> list[str]:
        return [line for node in self.nodes for line in node.lines()]
