"""`simulate_loop`: the daemon's real loop on the real plant, in virtual time."""

from __future__ import annotations

import contextlib
import gc
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import msgspec

from tsa_ctrl.bus.live.rig import Rig
from tsa_ctrl.config import Configuration, load_configuration
from tsa_ctrl.daemon.assembly import control_axes, log_header, tuners_of
from tsa_ctrl.daemon.events import Events
from tsa_ctrl.daemon.loop import Loop
from tsa_ctrl.daemon.monitoring import SecondChannel, watched_of
from tsa_ctrl.daemon.operation import Operation
from tsa_ctrl.daemon.telemetry import Telemetry
from tsa_ctrl.errors import UsageError
from tsa_ctrl.ipc.mailbox import Command, Mailbox
from tsa_ctrl.outputs import keep, refuse_inputs
from tsa_ctrl.plant.machine import Machine
from tsa_ctrl.plant.process import check
from tsa_ctrl.plant.settings import PlantSettings
from tsa_ctrl.virtual.lockstep import Wire
from tsa_ctrl.virtual.records import EVERY, Records
from tsa_ctrl.virtual.result import AxisResult, Simulation
from tsa_ctrl.virtual.script import Change, Fault, beginnings, commands, parse_fault_option, parse_set_option, put
from tsa_ctrl.virtual.truth import Truth
from tsa_ctrl.virtual.witness import VirtualMonitor

RIGHTS = "none needed"
LONGEST = 86_400.0  # s

Progress = Callable[[float], None]


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

    `out`: folder for the daemon's own log; `record`: file for the plant's truth as CSV; `seed`: of all noise, instead
    of the plant file's; `faults` and `changes`: what happens meanwhile, as objects or as the verb's --fault and --set
    take it ("torn_tendon@5", "compensation=0.5@3"); `tick` is told the share of the time that has gone. The same
    arguments give the same result, to the last bit. Raises UsageError for what is wrong with the files or the script,
    BusError when the nodes cannot be brought up.
    """
    if not 0.0 < seconds <= LONGEST:
        raise UsageError(f"seconds {seconds:g}: allowed is above 0 to {LONGEST:g}")
    configuration = controller if isinstance(controller, Configuration) else load_configuration(controller)
    settings = plant if isinstance(plant, PlantSettings) else check(plant)
    if seed is not None:
        settings = msgspec.structs.replace(settings, physics=msgspec.structs.replace(settings.physics, seed=seed))
    inputs = [configuration.path, *(configuration.folder / axis.model for axis in configuration.file.axes)]
    inputs += [Path(axis.actuator) for axis in settings.axis] + (
        [] if isinstance(plant, PlantSettings) else [Path(plant)]
    )
    if record is not None:
        refuse_inputs(Path(record), inputs, "--record")
    run = Run(configuration, settings, seconds, out, record)
    try:
        return run.play(
            [parse_fault_option(each) if isinstance(each, str) else each for each in faults],
            [parse_set_option(each) if isinstance(each, str) else each for each in changes],
            tick,
        )
    finally:
        run.close()


@contextlib.contextmanager
def _garbage_left() -> Iterator[None]:
    """Neither loop nor plant makes cycles of references; to look for them takes an eighth of the time."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


class Run:
    """The parts of one run, put together as the daemon and `tsa plant` do: `machine`, `rig`, `axes` and `loop`."""

    def __init__(
        self,
        configuration: Configuration,
        plant: PlantSettings,
        seconds: float,
        out: str | Path | None = None,
        record: str | Path | None = None,
    ) -> None:
        file = configuration.file
        self._configuration = configuration
        self._plant = plant
        self._seconds = seconds
        self._record = None if record is None else Path(record)
        self._wire = Wire(file.bus.bitrate)
        self.machine = Machine(plant, self._wire.plant, self._wire.plant.clock, self._wire.switch)
        self._wire.attach(self.machine)
        self._truth = Truth(len(plant.axis), min(plant.physics.record_period, configuration.period), self._record)
        self.machine.recorder = self._truth
        self._records = Records(len(file.axes), None if out is None else Path(out), log_header(configuration))
        self.rig = Rig(self._wire.host, file.bus, file.axes, configuration.profiles)
        self.axes = control_axes(configuration, self.rig)
        self._tuners = tuners_of(self.axes, configuration.period)
        self._mailbox = Mailbox(len(file.axes), len(self._tuners[0].parameters))
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

    def play(self, faults: Sequence[Fault], changes: Sequence[Change], tick: Progress) -> Simulation:
        script = beginnings(self.machine, faults, self._wire)
        settings = commands([axis.name for axis in self.axes], self._tuners, changes)
        operation = Operation(self._configuration, self.rig, self.axes, self.loop, simulated=True)
        self.machine.start()
        self._every(EVERY, self._records.drain)
        self._every(EVERY, lambda now: tick(min(1.0, now / (self._seconds + 1.0))))
        with _garbage_left():
            operation.run(self._seconds, ready=lambda: self._schedule(script, settings))
        self._truth.finish()
        self._records.end(self._wire.now)
        log = self._records.path
        summary = operation.summary(
            self._mailbox, RIGHTS, None if log is None else str(log.resolve()), self._records.written
        )
        if log is not None:
            keep(log.with_suffix(".json"))
        summary.save()
        return Simulation(self._seconds, self._results(), summary, self._record, self._notes())

    def close(self) -> None:
        self._truth.close()
        self._records.close()
        self._mailbox.close()

    def _nanoseconds(self) -> int:
        """Return the loop's time, ns; a slow computer has taken its time for the cycle by then."""
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
        """The script's times count from the first cycle, which comes a period from now."""
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
            f"axis '{axis.name}': serial {sensor.quantity} is not simulated and says nothing"
            for axis in self._configuration.file.axes
            for sensor in axis.serial
        ]
        unsolved = [
            f"plant's axis '{unit.axis.name}': {count:.0f} sub-steps without a solution; do not trust what follows them"
            for unit in self.machine.axes
            if (count := unit.axis.values()["unsolved"])
        ]
        return (*silent, *unsolved)
