"""Run one variation in virtual time: start, torque, fault, recovery, power cycle, recovery, stop, second start."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import tomlkit

from tests.daemon.machine import CONFIG
from tests.drives.rig import Recording
from tests.drives.variations import Variation
from tests.virtual.daemon import Daemon
from tests.virtual.files import controller, plant, write
from tsa_ctrl.config import Configuration, load_configuration
from tsa_ctrl.daemon.build import LoopPhase
from tsa_ctrl.errors import TsaError
from tsa_ctrl.ipc.protocol import Event
from tsa_ctrl.plant.machine import AxisNodes, DriveNode, Machine
from tsa_ctrl.plant.settings import FaultSettings, PlantSettings, load_plant
from tsa_ctrl.safety.causes import REMEDIES
from tsa_ctrl.safety.release import REST

WANTED = 0.5  # N*m at the joint
PULLS = 0.1  # N*m at the motor above which the drive counts as delivering torque
LATENCY = 0.25  # s, the default of [safety] zero_torque_within
STEADY = 0.1  # s with torque, or without torque, before the next step
PATIENCE = 120.0  # s, enough for the startup of the slowest drive
LATER = 2.0  # s after a stop, enough for every watchdog to detect the missing master
LOOK = 0.01  # s between two checks

Story = Iterator[None]
_OVER = object()


@dataclass(frozen=True)
class Outcome:
    """Result of one trial.

    `message` is the error of a rejected start, else the text that the variation expects.
    `wrong` lists the failed checks.
    """

    variation: Variation
    started: bool
    message: str
    wrong: tuple[str, ...]

    @property
    def good(self) -> bool:
        """Return True if the outcome is the one that the variation requires."""
        expected = self.variation.refused or self.variation.told
        return self.started is not bool(self.variation.refused) and not self.wrong and expected in self.message


class Station:
    """A plant with one deviating drive, on which the daemon's loop can be started several times."""

    def __init__(self, variation: Variation, folder: Path) -> None:
        self.configuration = _configuration(variation, folder)
        self.wire = Recording()
        self.machine = Machine(_plant(variation, folder), self.wire.plant, self.wire.plant.clock)
        self.wire.attach(self.machine)
        self.machine.start()
        self.wire.pass_until(0.05)  # actions of the drive without a master happen before the start
        self.told: list[str] = []
        self.history: list[Event] = []
        self.first_fault = ""
        self.pulled = self.proved = self.ended = False
        self.released = -math.inf  # s, time of the last recovery request

    @property
    def unit(self) -> AxisNodes:
        return self.machine.axes[0]

    @property
    def torque(self) -> float:
        """Return the magnitude of the torque that the power stage is commanded (N*m)."""
        return abs(self.unit.axis.command.torque)

    @property
    def node(self) -> DriveNode:
        node = self.unit.by_kind["drive"]
        assert isinstance(node, DriveNode)
        return node

    def run(self, story: Story) -> list[str]:
        """Run the daemon until `story` ends. Return the drives that did not confirm the shutdown."""
        daemon = self.daemon = Daemon(self.configuration, self.wire, self.told.append)
        loop = daemon.loop
        self.proved = self.ended = False

        def look(now: float) -> None:
            self.pulled = self.pulled or self.torque > PULLS
            refused = loop.phase is LoopPhase.FAULTED and not self.pulled
            self.ended = refused or loop.cause is not None
            if next(story, _OVER) is _OVER:
                loop.stop("the story is over")
            else:
                self.wire.at(now + LOOK, look)

        def begin() -> None:
            self.proved = True
            self.wire.at(self.wire.now + LOOK, look)

        try:
            daemon.lifecycle.run(math.inf, ready=begin)
            daemon.telemetry.check(0.0, 0)
        finally:
            daemon.mailbox.close()
            self.history += daemon.events.all
            fault = daemon.events.first_fault
            self.first_fault = "" if fault is None else f"{fault.text}; {REMEDIES[fault.cause_id]}"
        return daemon.lifecycle.unconfirmed

    def recover(self) -> None:
        """Request a recovery and store its time. The loop permits one recovery per REST seconds."""
        self.released = self.wire.now
        self.daemon.recover()

    def begin(self, fault: str, duration: float = 0.0) -> None:
        self.machine.begin_fault(None, FaultSettings(name=fault, duration=duration), self.wire.now)


def _configuration(variation: Variation, folder: Path) -> Configuration:
    """Return a controller of one axis without sensors, with the keys of the variation."""
    shutil.copytree(CONFIG / "drives", folder / "drives", dirs_exist_ok=True)
    (folder / "drives" / "mine.toml").write_text(tomlkit.dumps(variation.profile), encoding="utf-8")
    tables = controller(
        drive={"rpdo_timeout": 0.05, "profile": variation.kind or "mine", **variation.drive},
        encoder=None,
        torque_sensor=None,
        estimator={"kind": "fixed", "use": False},
        setpoint={"kind": "constant", "offset": WANTED, "amplitude": None, "frequency": None},
        law={"fade_in": 0.05},
        limits={"torque": 1.9},
        file={
            "bus": {"supervision": variation.supervision},
            "controller": {"rate": variation.rate, "settle_cycles": 10, "stop_time": 0.1},
            "log": {"enabled": False},
        },
    )
    return load_configuration(write(folder, tables)[0])


def _plant(variation: Variation, folder: Path) -> PlantSettings:
    """Return a plant at standstill, with the drive of the variation and no sensors."""
    absent = {"present": False}
    drive = {"torque_noise": 0.0, **variation.quirks}
    tables = plant(drive=drive, encoder=absent, torque_sensor=absent, motion={"kind": "still"})
    return load_plant(write(folder, plant_tables={**tables, "physics": {}})[1])


def run_trial(variation: Variation, folder: Path) -> Outcome:
    """Run the whole sequence of a variation once and return its outcome."""
    station = Station(variation, folder)
    wrong: list[str] = []
    try:
        wrong += station.run(_story(station, wrong))
    except TsaError as error:
        return Outcome(variation, False, str(error), tuple(wrong + _commanded(station)))
    refusal = station.first_fault
    if refusal and not station.pulled:
        return Outcome(variation, False, refusal, ())
    wrong += _afterwards(station)
    return Outcome(variation, True, _told(station, variation), tuple(wrong))


def _story(station: Station, wrong: list[str]) -> Story:
    """Act on a running loop and check the reactions. Each `yield` lets some cycles pass."""

    def pulls() -> bool:
        return station.torque > PULLS

    def rests() -> bool:
        return station.torque == 0.0

    yield from _until(station, pulls, "no torque after the start", wrong)
    for fault, duration in (("fault", 0.0), ("power_cycle", 0.02)):
        yield from _until(station, lambda: False, "", [], STEADY)
        station.begin(fault, duration)
        yield from _until(station, rests, f"torque {LATENCY:g} s after {fault}", wrong, LATENCY)
        yield from _until(station, lambda: False, "", [], STEADY)
        if not rests():
            wrong.append(f"torque came back by itself after {fault}")
        yield from _until(station, lambda: station.wire.now > station.released + REST, "", [])
        station.recover()
        yield from _until(station, pulls, f"no torque after the recovery from {fault}", wrong)
    yield from _until(station, lambda: False, "", [], STEADY)


def _until(
    station: Station, reached: Callable[[], bool], otherwise: str, wrong: list[str], patience: float = PATIENCE
) -> Story:
    end = station.wire.now + patience
    while not reached():
        if station.wire.now >= end or station.ended:
            if otherwise:
                wrong.append(otherwise)
            return
        yield


def _afterwards(station: Station) -> list[str]:
    """Check the drive after the stop and start it again.

    Without a master the drive must be off and without a fault. The second start must deliver torque, and the drive must
    not have stored its parameters.
    """
    wrong = []
    if station.torque:
        wrong.append("torque after the stop")
    station.wire.pass_until(station.wire.now + LATER)
    state = station.unit.drive.machine.state.name
    if state not in ("SWITCH_ON_DISABLED", "NOT_READY_TO_SWITCH_ON", "READY_TO_SWITCH_ON"):
        wrong.append(f"{state.lower()} after the stop")
    again: list[str] = []

    def story() -> Story:
        yield from _until(station, lambda: station.torque > PULLS, "no torque at the second start", again)

    try:
        wrong += station.run(story())
    except TsaError as error:
        again.append(f"the second start: {error}")
    if station.node.storage.saves:
        wrong.append("its parameters were stored")
    return wrong + again


def _commanded(station: Station) -> list[str]:
    """Return an error if RPDOs were sent although the start was rejected."""
    rpdos = [data for _, can_id, data in station.wire.sent if can_id == 0x201]
    return ["RPDOs were sent"] if rpdos and not station.proved else []


def _told(station: Station, variation: Variation) -> str:
    """Return the first text that contains the `told` of the variation, or an empty string."""
    texts = [*station.told, *(event.text for event in station.history)]
    return next((text.strip() for text in texts if variation.told and variation.told in text), "")
