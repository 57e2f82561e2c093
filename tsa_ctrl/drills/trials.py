"""Run the trials of a rig one by one, and write the record of them.

A trial starts a loop with torque, applies a disturbance, and observes the reaction of the drives.
"""

from __future__ import annotations

import contextlib
import datetime
import hashlib
import json
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from enum import Enum
from pathlib import Path
from typing import Any

import msgspec

from tsa_ctrl.bus.drive.bring_up import bring_up
from tsa_ctrl.bus.drive.network import frames_of_drives, layout_of, open_buses
from tsa_ctrl.bus.drive.session import Session
from tsa_ctrl.bus.live.rig import Rig
from tsa_ctrl.config import Configuration
from tsa_ctrl.daemon.joint_files import JointFiles
from tsa_ctrl.drills.listener import ZERO_SHARE, Pull, Said, Sample, Timing, Watchdog, timing, watchdog
from tsa_ctrl.errors import BusError, TsaError, UsageError
from tsa_ctrl.outputs import untaken
from tsa_ctrl.readiness import Nodes
from tsa_ctrl.safety.shut_down import shut_down
from tsa_ctrl.settings import write_text
from tsa_ctrl.system.process_supervisor import Child, environment, terminal_blocked
from tsa_ctrl.version import __version__

STARTED = 60.0  # s until the loop delivers torque
SETTLED = 0.4  # s of torque before the disturbance
BEYOND = 0.3  # s of observation beyond the limit
ENDED = 10.0  # s until a process ends after a request
DELIVERED = 0.5  # share of the desired torque that a drive must report


class Trial(Enum):
    """Disturbances of the loop: key and description."""

    WITHHOLD = ("withheld", "heartbeat withheld")
    HANG = ("hang", "loop hung: SIGSTOP")
    KILL = ("kill", "loop killed: SIGKILL")

    @property
    def key(self) -> str:
        return str(self.value[0])

    @property
    def words(self) -> str:
        return str(self.value[1])


_SIGNALS = {Trial.WITHHOLD: signal.SIGUSR1, Trial.HANG: signal.SIGSTOP, Trial.KILL: signal.SIGKILL}


class Outcome(msgspec.Struct, frozen=True, kw_only=True):
    """Result of one trial on one axis."""

    trial: str
    axis: str
    node: int
    limit: float  # s
    safe: bool
    timing: Timing
    watchdog: Watchdog
    pull: Pull
    samples: list[Sample]


class ListenerProcess:
    """A listener process at the other end of a pipe."""

    def __init__(self, configuration: Configuration) -> None:
        """Start the listener; raise BusError if it cannot open the bus."""
        self._process = Child("tsa_ctrl.drills.listener", configuration.path)
        if reason := self._process.failure():
            self.end()
            raise BusError(
                f"the listener cannot open the bus: {reason}; choose a bus that two processes can open, as SocketCAN is"
            )

    def ask(self, word: str) -> Any:
        self._process.send(word.encode())
        line = self._process.receive()
        if not line:
            raise BusError("the listener has ended; nothing was measured: start again")
        return msgspec.json.decode(line)

    def end(self) -> None:
        self._process.end(ENDED)


@contextlib.contextmanager
def listening(configuration: Configuration) -> Iterator[ListenerProcess]:
    """Run a listener on the bus in a separate process, and end it after the block."""
    listener = ListenerProcess(configuration)
    try:
        yield listener
    finally:
        listener.end()


def run_trial(configuration: Configuration, listener: ListenerProcess, trial: Trial, torque: float) -> list[Outcome]:
    """Run one trial of all axes with `torque` N*m at each motor; raise BusError if no torque is measured."""
    limit = configuration.zero_torque_within
    loop = None
    on_guard = False
    listener.ask("begin")
    try:
        with terminal_blocked():
            loop = subprocess.Popen(
                [sys.executable, "-m", "tsa_ctrl.drills.loop", str(configuration.path), repr(torque)],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                env=environment(),
            )
        _await_torque(loop, listener, torque)
        time.sleep(SETTLED)
        pulls = _pulls(listener)
        listener.ask("guard")
        on_guard = True
        time.sleep(0.05)
        if not _all_pull(listener, torque):
            raise BusError(f"torque was lost before anything was done to the loop: {_reason(loop)}")
        stopped = time.monotonic()
        loop.send_signal(_SIGNALS[trial])
        time.sleep(limit + BEYOND)
        quiet = listener.ask("quiet")
        on_guard = False
        seen, said = msgspec.convert(quiet["samples"], list[Sample]), msgspec.convert(quiet["said"], list[Said])
        armed = msgspec.convert(listener.ask("armed"), dict[str, dict[str, int]])
    finally:
        if loop is not None:
            _end(loop)
        if (
            on_guard
        ):  # after a failure: on guard it would continue to query the drives, and no other process could reset them
            with contextlib.suppress(BusError):
                listener.ask("quiet")
    outcomes = []
    for axis in configuration.file.axes:
        drive = axis.drive
        mine = [sample for sample in seen if sample.node == drive.node_id]
        zero = ZERO_SHARE * drive.rated_torque * drive.gear_ratio
        found = timing(mine, drive.node_id, stopped, zero)
        had = found.torque_before is not None and abs(found.torque_before) >= DELIVERED * torque
        safe = had and found.zero_after is not None and found.zero_after <= limit
        outcomes.append(
            Outcome(
                trial=trial.key,
                axis=axis.name,
                node=drive.node_id,
                limit=limit,
                safe=safe,
                timing=found,
                pull=pulls[axis.name],
                watchdog=watchdog(said, drive.node_id, stopped, armed[axis.name], trial is not Trial.WITHHOLD),
                samples=[msgspec.structs.replace(sample, clock=sample.clock - stopped) for sample in mine],
            )
        )
    return outcomes


def _pulls(listener: ListenerProcess) -> dict[str, Pull]:
    """Return the observations of the torque by axis; raise BusError if its sign or its gain is wrong."""
    found = msgspec.convert(listener.ask("pull"), dict[str, Pull])
    for axis, each in found.items():
        if each.wrong:
            raise BusError(f"axis '{axis}': {each.wrong}; correct it, then start again: nothing else was tried")
    return found


def _await_torque(loop: subprocess.Popen[bytes], listener: ListenerProcess, torque: float) -> None:
    end = time.monotonic() + STARTED
    while not _all_pull(listener, torque):
        if loop.poll() is not None:
            raise BusError(f"the loop ended before there was torque: {_reason(loop)}")
        _pulls(listener)
        if time.monotonic() > end:
            raise BusError(
                f"the drives do not report {torque:g} N*m within {STARTED:g} s; watch `tsa run`, or give more --torque"
            )
        time.sleep(0.02)


def _all_pull(listener: ListenerProcess, torque: float) -> bool:
    found = listener.ask("torque").values()
    return all(one is not None and abs(one) >= DELIVERED * torque for one in found)


def _reason(loop: subprocess.Popen[bytes]) -> str:
    """End the loop, and return the last line of its output."""
    said = _end(loop).decode(errors="replace").strip().splitlines()
    return said[-1].strip() if said else "it said nothing"


def _end(loop: subprocess.Popen[bytes]) -> bytes:
    """End the loop, by SIGTERM if possible, and return its output."""
    if loop.poll() is None:
        loop.send_signal(signal.SIGCONT)
        loop.terminate()
    try:
        return loop.communicate(timeout=ENDED)[1]
    except subprocess.TimeoutExpired:
        loop.kill()
        return loop.communicate()[1]


def check_alone(configuration: Configuration) -> None:
    """Raise BusError if another master is on the bus, because its drives would be tested instead; send nothing."""
    file = configuration.file
    bus = open_buses(file.buses, file.axes)
    try:
        with Session(bus, file.bus) as session:
            session.alone(
                [layout_of(axis.drive).rpdo_id for axis in file.axes], frames_of_drives(configuration.profiles)
            )
    finally:
        bus.close()


def leave_in_order(configuration: Configuration, say: Callable[[str], None]) -> Nodes:
    """Reset the faults left by the trials, leave the drives disabled and pre-operational, and return the nodes."""
    files = JointFiles(configuration, simulated=False)
    file = configuration.file
    bus = open_buses(file.buses, file.axes)
    try:
        bring_up(
            bus,
            file.bus,
            file.axes,
            configuration.profiles,
            configuration.period,
            reset_faults=True,
            identify=files.identify,
        )
        rig = Rig(bus, file.bus, file.axes, configuration.profiles)
        rig.start()
        for line in shut_down(rig, configuration.period):
            say(line)
    finally:
        bus.close()
    return files.nodes


SCHEMA = 1
DEFAULT_SHARE = 0.1  # of the smallest rated torque
LEAST_SHARE = 0.06  # of the largest rated torque: a smaller torque cannot be distinguished from zero


class Verification(msgspec.Struct, frozen=True, kw_only=True):
    """Results of the trials, and the tested configuration."""

    date: str  # ISO 8601, local time with its offset
    version: str
    configuration: str
    sha256: str  # of the configuration's text
    bus: str
    rate: float  # Hz
    limit: float  # s, zero_torque_within
    torque: float  # N*m at the motor
    outcomes: list[Outcome]
    nodes: Nodes  # nodes on the bus

    @property
    def safe(self) -> bool:
        return bool(self.outcomes) and all(outcome.safe for outcome in self.outcomes)

    def as_dict(self, samples: bool) -> dict[str, Any]:
        """Return a JSON-ready object; `samples` adds every observed torque."""
        trials = []
        for outcome in self.outcomes:
            data = msgspec.to_builtins(outcome)
            data |= data.pop("timing")
            found = data.pop("watchdog")
            data |= {"watchdog": found["acted"], "watchdog_after": found["after"], "warning": found["warning"] or None}
            data["pull"] |= {"shown": str(outcome.pull)}
            kept = data.pop("samples")
            trials.append({**data, "samples": kept} if samples else data)
        head = {name: getattr(self, name) for name in ("date", "version", "configuration", "sha256", "bus", "rate")}
        return {
            "schema": SCHEMA,
            **head,
            "limit": self.limit,
            "torque": self.torque,
            "safe": self.safe,
            "trials": trials,
        }


def trial_torque(configuration: Configuration, asked: float | None) -> float:
    """Return the motor torque, N*m: requested, configured, or a tenth of the rated torque. Raises UsageError."""
    axes = configuration.file.axes
    rated = [axis.drive.rated_torque * axis.drive.gear_ratio for axis in axes]
    given = configuration.file.safety.torque if asked is None else asked
    torque = DEFAULT_SHARE * min(rated) if given is None else given
    least, most = LEAST_SHARE * max(rated), min(axis.limits.torque for axis in axes)
    if least > most:
        raise UsageError(
            f"{configuration.path}: limits.torque allows {most:g} N*m, but the trials need at least {least:g} N*m "
            f"({LEAST_SHARE:.0%} of the rated torque); raise limits.torque, or correct rated_torque in [axis.drive]"
        )
    if not least <= torque <= most:
        raise UsageError(
            f"{configuration.path}: torque {torque:g} N*m of the trials; allowed are {least:g} N*m (three times what "
            f"counts as none, {ZERO_SHARE * max(rated):g}) to {most:g} N*m (limits.torque); give another "
            "--torque, or correct [safety] torque"
        )
    return torque


def verify(configuration: Configuration, torque: float, say: Callable[[str], None]) -> Verification:
    """Run all trials and return their results.

    `say` receives a line for each trial.

    Raises:
        BusError: the rig does not start or delivers no torque.
    """
    outcomes: list[Outcome] = []
    nodes: Nodes = {}
    wrong = ""
    check_alone(configuration)
    with listening(configuration) as listener:
        try:
            for trial in Trial:
                say(f"{trial.words} ...")
                outcomes += run_trial(configuration, listener, trial, torque)
        except TsaError as error:
            wrong = str(error)
            raise
        finally:
            try:
                nodes = leave_in_order(configuration, say)
            except TsaError as error:  # only the failed trial is reported
                if str(error) not in wrong:
                    say(f"the drives could not be left in order: {error}")
    return Verification(
        date=datetime.datetime.now().astimezone().isoformat(timespec="seconds"),
        version=__version__,
        configuration=str(configuration.path),
        sha256=hashlib.sha256(configuration.text.encode()).hexdigest(),
        bus=configuration.file.channels,
        rate=configuration.file.controller.rate,
        limit=configuration.zero_torque_within,
        torque=torque,
        outcomes=outcomes,
        nodes=nodes,
    )


def check_folder(folder: Path) -> None:
    """Check, before anything moves, that a record can be written to the folder; raise UsageError if it cannot."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise UsageError(f"{folder}: no record can be kept there ({error.strerror}); choose another --record") from None


def save(verification: Verification, folder: Path) -> Path:
    """Write the results to a new dated file and return its path; raise UsageError if that fails."""
    path = untaken(folder, "safety", ".json", datetime.datetime.fromisoformat(verification.date))
    write_text(path, json.dumps(verification.as_dict(samples=True), allow_nan=False) + "\n")
    return path
