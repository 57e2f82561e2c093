"""Simulate a machine without bus and real time. The test sends the frames and advances the clock."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import msgspec

from tests.bus.fake import FakeBus, FakeClock
from tsa_ctrl.plant.axis import Axis
from tsa_ctrl.plant.machine import AxisNodes, Machine
from tsa_ctrl.plant.settings import AxisSettings, PhysicsSettings, PlantSettings, load_plant

ACTUATOR = """\
[actuator]
motor_pulley_radius = 0.020
joint_pulley_radius = 0.025
[tendon]
axial_stiffness = 60e3
unstrained_length = 1.2
diameter = 0.6e-3
[sheath]
friction_coefficient = 0.10
bending_angle = 2.6
contact_offset = 0.4e-3
[pretension]
value = 45.0
"""
X = 0.26  # friction angle of this actuator
T_P0 = 45.0  # N
R_M, R_J = 0.020, 0.025  # m


def actuator_file(folder: Path, text: str = ACTUATOR) -> str:
    path = folder / "actuator.toml"
    path.write_text(text)
    return str(path)


def plant_file(folder: Path, text: str = "[[axis]]\nname = 'joint'\n") -> Path:
    """Write plant.toml next to its actuator file."""
    actuator_file(folder)
    path = folder / "plant.toml"
    path.write_text(text)
    return path


def axis(folder: Path, step: float = 1e-4, **settings: Any) -> Axis:
    """Return the mechanics of one axis, by default without lag, motor inertia and losses.

    `settings` change the tables of its [[axis]].
    """
    tables: dict[str, Any] = {
        "name": "joint",
        "actuator": settings.get("actuator") or actuator_file(folder),
        "motor": {"inertia": 0.0, "damping": 1e-12},
        "drive": {"torque_time_constant": 0.0},
    }
    tables.update(settings)
    return Axis(msgspec.convert(tables, AxisSettings), PhysicsSettings(step=step))


class Bench:
    """A machine on a fake bus. Its time advances only by `wait` and `sync`."""

    def __init__(self, folder: Path, text: str = "[[axis]]\nname = 'joint'\n", plant: PlantSettings | None = None):
        self.clock = FakeClock()
        self.bus = FakeBus(self.clock)
        self.machine = Machine(plant or load_plant(plant_file(folder, text)), self.bus, self.clock)
        self.machine.start()

    @property
    def unit(self) -> AxisNodes:
        return self.machine.axes[0]

    def send(self, can_id: int, data: bytes = b"") -> list[tuple[int, bytes]]:
        """Send one frame to the nodes, and return their answers."""
        before = len(self.bus.sent)
        self.machine.handle(can_id, data, self.clock.now)
        return self.bus.sent[before:]

    def wait(self, seconds: float, step: float = 1e-3) -> list[tuple[int, bytes]]:
        """Advance the time with ticks, and return the frames sent meanwhile."""
        before = len(self.bus.sent)
        end = self.clock.now + seconds
        while self.clock.now < end - 1e-9:
            self.clock.now = min(end, self.clock.now + step)
            for transmit in self.unit.transmit.values():
                transmit.release(self.clock.now)
            self.machine.tick(self.clock.now)
        return self.bus.sent[before:]

    def sync(self, count: int = 1, rpdo: bytes | None = None) -> list[tuple[int, bytes]]:
        """Send SYNC `count` times with a period of 1 ms, and return the frames sent in the last period."""
        frames: list[tuple[int, bytes]] = []
        for _ in range(count):
            self.clock.now += 1e-3
            frames = self.send(0x80)
            if rpdo is not None:
                self.send(0x201, rpdo)
        return frames

    def download(self, node: int, index: int, sub: int, code: str, value: int) -> int:
        """Do an expedited SDO download. Return the abort code, or 0 if it was accepted."""
        data = struct.pack("<" + code, value)
        command = 0x23 | (4 - len(data)) << 2
        answers = self.send(0x600 + node, struct.pack("<BHB", command, index, sub) + data.ljust(4, b"\0"))
        answer = next(data for can_id, data in answers if can_id == 0x580 + node)
        return 0 if answer[0] == 0x60 else int(struct.unpack_from("<I", answer, 4)[0])

    def upload(self, node: int, index: int, sub: int, code: str) -> int:
        """Do an expedited SDO upload of a number, and return it."""
        answers = self.send(0x600 + node, struct.pack("<BHB4x", 0x40, index, sub))
        answer = next(data for can_id, data in answers if can_id == 0x580 + node)
        assert answer[0] & 0xF3 == 0x43, answer.hex()
        return int(struct.unpack_from("<" + code, answer, 4)[0])

    def map_pdo(self, node: int, parameter: int, cob_id: int, transmission: int, *mapped: int) -> list[int]:
        """Do the procedure to map a PDO, and return the abort code of each step."""
        mapping = parameter + 0x200
        steps = [(parameter, 1, "I", 0x80000000 | cob_id), (mapping, 0, "B", 0)]
        steps += [(mapping, place, "I", entry) for place, entry in enumerate(mapped, 1)]
        steps += [(mapping, 0, "B", len(mapped)), (parameter, 2, "B", transmission), (parameter, 1, "I", cob_id)]
        return [self.download(node, *step) for step in steps]

    def set_up(self, rpdo_transmission: int = 1) -> None:
        """Configure the PDOs of the drive and mode 10, and set all nodes operational."""
        self.map_pdo(1, 0x1400, 0x201, rpdo_transmission, 0x60400010, 0x60710010)
        self.map_pdo(1, 0x1800, 0x181, 1, 0x60410010, 0x60770010, 0x606C0020)
        self.map_pdo(1, 0x1801, 0x281, 1, 0x60640020, 0x60610008, 0x603F0010)
        self.download(1, 0x6060, 0, "b", 10)
        self.send(0x000, b"\x01\x00")

    def command(self, controlword: int, per_mille: int = 0) -> bytes:
        return struct.pack("<Hh", controlword, per_mille)

    def enable(self, per_mille: int = 0) -> None:
        """Bring the drive to operation enabled."""
        for controlword in (0x06, 0x07, 0x0F):
            self.sync(2, self.command(controlword))
        self.sync(2, self.command(0x0F, per_mille))

    def statusword(self) -> int:
        return int(struct.unpack_from("<H", dict(self.sync())[0x181])[0])


def tpdo1(frames: list[tuple[int, bytes]]) -> tuple[int, int, int]:
    """Return statusword, torque (per mille) and velocity (mrpm) from the drive's TPDO1."""
    status, torque, velocity = struct.unpack("<Hhi", dict(frames)[0x181])
    return status, torque, velocity
