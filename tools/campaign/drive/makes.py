"""What `tsa drive diff` shows of each make at power-on, as the plant impersonates it, under its shipped profile."""

from __future__ import annotations

from dataclasses import dataclass
from typing import get_args

from tools.campaign.drive.trial import Station
from tools.campaign.drive.variations import Variation
from tools.command import CONFIG
from tsa_ctrl.bus.drive.backup import Difference, compare, wanted_by
from tsa_ctrl.bus.drive.plan import drive_plan
from tsa_ctrl.bus.drive.profile import DriveProfile, load_profile
from tsa_ctrl.bus.drive.session import Session
from tsa_ctrl.bus.drive.torque_path import drive_scale
from tsa_ctrl.plant.settings import DriveKind

_PDOS = range(0x1400, 0x1C00)


@dataclass(frozen=True)
class Make:
    """A profile, and what a drive of it holds otherwise; None where the plant does not impersonate it."""

    name: str  # of the profile's file
    profile: DriveProfile
    compared: int
    differences: tuple[Difference, ...] | None

    @property
    def short(self) -> str:
        """The differences by their objects, all of the PDOs in one word."""
        if self.differences is None:
            return "not tried: the plant does not impersonate it"
        others = [f"0x{d.entry.index:04X}:{d.entry.subindex}" for d in self.differences if d.entry.index not in _PDOS]
        pdos = [f"PDOs ({sum(d.entry.index in _PDOS for d in self.differences)})"]
        return f"{len(self.differences)} of {self.compared}: {', '.join(others + pdos)}"


def makes() -> list[Make]:
    """One for each profile that is shipped."""
    kinds = get_args(DriveKind)
    names = sorted(path.stem for path in (CONFIG / "drives").glob("*.toml"))
    return [_make(name) if name in kinds else Make(name, load_profile(name, CONFIG), 0, None) for name in names]


def _make(kind: str) -> Make:
    station = Station(Variation(kind, {"kind": kind}, drive={"max_torque": 2.0}, kind=kind))
    file, profile = station.configuration.file, station.configuration.profiles[0]
    axis = file.axes[0]
    plan = drive_plan(
        axis, profile, drive_scale(axis.drive, profile, axis.name), file.bus, station.configuration.period
    )
    with Session(station.wire.host, file.bus) as session:
        wanted = wanted_by(session, axis.drive.node_id, plan)
        differences = compare(session, axis.drive.node_id, wanted)
    return Make(kind, profile, len(wanted), tuple(differences))
