"""Whether a fault was met safely: from the plant's own record of its torque, and from the daemon's log."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

ZERO = 0.01  # N*m of the motor, 1 % of its rated torque: below it counts as none
STALLED = "stale PDO|heartbeat lost|0x8130|0x8250"  # what a machine that stood still is stopped for
STALL = 1.6  # periods between two rows of the record, one per ms: later than a cycle waits (60 %), answers are lost


@dataclass(frozen=True)
class Row:
    """One row of the plant's record: CLOCK_MONOTONIC in s, and N*m that the motor's current makes."""

    clock: float
    torque: float


class Record:
    """The plant's record (CSV), read on as it grows."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._offset = 0
        self._columns: dict[str, int] = {}
        self.rows: list[Row] = []

    def read(self) -> None:
        with self._path.open("rb") as file:
            file.seek(self._offset)
            data = file.read()
        end = data.rfind(b"\n") + 1
        self._offset += end
        for line in data[:end].decode("ascii").splitlines():
            fields = line.split(",")
            if not self._columns:
                self._columns = {name: place for place, name in enumerate(fields)}
                continue
            self.rows.append(Row(float(fields[self._columns["clock"]]), float(fields[self._columns["torque_loop"]])))

    def between(self, start: float, end: float) -> list[Row]:
        return [row for row in self.rows if start <= row.clock <= end]


def zero_after(rows: Sequence[Row], injected: float) -> float | None:
    """s from the injection until the torque is zero and stays so to the end; None when it does not."""
    last = None
    for row in rows:
        if row.clock >= injected and abs(row.torque) > ZERO:
            last = row.clock
    if last is None:
        return 0.0
    after = next((row.clock for row in rows if row.clock > last), None)
    return None if after is None else after - injected


def stopped_after(rows: Sequence[Row], injected: float, stall: float) -> float | None:
    """s from the last hole of more than `stall` s with torque to torque zero for good; None without such a stop."""
    torque = [row.clock for row in rows if row.clock >= injected and abs(row.torque) > ZERO]
    if not torque:
        return None
    holes = [a.clock for a, b in itertools.pairwise(rows) if b.clock - a.clock > stall and injected < b.clock]
    hole = max((clock for clock in holes if clock <= torque[-1]), default=None)
    return None if hole is None else zero_after(rows, hole)


def longest_gap(rows: Sequence[Row]) -> float:
    """s between two rows; of a plant that could always run it is its record's period."""
    return max((b.clock - a.clock for a, b in itertools.pairwise(rows)), default=float("inf"))


@dataclass(frozen=True)
class Expected:
    """What is to happen.

    `cause`: one of the causes that the log must name (regular expression); empty: none stops the loop. With `harmless`
    too it may stop it, or not. `within`: s until the torque must be zero, where that is not the configuration's bound,
    and `why`. `harmless`: why a fault may leave the torque on. `said`: what log or counters must tell of a loss.
    """

    cause: str = ""
    within: float | None = None
    why: str = ""
    harmless: str = ""
    said: str = ""


@dataclass(frozen=True)
class Seen:
    """What happened. `notes`: texts of the log since the injection, faults first; `phase` afterwards, "dead" if killed.

    `came_back`: whether torque came back once the cause was gone; `most`: largest torque afterwards, N*m; `stopped`: s
    from where the machine stood still to torque that is zero for good, None when it did not or the torque went on.
    """

    zero: float | None
    gap: float
    phase: str
    faults: tuple[str, ...]
    notes: tuple[str, ...]
    most: float
    came_back: bool
    torque_before: float
    stopped: float | None = None


@dataclass(frozen=True)
class Verdict:
    """`wrong` has what makes it unsafe; nothing when it is safe. `stalled`: stopped, but by the machine."""

    detected: str
    cause_in_log: bool
    latched: bool | None  # None: nothing to latch
    wrong: tuple[str, ...]
    stalled: bool = False

    @property
    def safe(self) -> bool:
        return not self.wrong


def judge(expected: Expected, seen: Seen, bound: float, limit: float) -> Verdict:
    """`bound`: s of the configuration until the torque is zero; `limit`: N*m of the limiter.

    A loop that stops although the fault takes nothing from it is safe where the machine stood still and that is the
    cause it names: late answers end the torque, as they must.
    """
    wrong = []
    if abs(seen.torque_before) <= 2.0 * ZERO:
        wrong.append(f"no torque to lose before it: {seen.torque_before:.3f} N*m")
    if expected.cause and not (expected.harmless and not seen.faults and seen.phase == "running"):
        named = next((fault for fault in seen.faults if re.search(expected.cause, fault)), None)
        within = bound if expected.within is None else expected.within
        if seen.zero is None:
            wrong.append("torque does not stay zero")
        elif seen.zero > within:
            wrong.append(f"torque zero after {1e3 * seen.zero:.0f} ms, allowed are {1e3 * within:.0f}")
        if named is None:
            wrong.append(f"the log does not name its cause; it has: {'; '.join(seen.faults) or 'no fault'}")
        if seen.came_back:
            wrong.append("torque came back by itself")
        if seen.phase not in ("faulted", "dead", "ended"):
            wrong.append(f"the loop is {seen.phase}, not latched")
        return Verdict(named or "-", named is not None, not seen.came_back, tuple(wrong))
    told = next((note for note in seen.notes if re.search(expected.said, note)), None) if expected.said else None
    if expected.said and told is None:
        wrong.append(f"nobody says so: {'; '.join(seen.notes) or 'no word'}")
    stall = next((fault for fault in seen.faults if re.search(STALLED, fault)), None)
    stalled = stall is not None and seen.stopped is not None and seen.stopped <= bound
    if not stalled:
        if seen.faults:
            wrong.append(f"stops: {'; '.join(seen.faults)}")
        if seen.phase != "running":
            wrong.append(f"the loop is {seen.phase}")
    if seen.most > 1.05 * limit:
        wrong.append(f"{seen.most:.2f} N*m are above the limit of {limit:g}")
    if stalled:
        return Verdict(f"{stall}", True, True, tuple(wrong), stalled)
    return Verdict(told or "goes on", told is not None, None, tuple(wrong))
