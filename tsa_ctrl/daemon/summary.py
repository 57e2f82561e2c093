"""Count the torque error of a run, and summarise the run as tables for the terminal or as one JSON object."""

from __future__ import annotations

import json
import math
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tsa_ctrl.control.axis import ControlAxis
from tsa_ctrl.ipc.protocol import Event
from tsa_ctrl.outputs import json_types
from tsa_ctrl.readiness import Nodes
from tsa_ctrl.safety.limiter import MEANINGS, Reason
from tsa_ctrl.settings import write_text
from tsa_ctrl.system.histogram import Distribution

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

SCHEMA = 1
SHOWN = 0.005  # share of the cycles from which a limit is listed
BAR = 20  # characters of the longest bar: both fit into 80 columns


SENSOR, ELONGATION, UNKNOWN = "torque sensor", "tendon elongation", "not measured"


@dataclass(frozen=True)
class TorqueError:
    """Joint torque minus set-point, over the cycles with torque after each fade-in.

    Attributes:
        axis: name of the axis.
        source: source of the joint torque: SENSOR, ELONGATION or UNKNOWN.
        seconds: duration of these cycles, s.
        rms, mean, peak, desired_rms: N*m; nan without a measured cycle.
        limited: share of these cycles by name of the active limit.
    """

    axis: str
    source: str
    seconds: float
    rms: float
    mean: float
    peak: float
    desired_rms: float
    limited: dict[str, float]


class TorqueErrorCounter:
    """Accumulate the torque error of one axis; call `update` once per cycle."""

    def __init__(self, axis: ControlAxis, period: float) -> None:
        self._axis = axis
        self._period = period
        self._cycles = self._measured = self._by_sensor = 0
        self._sum = self._squares = self._peak = self._desired = 0.0
        self._reasons: Counter[int] = Counter()

    def update(self) -> None:
        """Add the values of this cycle."""
        axis = self._axis
        reason = axis.reason
        if reason == Reason.DISABLED or not axis.law.faded or axis.ramp < 1.0:
            return
        self._cycles += 1
        if reason:
            self._reasons[reason] += 1
        torque = axis.instruments.tau_j
        if torque == torque:
            self._by_sensor += 1
        else:
            torque = axis.joint_torque.torque
        desired = axis.terms.tau_j_des
        error = torque - desired
        if error == error:
            self._measured += 1
            self._sum += error
            self._squares += error * error
            self._desired += desired * desired
            self._peak = max(self._peak, abs(error))

    def result(self) -> TorqueError:
        """Return the results so far."""
        number = self._measured
        source = UNKNOWN if number == 0 else SENSOR if 2 * self._by_sensor > number else ELONGATION

        def share(total: float) -> float:
            return total / number if number else math.nan

        return TorqueError(
            self._axis.name,
            source,
            self._cycles * self._period,
            math.sqrt(share(self._squares)),
            share(self._sum),
            self._peak if number else math.nan,
            math.sqrt(share(self._desired)),
            {Reason(code).name: count / self._cycles for code, count in self._reasons.most_common()},
        )


@dataclass(frozen=True)
class NodeCount:
    """Arrival of the PDOs of one node."""

    axis: str
    node: str
    missed: int  # cycles without all its PDOs
    late: int
    repeated: int
    malformed: int


@dataclass(frozen=True)
class Summary:
    """Counts of one run; durations in s."""

    bus: str
    rate: float  # Hz
    start: float  # s, CLOCK_MONOTONIC of the first cycle: t = 0 of the log
    cause: str  # the first reason to end
    failed: bool  # True if a fault was not recovered, or a drive did not confirm that it is off
    planned: int  # periods from the first cycle to the last
    sent: int  # cycles run, each with its SYNC and commands
    skipped: int  # periods lost to overruns
    overruns: int
    late: int  # cycles that began more than half a period late
    dropped: int  # frames that could not be sent
    error_frames: int
    flooded: int  # cycles whose answers could not be distinguished from old ones
    load: tuple[float, float]  # shares of the bit rate with least and worst bit stuffing
    rights: str
    lateness: Distribution
    work: Distribution
    lateness_bins: list[tuple[float, int]]
    work_bins: list[tuple[float, int]]
    nodes: tuple[NodeCount, ...]
    torque: tuple[TorqueError, ...]
    events: tuple[Event, ...]
    unconfirmed: tuple[str, ...]
    simulated: bool  # True if the nodes were simulated
    joints: Nodes
    log: str | None
    log_written: int
    log_lost: int

    @property
    def missed_pdo(self) -> int:
        """Return the number of cycles without all PDOs of a node, summed over the nodes."""
        return sum(node.missed for node in self.nodes)

    def as_dict(self) -> dict[str, Any]:
        """Return a JSON-ready object, with null for unknown values."""
        cycles = ("planned", "sent", "skipped", "overruns", "late", "missed_pdo", "dropped", "error_frames", "flooded")
        found: dict[str, Any] = json_types(
            {
                "schema": SCHEMA,
                **{name: getattr(self, name) for name in ("bus", "rate", "start", "cause", "failed")},
                "cycles": {name: getattr(self, name) for name in cycles},
                "load": self.load,
                "rights": self.rights,
                "lateness": _distribution(self.lateness, self.lateness_bins),
                "work": _distribution(self.work, self.work_bins),
                **{
                    name: getattr(self, name)
                    for name in ("torque", "nodes", "events", "unconfirmed", "simulated", "joints", "log")
                },
                "log_records": {"written": self.log_written, "lost": self.log_lost},
            }
        )
        return found

    def save(self) -> None:
        """Write the summary as JSON next to the log, to keep the cause of a fault with it. Raises UsageError."""
        if self.log is not None:
            write_text(Path(self.log).with_suffix(".json"), json.dumps(self.as_dict(), indent=1) + "\n")

    def show(self, console: Console) -> None:
        """Print torque error, cycles, nodes and events; histograms only if cycles began late or were skipped."""
        from rich.table import Table  # not loaded while the loop runs

        console.print(_torque(self.torque))
        table = Table(title=f"{self.bus}: {self.cause}", title_justify="left", show_header=False)
        table.add_row("cycles planned / run", f"{self.planned} / {self.sent}")
        table.add_row("periods skipped, in overruns", f"{self.skipped} in {self.overruns}")
        table.add_row("cycles begun late (over half a period)", str(self.late))
        table.add_row("frames dropped", str(self.dropped))
        table.add_row("error frames; cycles flooded", f"{self.error_frames}; {self.flooded}")
        table.add_row("bus load", f"{100 * self.load[0]:.0f} to {100 * self.load[1]:.0f} % of the bit rate")
        table.add_row("rights", self.rights)
        if self.log is not None:
            table.add_row("log", f"{self.log}: {self.log_written} records, {self.log_lost} lost")
        console.print(table)
        if self.late or self.skipped:
            console.print(_histogram(self))
        nodes = Table("axis", "node", "cycles missed", "late", "repeated", "wrong length")
        for node in self.nodes:
            counts = (node.missed, node.late, node.repeated, node.malformed)
            nodes.add_row(node.axis, node.node, *(str(count) for count in counts))
        console.print(nodes)
        for event in self.events:
            console.print(str(event), style="red" if event.fault else None)
        for line in self.unconfirmed:
            console.print(line, style="bold red")


def _torque(errors: tuple[TorqueError, ...]) -> Table:
    from rich.table import Table

    columns = ("axis", "RMS error", "mean error", "peak error", "RMS desired", "measured by", "limited")
    table = Table(*columns, title="joint torque in mN·m, from the end of the fade-in on", title_justify="left")
    for error in errors:
        values = (error.rms, error.mean, error.peak, error.desired_rms)
        limits = [f"{name.lower()} {100 * share:.0f} %" for name, share in error.limited.items() if share >= SHOWN]
        texts = ("-" if math.isnan(value) else f"{1e3 * value:.1f}" for value in values)
        table.add_row(error.axis, *texts, error.source, ", ".join(limits) or "no")
    acted = {Reason[name] for error in errors for name, share in error.limited.items() if share >= SHOWN}
    meanings = [f"{reason.name.lower()}: {MEANINGS[reason]}" for reason in sorted(acted) if reason in MEANINGS]
    if meanings:
        table.caption, table.caption_justify = "\n".join(meanings), "left"
    return table


def _histogram(summary: Summary) -> Table:
    from rich.table import Table

    table = Table("up to", "lateness", "", "work", "")
    most = max(
        (number for _, number in [*summary.lateness_bins, *summary.work_bins]),
        default=0,
    )
    for (edge, late), (_, work) in zip(summary.lateness_bins, summary.work_bins, strict=True):
        name = "above" if math.isinf(edge) else f"{edge * 1e6:g} us"
        table.add_row(name, str(late), _bar(late, most), str(work), _bar(work, most))
    table.add_section()
    for name, attribute in (("p50", "p50"), ("p99", "p99"), ("p99.9", "p999")):
        lateness, work_time = getattr(summary.lateness, attribute), getattr(summary.work, attribute)
        table.add_row(name, _microseconds(lateness), "", _microseconds(work_time), "")
    return table


def _bar(number: int, most: int) -> str:
    """Return a bar whose length is logarithmic, so that single outliers are visible."""
    return "" if number == 0 else "█" * max(1, round(BAR * math.log1p(number) / math.log1p(most)))


def _microseconds(seconds: float) -> str:
    return "-" if math.isnan(seconds) else f"{seconds * 1e6:.0f} us"


def _distribution(found: Distribution, bins: list[tuple[float, int]]) -> dict[str, Any]:
    return {name: getattr(found, name) for name in ("samples", "p50", "p99", "p999")} | {"bins": bins}
