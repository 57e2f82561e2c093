"""One drive of another manufacturer on a wire in virtual time, and a master that brings it up.

The frames of the master are recorded.
"""

from __future__ import annotations

import contextlib
import itertools
import re
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.plant.bench import plant_file
from tsa_ctrl.bus.drive.bring_up import bring_up
from tsa_ctrl.bus.drive.checks import Report
from tsa_ctrl.bus.drive.profile import DriveProfile
from tsa_ctrl.bus.live.rig import Rig, check_startup
from tsa_ctrl.bus.settings import AxisNodes, BusSettings, DriveSettings, SupervisionSettings
from tsa_ctrl.bus.wire.bus import Frame
from tsa_ctrl.bus.wire.python_can import PythonCan
from tsa_ctrl.errors import TsaError
from tsa_ctrl.plant.drive import Drive
from tsa_ctrl.plant.machine import DriveNode, Machine
from tsa_ctrl.plant.settings import load_plant
from tsa_ctrl.safety.shut_down import shut_down
from tsa_ctrl.safety.supervisor import Phase, Request, Supervisor
from tsa_ctrl.virtual.lockstep import End, Wire

PERIOD = 0.002  # s
MOST_CYCLES = 5000
STILL = "motion.kind = 'still'\nencoder.present = false\ntorque_sensor.present = false\n"  # of a plant's axis
_channels = itertools.count()


def refused(*parts: str) -> pytest.RaisesContext[TsaError]:
    """Expect a TsaError whose message contains these parts in this order."""
    return pytest.raises(TsaError, match=".*".join(re.escape(part) for part in parts))


@contextlib.contextmanager
def served(folder: Path, text: str) -> Iterator[str]:
    """Run a plant with these axes in a thread. Yield its channel on python-can's virtual bus in this process."""
    with running(plant_file(folder, text)) as (name, _):
        yield name


@contextlib.contextmanager
def running(plant: Path) -> Iterator[tuple[str, Machine]]:
    """Run the plant of a file in a thread. Yield its channel and the machine."""
    name = f"drives-{next(_channels)}"
    bus = PythonCan("virtual", name, 1_000_000)
    machine = Machine(load_plant(plant), bus)
    machine.start()
    stop = threading.Event()
    thread = threading.Thread(target=machine.run, args=(stop.is_set,))
    thread.start()
    try:
        yield name, machine
    finally:
        stop.set()
        thread.join()
        bus.close()


class Recording(Wire):
    """A wire that records the host's frames with their times."""

    def __init__(self) -> None:
        super().__init__(1_000_000)
        self.sent: list[tuple[float, int, bytes]] = []

    def send(self, sender: End, can_id: int, data: bytes) -> bool:
        if sender is self.host:
            self.sent.append((self.now, can_id, bytes(data)))
        return super().send(sender, can_id, data)


class Foreign:
    """A plant with one axis without sensors, and its master. `quirks` are lines of the plant's [axis.drive]."""

    def __init__(self, folder: Path, *quirks: str, text: str | None = None) -> None:
        lines = ["[[axis]]", "name = 'joint'", "motion.kind = 'still'", "encoder.present = false"]
        lines += ["torque_sensor.present = false", *(f"drive.{quirk}" for quirk in ("torque_noise = 0.0", *quirks))]
        self.wire = Recording()
        self.machine = Machine(
            load_plant(plant_file(folder, text or "\n".join(lines) + "\n")), self.wire.plant, self.wire.plant.clock
        )
        self.wire.attach(self.machine)
        self.machine.start()
        self.settings = BusSettings(interface="virtual")
        self.rig: Rig | None = None
        self.supervisor = Supervisor(SupervisionSettings(), reports_following=True, shows_late=False, rate=1000.0)
        self.profile = DriveProfile()
        self.axis = AxisNodes(name="knee", drive=DriveSettings(node_id=1))

    @property
    def drive(self) -> Drive:
        return self.machine.axes[0].drive

    @property
    def node(self) -> DriveNode:
        node = self.machine.axes[0].by_kind["drive"]
        assert isinstance(node, DriveNode)
        return node

    def sent(self, *can_ids: int) -> list[Frame]:
        """Return the host's frames with these identifiers, or all of its frames if no identifier is given."""
        return [(can_id, data) for _, can_id, data in self.wire.sent if not can_ids or can_id in can_ids]

    def commands(self) -> list[Frame]:
        """Return the host's frames without SDO uploads."""
        return [frame for frame in self.sent() if not (0x600 < frame[0] < 0x680 and frame[1][0] >> 5 in (2, 3))]

    def bring_up(self, profile: DriveProfile | None = None, reset_faults: bool = False, **drive: object) -> Report:
        self.profile = profile or DriveProfile()
        self.axis = AxisNodes(name="knee", drive=DriveSettings(node_id=1, **drive))  # type: ignore[arg-type]
        return bring_up(self.wire.host, self.settings, [self.axis], [self.profile], PERIOD, reset_faults)

    def start(self, profile: DriveProfile | None = None, reset_faults: bool = False, **drive: object) -> Report:
        """Bring the drive up and check the startup."""
        report = self.bring_up(profile, reset_faults, **drive)
        late = self.profile.mode_shows == "enabled"
        self.supervisor = Supervisor(SupervisionSettings(), self.profile.reports_following, late, rate=1000.0)
        self.rig = Rig(self.wire.host, self.settings, [self.axis], [self.profile])
        self.rig.start()
        check_startup(self.rig, PERIOD)
        return report

    def run(self, request: Request, until: Phase, torque: float = 0.0) -> None:
        """Run cycles until the supervisor reaches the phase `until`, or raise AssertionError with its fault."""
        for _ in range(MOST_CYCLES):
            self.cycle(request, torque)
            if self.supervisor.phase is until:
                return
        raise AssertionError(f"{self.supervisor.phase.value}: {self.supervisor.fault}")

    def cycle(self, request: Request, torque: float = 0.0, cycles: int = 1) -> None:
        rig = self.rig
        assert rig is not None
        for _ in range(cycles):
            begin = rig.wait(self.wire.now + PERIOD)
            rig.sync(begin)
            rig.collect(begin + 0.8 * PERIOD)
            controlword, permitted, _ = self.supervisor.update(rig.axes[0].image, begin, request)
            rig.axes[0].command(controlword, torque if permitted else 0.0)
            rig.heartbeat(begin)

    def enable(self, torque: float = 0.0) -> None:
        self.cycle(Request.DISABLE, cycles=3)
        self.run(Request.ENABLE, Phase.ENABLED)
        self.cycle(Request.ENABLE, torque, cycles=10)

    def stop(self) -> list[str]:
        """Shut the drive down and return a message for each step that was not confirmed."""
        assert self.rig is not None
        return shut_down(self.rig, PERIOD)

    def wait(self, seconds: float) -> None:
        """Let time pass without any action of the host."""
        self.wire.pass_until(self.wire.now + seconds)
