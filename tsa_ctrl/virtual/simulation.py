"""Run the daemon's loop on the simulated plant in virtual time (`simulate_loop`)."""

from __future__ import annotations

import contextlib
import gc
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.arguments import listing_arguments, number_of, path_of, whole_of
from tsa_ctrl.bus.drive.network import joined
from tsa_ctrl.bus.live.rig import Rig
from tsa_ctrl.config import Configuration, ControllerFile, load_configuration
from tsa_ctrl.daemon.build import control_axes, describe, log_header, tuners_of
from tsa_ctrl.daemon.lifecycle import Lifecycle
from tsa_ctrl.daemon.loop import Loop
from tsa_ctrl.daemon.monitor_process import REPEAT, Report
from tsa_ctrl.daemon.monitoring import SecondChannel, watched_of
from tsa_ctrl.daemon.notices import Events
from tsa_ctrl.daemon.telemetry import Telemetry
from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.ipc.mailbox import Command, Mailbox
from tsa_ctrl.log.process import LogHeader
from tsa_ctrl.log.ring import LogHealth, RingReader, RingWriter
from tsa_ctrl.log.writer import LogWriter
from tsa_ctrl.monitor.watch import Monitor
from tsa_ctrl.monitor.watched import Frame, Watched
from tsa_ctrl.outputs import keep, move_into, refuse_inputs
from tsa_ctrl.plant.axis import COLUMNS, Recorder, Rows
from tsa_ctrl.plant.machine import Machine
from tsa_ctrl.plant.process import check
from tsa_ctrl.plant.settings import PlantSettings, load_plant
from tsa_ctrl.safety.causes import Cause, Finding
from tsa_ctrl.signals import FIELD_NAMES
from tsa_ctrl.virtual.lockstep import End, FurtherWire, Wire
from tsa_ctrl.virtual.result import AxisResult, Simulation
from tsa_ctrl.virtual.script import (
    Change,
    Fault,
    beginnings,
    commands,
    described,
    parse_fault_option,
    parse_set_option,
    put,
)

T = TypeVar("T")
EVERY = 0.5  # s between two reads of the ring, which holds 2 s at the highest rate
FILE = "tsa.mcap"


class Records:
    """Read the loop's ring `ring` into memory, and into the same log file as the daemon writes."""

    def __init__(self, axes: int, folder: Path | None, header: LogHeader) -> None:
        """Create the ring and, in `folder`, the log file; None: no file. Raises UsageError if it cannot be written."""
        self.path: Path | None = None
        if folder is not None:
            self.path, self._beside = folder / FILE, folder / f".{FILE}.part"
            try:
                folder.mkdir(parents=True, exist_ok=True)
                self._beside.unlink(missing_ok=True)
                self._beside.touch()
                self._beside.unlink()
            except OSError as error:
                raise UsageError(f"{folder}: cannot be written ({error.strerror}); choose another --out") from None
        self.ring = RingWriter(axes)
        self._reader, self._file_reader = RingReader(self.ring.fd), RingReader(self.ring.fd)
        self._blocks: list[list[NDArray[np.float64]]] = [[] for _ in range(axes)]
        self._writer: LogWriter | None = None
        if folder is not None:
            # The header has no date, so that the same run produces the same bytes.
            self._writer = LogWriter(self._file_reader, self._beside, replace(header, started=0.0))

    def drain(self, now: float) -> None:
        """Read the records that the loop has written until the simulated time `now`, s."""
        for axis, blocks in enumerate(self._blocks):
            blocks.append(self._reader.read(axis))
        if self._writer is not None:
            self._writer.step(now)

    def end(self, now: float) -> None:
        """Complete the log file after the loop and rename it. Raises UsageError if it cannot be written."""
        self.drain(now)
        if self._writer is None or self.path is None:
            return
        self._writer.end()
        health = LogHealth(self.ring)
        try:
            if health.trouble:
                raise OSError(0, health.trouble)
            move_into(self._beside, self.path)
        except OSError as error:
            raise UsageError(f"{self.path}: cannot be written ({error.strerror}); choose another --out") from None

    @property
    def written(self) -> int:
        """Return the number of records in the file."""
        return LogHealth(self.ring).written

    def columns(self, axis: int) -> dict[str, NDArray[np.float64]]:
        """Return the log of one axis by column name, each (n,); missing values are nan."""
        table = np.concatenate(self._blocks[axis])
        return {name: table[:, i].copy() for i, name in enumerate(FIELD_NAMES)}

    def close(self) -> None:
        """Release the memory and delete an incomplete file."""
        if self.path is not None:
            with contextlib.suppress(OSError):
                self._beside.unlink(missing_ok=True)
        for ring in (self._reader, self._file_reader, self.ring):
            ring.close()


NAMES = tuple(name for name, _ in COLUMNS)
_PLACE = NAMES.index("axis")


class Truth(Rows):
    """Record the true state of a machine with the columns of `tsa plant --record`, one row per axis and period.

    The rows are kept in memory, and also written to a file if a path is given.
    """

    def __init__(self, axes: int, period: float, path: Path | None = None) -> None:
        """Prepare the record; `period`: s between two rows. Raises UsageError if `path` cannot be written."""
        super().__init__(period)
        self._path = path
        self._beside = None if path is None else path.with_name(f".{path.name}.part")
        self._rows = [array("d") for _ in range(axes)]
        self._file = None if self._beside is None else Recorder(self._beside, period)

    def row(self, values: Sequence[float]) -> None:
        self._rows[int(values[_PLACE])].extend(values)
        if self._file is not None:
            self._file.row(values)

    def flush(self, clock: float) -> None:
        """Do nothing: the rows are in memory."""

    def finish(self) -> None:
        """Complete the file and rename it. Raises UsageError if it cannot be written."""
        if self._file is None or self._beside is None or self._path is None:
            return
        try:
            self._file.close()
            move_into(self._beside, self._path)
        except OSError as error:
            raise UsageError(f"{self._path}: cannot be written ({error.strerror}); choose another --record") from None

    def close(self) -> None:
        """Delete an incomplete file; may be called twice."""
        if self._file is not None and self._beside is not None:
            with contextlib.suppress(OSError):
                self._file.close()
                self._beside.unlink(missing_ok=True)

    def columns(self, place: int) -> dict[str, NDArray[np.float64]]:
        """Return the true state of one axis by column name, each (n,)."""
        table = np.frombuffer(self._rows[place], dtype=np.float64).reshape(-1, len(NAMES))
        return {name: table[:, i].copy() for i, name in enumerate(NAMES)}


TICK = 1e-3  # s between two checks for missing frames


class VirtualMonitor:
    """Run the monitor of the monitor process in virtual time, at a separate end of the wire.

    It receives every frame from its construction on.
    """

    def __init__(self, wire: Wire, watched: Watched) -> None:
        self.report = Report()
        self.monitor = Monitor(watched)
        self._wire, self._end = wire, End(wire)
        self._number, self._due, self._open = 0, 0.0, True
        self._told: set[str] = set()
        wire.listeners.append(self._hear)
        wire.at(wire.now, self._tick)

    def fault(self, now: float) -> Finding | None:
        """Return the finding that forbids torque, or None."""
        return Finding(Cause.MONITOR_STOPPED, str(self.monitor.stop)) if self.report.stop is not None else None

    def news(self) -> list[str]:
        """Return the notices since the last call."""
        new = [str(notice) for name, notice in self.monitor.notices.items() if name not in self._told]
        self._told |= set(self.monitor.notices)
        return new

    def close(self) -> None:
        """Stop receiving."""
        self._open = False
        self._wire.listeners.remove(self._hear)

    def _hear(self, frame: Frame, now: float) -> None:
        self._follow(now, frame)

    def _tick(self, now: float) -> None:
        if self._open:
            self._follow(now, None)
            self._wire.at(now + TICK, self._tick)

    def _follow(self, now: float, frame: Frame | None) -> None:
        monitor = self.monitor
        if monitor.step(frame, now) is None or self.report.confirmed or now < self._due:
            return
        self._due = now + REPEAT
        confirmed = monitor.confirmed
        for can_id, data in monitor.action(0 if confirmed else self._number):
            self._wire.send(self._end, can_id, data)
        self._number += 1
        self.report = Report(monitor.stop, confirmed)


RIGHTS = "none needed"
LONGEST = 86_400.0  # s

Progress = Callable[[float], None]


@listing_arguments
def simulate_loop(
    controller: str | Path | Configuration,
    plant: str | Path | PlantSettings,
    seconds: float,
    *,
    out: str | Path | None = None,
    record: str | Path | None = None,
    seed: int | None = None,
    faults: Sequence[Fault | str] = (),
    changes: Sequence[Change | str] = (),
    tick: Progress = lambda share: None,
) -> Simulation:
    """Run a controller file on a plant file for `seconds` of torque, without a bus and without waiting.

    The same arguments give the same result, to the last bit.

    Args:
        controller: controller file or configuration.
        plant: plant file or settings.
        seconds: s, duration with torque.
        out: folder for the daemon's log.
        record: CSV file for the true state of the plant.
        seed: seed of the noise, instead of the plant file's seed.
        faults: faults during the run, as objects or in the form of --fault ("torn_tendon@5").
        changes: parameter changes during the run, as objects or in the form of --set ("compensation=0.5@3").
        tick: called with the completed share of the time.

    Raises:
        UsageError: if the files or the script are invalid.
        BusError: if the nodes cannot be brought up.
    """
    seconds = number_of(seconds, "seconds")
    if not 0.0 < seconds <= LONGEST:
        raise UsageError(f"seconds {seconds:g}: allowed is above 0 to {LONGEST:g}")
    configuration = controller if isinstance(controller, Configuration) else load_configuration(controller)
    settings = plant if isinstance(plant, PlantSettings) else check(plant)
    if seed is not None:
        seed = whole_of(seed, "seed")
        settings = msgspec.structs.replace(settings, physics=msgspec.structs.replace(settings.physics, seed=seed))
    inputs = [configuration.path, *(configuration.folder / axis.model for axis in configuration.file.axes)]
    inputs += [Path(axis.actuator) for axis in settings.axis] + (
        [] if isinstance(plant, PlantSettings) else [Path(plant)]
    )
    if record is not None:
        record = path_of(record, "record", "the path of a CSV file")
        refuse_inputs(record, inputs, "--record")
    begun = _parsed(faults, Fault, parse_fault_option)
    made = _parsed(changes, Change, parse_set_option)
    for option, at in (*(("--fault", each.at) for each in begun), *(("--set", each.at) for each in made)):
        if at > seconds:
            raise UsageError(f"{option} at {at:g} s: allowed are times up to the end of the run, {seconds:g} s")
    if out is not None:
        out = path_of(out, "out", "the path of a folder")
    files = {}
    if not isinstance(controller, Configuration) and not isinstance(plant, PlantSettings):
        files = described(configuration.path, Path(plant), seconds, seed, begun, made)
    run = Run(configuration, settings, seconds, out, record, files)
    try:
        return run.play(begun, made, tick)
    finally:
        run.close()


def _parsed(given: Sequence[T | str] | str, kind: type[T], parse: Callable[[str], T]) -> list[T]:
    """Return the faults or changes of a run as objects; raise UsageError for another type."""
    found = [parse(each) if isinstance(each, str) else each for each in ([given] if isinstance(given, str) else given)]
    wrong = next((each for each in found if not isinstance(each, kind)), None)
    if wrong is not None:
        raise UsageError(f"simulate_loop: found {wrong!r:.60}; give texts or objects of {kind.__name__}")
    return found


@contextlib.contextmanager
def _garbage_left() -> Iterator[None]:
    """Disable garbage collection: loop and plant create no reference cycles, and a search takes 1/8 of the time."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _places(file: ControllerFile, plant: PlantSettings) -> list[int]:
    """Return, for each bus of the plant, the place of the controller's bus with this channel. Raises UsageError."""
    channels = [bus.channel for bus in file.buses]
    if len(channels) == 1 == len(plant.buses):
        return [0]
    theirs = [bus.channel for bus in plant.buses]
    if sorted(channels) != sorted(theirs):
        raise UsageError(
            f"the controller's buses have the channels {', '.join(channels)}, the plant's {', '.join(theirs)}; "
            "write the same channels in both files"
        )
    return [channels.index(channel) for channel in theirs]


def _check_names(file: ControllerFile, plant: PlantSettings, places: Sequence[int]) -> None:
    """Raise UsageError if the drive of a controller's axis belongs to another of its axes in the plant."""
    ours = {axis.name for axis in file.axes}
    theirs = {
        (places[plant.bus_number(axis)], axis.drive.node_id, axis.drive.slot): axis.name
        for axis in plant.axis
        if axis.name in ours
    }
    for axis in file.axes:
        node = file.buses.index(file.bus_of(axis)), axis.drive.node_id, axis.drive.slot
        name = theirs.get(node, axis.name)
        if name != axis.name:
            raise UsageError(
                f"axis '{axis.name}' of the controller has drive node {axis.drive.node_id}, which belongs to axis "
                f"'{name}' of the plant; write the same node_id or the same name in both files (the default of the "
                "plant is 1 + place of the axis)"
            )


class Run:
    """Hold the parts of one run, assembled as in the daemon and `tsa plant`: `machine`, `rig`, `axes` and `loop`."""

    def __init__(
        self,
        configuration: Configuration,
        plant: PlantSettings,
        seconds: float,
        out: str | Path | None = None,
        record: str | Path | None = None,
        files: Mapping[str, str] | None = None,
    ) -> None:
        """Build the run; `files`: text by name for the head of the log, in addition to the controller's files."""
        file = configuration.file
        self._configuration = configuration
        self._plant = plant
        self._seconds = seconds
        self._record = None if record is None else Path(record)
        self._wire = Wire(file.bus.bitrate)
        wires = [self._wire, *(FurtherWire(bus.bitrate, self._wire) for bus in file.other_buses)]
        places = _places(file, plant)
        _check_names(file, plant, places)
        theirs = [wires[place] for place in places]  # in the order of the plant
        for place, wire in enumerate(theirs if len(theirs) > 1 else ()):
            wire.place = (place,)
        first, *others = [wire.plant for wire in theirs]
        self.machine = Machine(plant, first, self._wire.plant.clock, self._wire.switch, others)
        self._wire.attach(self.machine)
        with contextlib.ExitStack() as opened:  # closes truth, records and mailbox if the constructor fails
            self._truth = Truth(len(plant.axis), min(plant.physics.record_period, configuration.period), self._record)
            opened.callback(self._truth.close)
            self.machine.recorder = self._truth
            header = log_header(configuration)
            header.files.update(files or {})
            self._records = Records(len(file.axes), None if out is None else Path(out), header)
            opened.callback(self._records.close)
            host = joined([wire.host for wire in wires], file.buses, file.axes)
            self.rig = Rig(host, file.slowest_bus, file.axes, configuration.profiles)
            self.axes = control_axes(configuration, self.rig)
            self._tuners = tuners_of(self.axes, configuration.period)
            self._mailbox = Mailbox(len(file.axes), len(self._tuners[0].parameters))
            opened.callback(self._mailbox.close)
            events = Events()
            telemetry = Telemetry(self.rig, self.axes, self._tuners, self._mailbox, self._records.ring, None, events)
            self.loop = Loop(
                self.rig,
                self.axes,
                self._tuners,
                self._mailbox,
                telemetry,
                events,
                file.controller,
                file.bus.supervision,
                self._nanoseconds,
            )
            if configuration.monitored:
                watched = watched_of(configuration)
                self.loop.attach(SecondChannel(lambda: VirtualMonitor(self._wire, watched)))
            self._opened = opened.pop_all()

    def play(self, faults: Sequence[Fault], changes: Sequence[Change], tick: Progress) -> Simulation:
        script = beginnings(self.machine, faults, self._wire)
        settings = commands(describe(self._configuration, self._tuners), changes)
        lifecycle = Lifecycle(self._configuration, self.rig, self.axes, self.loop, simulated=True)
        self.machine.start()
        self._every(EVERY, self._records.drain)
        self._every(EVERY, lambda now: tick(min(1.0, now / (self._seconds + 1.0))))
        with _garbage_left():
            lifecycle.run(self._seconds, ready=lambda: self._schedule(script, settings))
        self._truth.finish()
        self._records.end(self._wire.now)
        log = self._records.path
        summary = lifecycle.summary(
            self._mailbox, RIGHTS, None if log is None else str(log.resolve()), self._records.written
        )
        if log is not None:
            keep(log.with_suffix(".json"))
        summary.save()
        notes = (*lifecycle.node_notes, *self._notes())
        return Simulation(self._seconds, self._results(), summary, self._record, notes)

    def close(self) -> None:
        self._opened.close()

    def _nanoseconds(self) -> int:
        """Return the loop's time, ns, after the simulated computing time of the cycle."""
        self._wire.host.compute()
        return round(self._wire.now * 1e9)

    def _every(self, period: float, action: Callable[[float], None]) -> None:
        def again(now: float) -> None:
            action(now)
            self._wire.at(now + period, again)

        self._wire.at(self._wire.now + period, again)

    def _schedule(
        self, script: Sequence[tuple[Callable[[float], None], float]], settings: Sequence[tuple[Command, float]]
    ) -> None:
        """Schedule the script; its times count from the first cycle, which starts one period from now."""
        first = self._wire.now + self._configuration.period
        for begin, at in script:
            self._wire.at(first + at, self._beginning(begin))
        for command, at in settings:
            self._wire.at(first + at, self._putting(command))

    def _beginning(self, begin: Callable[[float], None]) -> Callable[[float], None]:
        def action(now: float) -> None:
            self.machine.advance(now)
            begin(now)

        return action

    def _putting(self, command: Command) -> Callable[[float], None]:
        return lambda now: put(self._mailbox, command)

    def _results(self) -> tuple[AxisResult, ...]:
        places = {(axis.drive.node_id, axis.drive.slot): place for place, axis in enumerate(self._plant.axis)}
        events = self.loop.events.faults
        return tuple(
            AxisResult(
                name=settings.name,
                log=self._records.columns(index),
                truth=self._truth.columns(places[settings.drive.node_id, settings.drive.slot]),
                start=self.loop.start,
                fade_in=settings.law.fade_in,
                until=self.loop.stop_began,
                faults=tuple(str(event.text) for event in events if event.axis in ("", settings.name)),
            )
            for index, settings in enumerate(self._configuration.file.axes)
        )

    def _notes(self) -> tuple[str, ...]:
        silent = [
            f"axis '{axis.name}': serial {sensor.quantity} is not simulated and sends nothing"
            for axis in self._configuration.file.axes
            for sensor in axis.serial
        ]
        unsolved = [
            f"plant's axis '{unit.axis.name}': {count:.0f} sub-steps without a solution; do not trust what follows them"
            for unit in self.machine.axes
            if (count := unit.axis.values()["unsolved"])
        ]
        return (*silent, *unsolved)


# `play` replaces the processes of plant and daemon by a run in virtual time, with the same files and the same summary.


def play(
    folder: Path,
    name: str,
    seconds: float,
    tick: Callable[[float], None],
    plant: Path | None = None,
    must_succeed: bool = True,
    repetition: int = 0,
) -> dict[str, Any]:
    """Run `controller-NAME.toml` in `folder` on `plant` (default: its `plant.toml`); the log is in a folder NAME.

    Runs with different numbers `repetition` have different noise. Returns the summary that `tsa run --json` prints.

    Raises:
        BusError: The run failed, and `must_succeed` is True.
    """
    plant = folder / "plant.toml" if plant is None else plant
    seed = load_plant(plant).physics.seed + repetition if repetition else None
    result = simulate_loop(folder / f"controller-{name}.toml", plant, seconds, out=folder / name, seed=seed, tick=tick)
    if must_succeed and result.summary.failed:
        raise BusError(f"the run '{name}' failed: {result.summary.cause}")
    return result.summary.as_dict()
