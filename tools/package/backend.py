"""Build the package with setuptools, and with TSA_COMPILE=1 compile the modules of the cycle to machine code.

    TSA_COMPILE=1 pip install .

mypyc compiles the modules below from the same source. This requires a C compiler and Python's headers. Without the
variable, neither is required and the source is interpreted. `tsa doctor` reports which build is running.

A module may not be listed if it has one of these: a `msgspec.Struct`, a ctypes structure, a TypeVar with values, an
Enum with a constructor, a function of numba, or a base class of an interpreted class. For example, mypyc silently
ignores the class arguments of a Struct, so settings would accept unknown keys and would not be frozen.
`tests/tools/test_compiled.py` checks the list.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from typing import Any

import setuptools
from setuptools import build_meta
from setuptools.command.sdist import sdist

VARIABLE = "TSA_COMPILE"
ROOMS: dict[str, str] = {  # folder of tsa_ctrl: modules that run in each cycle
    "control": (
        "axis bending compensation_limit cycle damping direction estimator kalman law motion_filter reversal setpoint "
        "stretch_estimator temperature tension_estimator torque_feedback"
    ),
    "observer": "friction_proof joint_torque proven_friction stretch",
    "safety": "compensation_backoff debounce lost_commands passivity plausibility polarity_check residuals supervisor",
    "bus/live": "axis image read_back rig",
    "bus/canopen": "cia301 cia402 pdo",
    "daemon": "loop telemetry monitoring",
    "ipc": "mailbox",
    "log": "ring",
    "system": "shared_memory histogram",
    "model": "feedforward stretch",
    "plant": "cia301 cia402 drive faults machine mechanism motion node pdo sensors state",
}
OPTIONS = ("--config-file=", "--ignore-missing-imports", "--follow-imports=silent")  # CI checks the types strictly
TYPES = ("mypy>=2.4", "numpy>=2.0", "msgspec>=0.19")  # mypyc, and the packages whose types it reads


def modules() -> list[str]:
    """Return the paths of the compiled modules."""
    return [f"tsa_ctrl/{room}/{name}.py" for room, names in ROOMS.items() for name in names.split()]


def wanted() -> bool:
    """Return True if the compiled build is requested; raise ValueError for a value that is neither "1" nor "0"."""
    value = os.environ.get(VARIABLE) or "0"
    if value not in ("0", "1"):
        raise ValueError(f'{VARIABLE} is "{value}"; set it to 1 for the compiled build, or unset it')
    return value == "1"


def extensions() -> list[setuptools.Extension]:
    """Return the extension modules of the requested build."""
    if not wanted():
        return []
    from mypyc.build import mypycify

    return mypycify([*OPTIONS, *modules()], opt_level="2", debug_level="0", multi_file=True, group_name="tsa_ctrl")


class SourceArchive(sdist):  # type: ignore[misc]  # setuptools has no types
    """A source archive that contains this backend, which is needed to build it."""

    def make_distribution(self) -> None:
        """Add this file to the file list of setuptools, and make the distribution."""
        self.filelist.append("tools/package/backend.py")
        super().make_distribution()


class Backend(build_meta._BuildMetaBackend):  # type: ignore[misc]
    """The hooks of PEP 517 and PEP 660."""

    def run_setup(self, setup_script: str = "setup.py") -> None:
        """Set up the package without a setup.py. pyproject.toml has the other settings."""
        modules = extensions() if "bdist_wheel" in sys.argv else []  # the metadata does not need them
        setuptools.setup(ext_modules=modules, cmdclass={"sdist": SourceArchive})

    def get_requires_for_build_wheel(self, config_settings: Mapping[str, Any] | None = None) -> list[str]:
        """Return the packages that the build needs in addition to setuptools."""
        return list(TYPES) if wanted() else []

    def get_requires_for_build_editable(self, config_settings: Mapping[str, Any] | None = None) -> list[str]:
        """Return no packages. Reject an editable compiled build, because it would ignore changes of the source."""
        if wanted():
            raise ValueError(
                f"an editable installation runs the source; unset {VARIABLE}, or install without --editable"
            )
        return []


_backend = Backend()
build_sdist = _backend.build_sdist
build_wheel = _backend.build_wheel
build_editable = _backend.build_editable
prepare_metadata_for_build_wheel = _backend.prepare_metadata_for_build_wheel
prepare_metadata_for_build_editable = _backend.prepare_metadata_for_build_editable
get_requires_for_build_wheel = _backend.get_requires_for_build_wheel
get_requires_for_build_sdist = _backend.get_requires_for_build_sdist
get_requires_for_build_editable = _backend.get_requires_for_build_editable
