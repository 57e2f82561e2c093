"""Run one trial in virtual time: bring the daemon's loop with the plant into a phase, and inject a fault.

Each trial starts from power-on and shares no state with other trials, so its result is reproducible to the last bit.
"""

from __future__ import annotations

import contextlib
import math
import random
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.virtual.daemon import Daemon
from tools.campaign.passive.judge import latches
from tools.campaign.phase.catalogue import BY_NAME, Hazard
from tools.campaign.phase.plan import MOMENTS, Draw, Trial
from tools.campaign.phase.rigs import FADE_IN, controller_of, plant_of
from tsa_ctrl.daemon.build import LoopPhase
from tsa_ctrl.errors import TsaError
from tsa_ctrl.ipc.mailbox import Command
from tsa_ctrl.plant.axis import COLUMNS
from tsa_ctrl.plant.faults import parse_fault
from tsa_ctrl.plant.machine import Machine
from tsa_ctrl.safety.supervisor import Phase
from tsa_ctrl.virtual.lockstep import Wire
from tsa_ctrl.virtual.simulation import Truth

HANG = 0.3  # s, longer than every time-out
HITCH = 0.01  # s, shorter than the shortest time-out of 20 ms
DEAD = 0.6  # s of observation after the death of the loop
REBOOT = 0.03  # s for which a drive has no power


class DiedError(Exception):
    """Report that the loop has died and the trial is over."""


def _foreign(machine: Machine, wire: Wire, can_id: int, data: bytes) -> None:
    """Send a frame to the loop and to the nodes."""
    machine.inject(can_id, data)
    machine.handle(can_id, data, wire.now)


def sync(machine: Machine, wire: Wire) -> None:
    _foreign(machine, wire, 0x080, b"")


def counted_sync(machine: Machine, wire: Wire) -> None:
    _foreign(machine, wire, 0x080, b"\x05")


def command(machine: Machine, wire: Wire) -> None:
    _foreign(machine, wire, 0x201, bytes.fromhex("0f00e803"))  # enabled, at rated torque


def reset(machine: Machine, wire: Wire) -> None:
    _foreign(machine, wire, 0x000, bytes((0x82, 32)))


def sdo(machine: Machine, wire: Wire) -> None:
    _foreign(machine, wire, 0x601, bytes.fromhex("2b00140500000000"))  # 0x1400:5 = 0 disables the time-out of commands


def hang(machine: Machine, wire: Wire) -> None:
    wire.pass_until(wire.now + HANG)


def hitch(machine: Machine, wire: Wire) -> None:
    wire.pass_until(wire.now + HITCH)


def die(machine: Machine, wire: Wire) -> None:
    wire.pass_until(wire.now + DEAD)
    raise DiedError


def exchange(machine: Machine, wire: Wire) -> None:
    """Power two identical drives off, exchange their connectors, and boot them again."""
    one, two = (unit.drive for unit in machine.axes[:2])
    nodes = [unit.by_kind["drive"] for unit in machine.axes[:2]]
    for node in nodes:
        node.power_off()
    one.readings, two.readings = two.readings, one.readings
    one.command, two.command = two.command, one.command
    one.before_change, two.before_change = two.before_change, one.before_change
    numbers = [node.values[0x1018, 4] for node in nodes]
    for node, number in zip(nodes, reversed(numbers), strict=True):
        node.values[0x1018, 4] = number

    def on(now: float) -> None:
        for node in nodes:
            node.boot(now)

    machine.later(wire.now + REBOOT, on)


ACTS: dict[str, Callable[[Machine, Wire], None]] = {
    act.__name__: act for act in (sync, counted_sync, command, reset, sdo, hang, hitch, die, exchange)
}


RECOVER_ACT = "recover"  # `act` of a hazard in which a client requests a recovery
LOOK = 2.5e-4  # s between two checks of the phase
WATCH = 3.0  # s from a fault until its cause is removed, if nothing latches
LATCHED = 0.45  # s of observation after a latch, longer than the torque may last
AFTER = 0.15  # s of observation after that
BRING_UP = 0.25  # s of a startup or a recovery during which the fault is injected
READY = FADE_IN + 0.1  # s of torque before a fault of a running loop
PERIOD = 1e-3  # s between two rows of the truth
LONGEST = 8.0  # s after which a trial is stopped
DESIRED = "tau_j_des"  # N*m of the joint, 0 after a fault and without torque
_PLACE = [name for name, _ in COLUMNS].index("axis")
Traces = dict[str, NDArray[np.float64]]  # columns of the record of one axis of the plant, one row per PERIOD


@dataclass(frozen=True)
class Seen:
    """The results of a trial. Times are in s of the plant's clock.

    Attributes:
        axes: Record of each axis of the plant, with the desired torque as `DESIRED`.
        watch: Time from the fault until its cause was removed, or None if the trial ended before.
        injected: Time of the fault, or None if it was not injected.
        cleared: Time at which the cause was removed, or infinity.
        asked: Time of the last request for torque, or 0 for startup.
        stopped: Time at which a stop was requested, or infinity.
        faults, cause_ids: Texts and identifiers of the faults.
        refused: Text of a TsaError of the daemon, or "".
        crashed: Any other exception of the daemon, or "".
    """

    axes: tuple[Traces, ...]
    watch: float | None
    injected: float | None
    cleared: float
    asked: float
    stopped: float
    faults: tuple[str, ...]
    cause_ids: tuple[str, ...]
    refused: str
    crashed: str


class _Truth(Truth):
    """The true state of the plant, with the desired joint torque in N*m, which `desired` returns for each axis."""

    def __init__(self, axes: int, desired: Callable[[int], float]) -> None:
        super().__init__(axes, PERIOD)
        self._desired = desired
        self._torques: list[list[float]] = [[] for _ in range(axes)]

    def row(self, values: Sequence[float]) -> None:
        super().row(values)
        place = int(values[_PLACE])
        self._torques[place].append(self._desired(place))

    def columns(self, place: int) -> Traces:
        return {**super().columns(place), DESIRED: np.array(self._torques[place])}


class Stage:
    """The plant, the daemon's loop that controls it, and the actions of a trial.

    The time `watch` (s) from the fault until its cause is removed replaces the wait for a latch.
    """

    def __init__(self, draw: Draw, compensation: float | None = None, watch: float | None = None) -> None:
        self.draw = draw
        self.over = False
        configuration = controller_of(draw, compensation)
        file = configuration.file
        self.bound = configuration.zero_torque_within
        self.wire = Wire(file.bus.bitrate)
        self.machine = Machine(plant_of(draw), self.wire.plant, self.wire.plant.clock, self.wire.switch)
        self.wire.attach(self.machine)
        self.truth = _Truth(draw.axes, self._desired)
        self.machine.recorder = self.truth
        self.daemon = Daemon(configuration, self.wire)
        self.loop = self.daemon.loop
        self.injected: float | None = None
        self.cleared = math.inf
        self.asked = 0.0
        self.stopped = math.inf
        self.watch = watch

    def _desired(self, place: int) -> float:
        """Return the joint torque (N*m) that an axis should have: its set-point, or 0 after a fault."""
        axis = self.daemon.axes[place]
        return 0.0 if self.loop.faulty or not axis.terms.permitted else axis.ramp * axis.terms.tau_j_des

    def recover(self) -> None:
        """Request a recovery."""
        self.asked = self.wire.now
        self.daemon.recover()

    def act(self, name: str) -> None:
        """Run one of `ACTS`. Stop the recording if the loop dies."""
        try:
            ACTS[name](self.machine, self.wire)
        except DiedError:
            self.over, self.machine.recorder = True, None
            raise

    def stop(self) -> None:
        """Request a stop, as `tsa stop`."""
        self.stopped = min(self.stopped, self.wire.now)
        self.loop.stop("the trial is over")

    def tune(self, name: str, value: float) -> None:
        """Set a parameter of every axis, as `tsa set`."""
        for place, tuner in enumerate(self.daemon.tuners):
            number = next(n for n, parameter in enumerate(tuner.parameters) if parameter.name == name)
            self.daemon.mailbox.put(Command(place, number, value))

    def begin(self, line: str) -> None:
        """Start a fault in the plant. Ignore a fault of a missing sensor."""
        absent = [("torque_sensor", self.draw.sensor), ("encoder", self.draw.encoder)]
        if any(name in line and not present for name, present in absent):
            return
        _, settings = parse_fault(line)
        self.machine.begin_fault(None, settings, self.wire.now)

    def play(self, trial: Trial) -> Seen:
        """Run the trial."""
        self.machine.start()
        refused = crashed = ""
        script = _Script(self, trial)
        self.wire.at(self.wire.now, script.look)
        try:
            self.daemon.lifecycle.run(math.inf)
        except DiedError:
            pass  # the recording has already ended
        except TsaError as error:
            refused = str(error)
        except Exception as error:  # the trial reports any exception as a crash
            crashed = f"{type(error).__name__}: {error}"
        finally:
            with contextlib.suppress(Exception):
                if not self.over:
                    self.wire.pass_until(self.wire.now + 0.02)
            self.daemon.mailbox.close()
        events = self.daemon.events.all
        axes = tuple(self.truth.columns(place) for place in range(self.draw.axes))
        return Seen(
            axes,
            self.watch,
            self.injected,
            self.cleared,
            self.asked,
            self.stopped,
            tuple(event.text for event in events if event.fault),
            tuple(event.cause_id for event in events if event.fault),
            refused,
            crashed,
        )

    # States for which the script waits.

    @property
    def enabling(self) -> bool:
        return self.daemon.axes[0].supervisor.phase is Phase.ENABLING

    @property
    def enabled(self) -> bool:
        return self.daemon.axes[0].supervisor.phase is Phase.ENABLED

    @property
    def faulted(self) -> bool:
        return self.loop.phase is LoopPhase.FAULTED


class _Script:
    """The steps of a trial, run by a generator that yields between two checks of the phase."""

    def __init__(self, stage: Stage, trial: Trial) -> None:
        self._stage = stage
        self._trial = trial
        self._first_event = 0  # number of the first event after the fault
        self._steps = self._story()
        self._end = stage.wire.now + LONGEST

    def look(self, now: float) -> None:
        stage = self._stage
        if stage.over:
            return
        if now > self._end:
            stage.stop()
            return
        if next(self._steps, False) is not False:
            stage.wire.at(now + LOOK, self.look)

    def _story(self) -> Iterator[bool]:
        stage, trial = self._stage, self._trial
        yield from self._reach(trial)
        offset = trial.moment / MOMENTS * 1e-3
        hazards = [BY_NAME[name] for name in trial.names]
        stage.wire.at(stage.wire.now + offset, lambda now: self._inject(hazards[:1], now))
        if len(hazards) > 1:
            stage.wire.at(stage.wire.now + offset + trial.gap, lambda now: self._inject(hazards[1:], now))
        if trial.phase == "stopping":
            yield from self._wait(1.0)
            return
        yield from self._wait(offset)
        if stage.watch is None:
            yield from self._until(lambda: trial.phase == "fault" or self._latched(), WATCH - LATCHED)
            yield from self._wait(LATCHED)
            stage.watch = stage.wire.now - (stage.injected or stage.wire.now)
        else:
            yield from self._wait(stage.watch)
        if trial.phase in ("fault", "start", "enabling"):
            yield from self._wait(0.1)
        if not any(hazard.stays or hazard.released for hazard in hazards):  # a tendon does not heal
            stage.machine.advance(stage.wire.now)
            stage.machine.faults.clear(stage.wire.now)
            stage.cleared = stage.wire.now
        yield from self._wait(AFTER)
        stage.stop()

    def _reach(self, trial: Trial) -> Iterator[bool]:
        """Wait until the loop reaches the phase of the trial, and then for a share of that phase."""
        stage, phase, share = self._stage, trial.phase, trial.draw.share
        if phase == "start":
            yield from self._wait(share * BRING_UP)
            return
        yield from self._until(lambda: stage.enabling or stage.faulted)
        if phase == "enabling":
            yield from self._wait(share * 4e-3)
            return
        yield from self._until(lambda: stage.enabled or stage.faulted)
        if phase == "ramping":
            yield from self._wait(share * FADE_IN)
            return
        yield from self._wait(READY + 0.1 * share)
        if phase == "running":
            return
        if phase == "tuning":
            stage.tune("compensation", random.Random(trial.draw.seed).choice((0.0, 1.0)))
            stage.tune("setpoint_gain", random.Random(trial.draw.seed).choice((-1.0, 0.5, 1.5)))
            yield from self._wait(0.2 * share)
            return
        if phase == "stopping":
            stage.stop()
            yield from self._wait(0.1 * share)
            return
        anew = phase == "recovering"
        stage.begin("heartbeat_lost duration=0.25" if anew else "emcy")
        yield from self._until(lambda: stage.faulted)
        yield from self._wait(0.35 if anew else 0.12)
        if phase == "fault":
            return
        stage.recover()
        if anew:
            yield from self._until(lambda: stage.loop.recover, 0.5)
            yield from self._wait(share * BRING_UP)
        else:
            yield from self._until(lambda: not stage.faulted, 0.5)
            yield from self._wait(share * 0.05)

    def _latched(self) -> bool:
        """Return True once the loop or a guard has latched after the fault was injected."""
        return any(latches(event) for event in self._stage.daemon.events.since(self._first_event))

    def _inject(self, hazards: Sequence[Hazard], now: float) -> None:
        stage = self._stage
        stage.machine.advance(now)
        if stage.injected is None:
            stage.injected = now
            self._first_event = stage.daemon.events.next_number
        for hazard in hazards:
            for line in hazard.lines:
                stage.begin(line)
            if hazard.act == RECOVER_ACT:
                stage.recover()
            elif hazard.act:
                stage.act(hazard.act)

    def _wait(self, seconds: float) -> Iterator[bool]:
        end = self._stage.wire.now + seconds
        while self._stage.wire.now < end:
            yield True

    def _until(self, reached: Callable[[], bool], patience: float = 4.0) -> Iterator[bool]:
        end = self._stage.wire.now + patience
        while not reached() and self._stage.wire.now < end:
            yield True


def play(trial: Trial, compensation: float | None = None, watch: float | None = None) -> tuple[Seen, float]:
    """Return the results, and the time in s within which the torque must be zero.

    `compensation` replaces the shipped value. `watch` (s) is the time from the fault until its cause is removed. None
    waits until the fault latches, or for `WATCH`.
    """
    stage = Stage(trial.draw, compensation, watch)
    return stage.play(trial), stage.bound
