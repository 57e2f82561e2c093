"""List the data sets with their address, licence, citation, and files with checksums."""

from __future__ import annotations

import difflib
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from tsa_ctrl.errors import UsageError

HERE = Path(__file__).parent
VARIABLE = "TSA_DATA"  # environment variable that states the folder of the data sets
_RAW = "https://raw.githubusercontent.com"


@dataclass(frozen=True)
class File:
    """One log: its path below the set's address, its local name, and the SHA-256 of the converted CSV."""

    source: str
    name: str
    sha256: str


@dataclass(frozen=True)
class Published:
    """A data set. `address` names a commit, so its content cannot change; `model` is the local name of the model file.

    `what` describes the data, `converter` names its entry in `fetch.CONVERTERS`, and `cite` is the reference.
    """

    name: str
    what: str
    address: str
    converter: str
    licence: str
    cite: str
    model: str

    @property
    def files(self) -> tuple[File, ...]:
        """Return the logs of the set in the order of files.txt."""
        lines = (HERE / "files.txt").read_text(encoding="ascii").splitlines()
        rows = [line.split() for line in lines if not line.startswith("#")]
        return tuple(File(*row[1:]) for row in rows if row[0] == self.name)

    @property
    def model_text(self) -> str:
        """Return the text of a model file with a first guess of the actuator."""
        return (HERE / "models" / f"{self.name}.toml").read_text(encoding="utf-8")


SETS: Mapping[str, Published] = MappingProxyType(
    {
        one.name: one
        for one in (
            Published(
                "davinci",
                "torque and angle at both ends of a cable tool, 25 trials of 20 s at 1 kHz",
                f"{_RAW}/MRDLab/mis-tool-characterization/61e124aeb99f3b6f186bf78831733ac3d3aada8c/data/Tool_4_Maryland_L_4",
                "cable_tool",
                "Open Database License 1.0, contents under the Database Contents License",
                "O'Neill, Stephens, Kowalewski, IEEE Robotics and Automation Letters 3(4):3027-3034, 2018",
                "actuator.toml",
            ),
            Published(
                "emps",
                "force and position of a linear axis with a ball screw, 24.8 s at 1 kHz",
                f"{_RAW}/forgi86/sysid-neural-continuous/93afc131780fb1d5477472935a18ac8405683890/examples/EMPS/data",
                "linear_axis",
                "Apache 2.0",
                "Janot, Gautier, Brunot: Data Set and Reference Models of EMPS, Workshop on Nonlinear System "
                "Identification Benchmarks, 2019",
                "emps.toml",
            ),
            Published(
                "epos",
                "torque and speed of a small motor with a lead screw, recorded by its drive",
                f"{_RAW}/RViMLab/TRO2021-Dynamic-Modelling/d2e4a7a02f32a248ddc537c7425aa9b31f39ccea/experiments/driveNo1",
                "drive_recorder",
                "MIT",
                "the repository RViMLab/TRO2021-Dynamic-Modelling",
                "drive.toml",
            ),
        )
    }
)


def find(name: str) -> Published:
    """Return a data set by its name; raise UsageError with the known names."""
    if name not in SETS:
        near = difflib.get_close_matches(name, SETS, n=1)
        raise UsageError(
            f"data: no set '{name}'; " + (f"did you mean '{near[0]}'?" if near else f"available: {', '.join(SETS)}")
        )
    return SETS[name]


def folder() -> Path:
    """Return the default folder of the data sets: $TSA_DATA, or the user's cache."""
    named = os.environ.get(VARIABLE)
    if named:
        return Path(named)
    base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")  # noqa: PTH111 (a Path without a home raises)
    return Path(base, "tsa-ctrl", "data")
