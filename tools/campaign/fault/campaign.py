"""Plant and daemons on a vcan, one fault after the other: start, inject, watch, recover, and keep the evidence."""

from __future__ import annotations

import contextlib
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tools.campaign.fault.acts import ACTS, LASTING, Site, Undo
from tools.campaign.fault.catalogue import Fault
from tools.campaign.fault.processes import Daemon, LostError, Plant, until
from tools.campaign.fault.verdict import (
    STALL,
    ZERO,
    Seen,
    Verdict,
    judge,
    longest_gap,
    stopped_after,
    zero_after,
)
from tools.command import CONFIG
from tsa_ctrl.bus.wire.socketcan import SocketCan
from tsa_ctrl.errors import BusError
from tsa_ctrl.log.reader import LogFile

BOUND = 0.25  # s, [safety] zero_torque_within: its default
LIMIT = 2.0  # N*m, [axis.limits] torque
WANTED = 0.8  # N*m at the joint
STARTED, RECOVERED = 120.0, 10.0  # s; the first start on a machine compiles
LATCH_TIME = 0.4  # s that the torque must stay zero after the cause is gone
FLUSHED = 0.3  # s until the plant's record is in its file
ATTEMPTS = 5  # of a fault during which the machine stood still
SMALL_DISK = "size=4m"

# The controller's file as shipped, but for where it is and what it wants: a constant joint torque, soon.
TRIED = (
    ('channel = "vcan0" ', 'channel = "{channel}" '),
    ('# folder = "logs" ', 'folder = "{logs}" '),
    ('# path = "" ', 'path = "{folder}/tsa.sock" '),
    ('kind = "sine" ', 'kind = "constant" '),
    ("amplitude = 0.5 ", "offset = {wanted} "),
    ("# fade_in = 1.0 ", "fade_in = 0.2 "),
)
TOLERANT = (  # for a machine that stands still now and then
    ("rate = 1000.0 ", "rate = 500.0 "),
    ("# settle_cycles = 100 ", "settle_cycles = 20 "),
    ("# [bus.supervision]", "[bus.supervision]"),
    ("# tolerated_misses = 2 ", "tolerated_misses = 5 "),
    ("# rpdo_timeout = 0.02 ", "rpdo_timeout = 0.05 "),
    ("# allow_without = false ", "allow_without = true "),
)


@dataclass
class Trial:
    """One fault done, with what was seen at the plant; `injected` and `ended` are CLOCK_MONOTONIC in s."""

    fault: Fault
    injected: float
    ended: float
    zero: float | None
    gap: float
    phase: str
    most: float
    came_back: bool
    torque_before: float
    told: tuple[str, ...]  # faults, by its status
    counted: tuple[str, ...]
    stopped: float | None
    repeated: int = 0
    discarded: bool = False  # the machine stood still meanwhile: it is done again, whatever came of it

    def seen(self, faults: tuple[str, ...], notes: tuple[str, ...]) -> Seen:
        return Seen(
            self.zero, self.gap, self.phase, faults, notes, self.most, self.came_back, self.torque_before, self.stopped
        )


@dataclass(frozen=True)
class Result:
    """A trial with its verdict."""

    trial: Trial
    verdict: Verdict


@dataclass
class Campaign:
    """All faults given, on one plant as far as it goes; `progress` is told each fault's name.

    `tolerant`: half the rate and longer time-outs than the configuration that is shipped.
    """

    folder: Path
    channel: str
    tolerant: bool = False
    progress: Callable[[str], None] = lambda name: None
    results: list[Result] = field(default_factory=list)
    _daemon: Daemon | None = None
    _trials: list[Trial] = field(default_factory=list)
    _logs: Path = Path()
    _filler: Path | None = None

    def run(self, faults: tuple[Fault, ...]) -> list[Result]:
        """The verdict on each trial in order, also on those discarded for a hole. Raises LostError: no process came."""
        shutil.copy(CONFIG / "actuator.toml", self.folder)
        for bare in (False, True):
            chosen = [fault for fault in faults if fault.bare is bare]
            if not chosen:
                continue
            self.plant = Plant(self.folder, self.channel, bare)
            try:
                for negative in (False, True):
                    group = [fault for fault in chosen if fault.negative is negative]
                    with self._disk(negative):
                        self._run_group(group, negative)
            finally:
                if self._daemon is not None:
                    self._daemon.end()
                self.plant.end()
        order = [fault.name for fault in faults]
        return sorted(self.results, key=lambda result: order.index(result.trial.fault.name))

    @contextlib.contextmanager
    def _disk(self, small: bool) -> Iterator[None]:
        """The folder of the logs; a small disk of its own where this user may mount one."""
        self._logs = self.folder / ("small" if small else "logs")
        self._logs.mkdir(exist_ok=True)
        mount = ["mount", "-t", "tmpfs", "-o", SMALL_DISK, "none", str(self._logs)]
        self._mounted = small and subprocess.run(mount, capture_output=True, check=False).returncode == 0
        try:
            yield
        finally:
            if self._mounted:
                subprocess.run(["umount", "-l", str(self._logs)], capture_output=True, check=False)

    def _run_group(self, group: list[Fault], negative: bool) -> None:
        (self.folder / "controller.toml").write_text(self._configuration(-WANTED if negative else WANTED), "utf-8")
        for fault in group:
            self.progress(fault.name)
            for attempt in range(ATTEMPTS):
                if attempt and fault.act in LASTING:
                    self._end_life()
                daemon = self._running()
                trial = self._try(daemon, fault)
                trial.repeated = attempt
                trial.discarded = trial.gap > self._stall and attempt + 1 < ATTEMPTS  # before any verdict is known
                self._trials.append(trial)
                if not trial.discarded:
                    break
            if fault.alone:
                self._end_life()
        self._end_life()

    @property
    def _stall(self) -> float:
        """s between two rows of the plant's record in which the machine stood still, for a loop at our rate."""
        return STALL / (500.0 if self.tolerant else 1000.0)

    def _configuration(self, wanted: float) -> str:
        """The shipped file, changed where it must be."""
        text = (CONFIG / "controller.toml").read_text(encoding="utf-8")
        places = {"channel": self.channel, "folder": self.folder, "logs": self._logs, "wanted": wanted}
        for shipped, ours in TRIED + (TOLERANT if self.tolerant else ()):
            if text.count(shipped) != 1:
                raise LostError(f"{CONFIG / 'controller.toml'}: '{shipped}' is to be there once")
            text = text.replace(shipped, ours.format_map(places))
        return text

    def _running(self) -> Daemon:
        """A daemon with torque; recovered, or a new one."""
        if self._daemon is not None:
            with contextlib.suppress(LostError):
                return self._with_torque(self._daemon, RECOVERED)
            self._end_life()
        lost = LostError()
        for _ in range(ATTEMPTS):  # the machine may stand still during a start, too
            self._daemon = Daemon(self.folder, "controller.toml")
            try:
                return self._with_torque(self._daemon, STARTED)
            except LostError as error:
                lost = error
                self._end_life()
        raise lost

    def _with_torque(self, daemon: Daemon, patience: float) -> Daemon:
        asked = -1.0

        def ready() -> bool:
            nonlocal asked
            phase = daemon.phase
            if phase == "faulted" and time.monotonic() - asked > 1.0:
                asked = time.monotonic()
                daemon.recover()
            if phase in ("dead", "ended"):
                raise LostError(f"the daemon ended: {daemon.end() and ''}{daemon.said}")
            return phase == "running" and abs(self.plant.torque()) > 10.0 * ZERO

        until(ready, patience, "torque")
        time.sleep(0.15)  # faded in
        if not ready():
            until(ready, patience, "torque")
        return daemon

    def _try(self, daemon: Daemon, fault: Fault) -> Trial:
        """Inject, watch, take the cause away, watch again."""
        undo: Undo = lambda: None  # noqa: E731
        counted = daemon.counts()
        if fault.plant:
            injected = self.plant.tell(fault.plant)
        else:
            injected = time.monotonic()
            undo = ACTS[fault.act](Site(self.channel, self._logs, self._mounted), daemon) or undo
        time.sleep(max(0.0, injected + fault.watch - time.monotonic()))
        undo()
        cleared = self.plant.tell("clear")
        time.sleep(LATCH_TIME)
        phase, told = daemon.phase, daemon.faults(injected)
        more = {name: number - counted[name] for name, number in daemon.counts().items()}
        ended = time.monotonic()
        time.sleep(FLUSHED)
        self.plant.record.read()
        rows = self.plant.record.between(injected - 0.1, ended)
        after = [row for row in rows if row.clock >= injected]
        before = [abs(row.torque) for row in rows if row.clock < injected]
        if phase == "silent" and fault.unheard and min(abs(row.torque) for row in after) > ZERO:
            phase = "running"
        return Trial(
            fault,
            injected,
            ended,
            zero_after(rows, injected),
            longest_gap(rows),
            phase,
            max((abs(row.torque) for row in after), default=0.0),
            any(abs(row.torque) > ZERO for row in after if row.clock > cleared),
            max(before, default=0.0),
            told,
            tuple(f"{name} PDOs: {number}" for name, number in more.items() if number > 0),
            stopped_after(rows, injected, self._stall),
        )

    def _end_life(self) -> None:
        """End the daemon, read what it left behind, judge its trials."""
        daemon, trials = self._daemon, self._trials
        self._daemon, self._trials = None, []
        if daemon is None:
            return
        summary = daemon.end()
        start = summary.get("start", daemon.start)
        notes = self._notes()
        told = [(event["t"], event["text"]) for event in summary.get("events", [])]
        for trial in trials:
            begin, end = trial.injected - start - 0.02, trial.ended - start
            mine = [note for note in notes if begin <= note.t < end]
            ended = trial.phase == "ended"
            logged = [note.text for note in mine if note.fault or (ended and note.text.startswith("ended"))]
            faults = tuple(dict.fromkeys(logged if trial.fault.expected.cause else (*logged, *trial.told)))
            said = [note.text for note in mine] + [text for t, text in told if begin <= t < end]
            seen = trial.seen(faults, (*said, *trial.counted))
            self.results.append(Result(trial, judge(trial.fault.expected, seen, BOUND, LIMIT)))

    def _notes(self) -> list[Any]:
        """Of the newest log; a writer whose loop was killed completes it soon."""
        logs = sorted(self._logs.glob("*.mcap"), key=lambda path: path.stat().st_mtime)
        if not logs:
            return []
        log = LogFile(logs[-1])
        end = time.monotonic() + 3.0
        while True:
            notes = log.read_notes()
            if log.complete or time.monotonic() > end:
                return notes
            time.sleep(0.05)


def check_free(channel: str) -> None:
    """Raises BusError when somebody else talks on the bus."""
    bus = SocketCan(channel)
    try:
        if bus.recv(0.1) is not None:
            raise BusError(f"{channel}: somebody is active on this bus; stop the other programs, or take another vcan")
    finally:
        bus.close()
