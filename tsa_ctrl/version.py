"""Report the version of the package and whether its compiled build is running."""

from __future__ import annotations

from importlib.machinery import EXTENSION_SUFFIXES
from importlib.util import find_spec

__version__ = "0.1.0"
CYCLE = "tsa_ctrl.control.cycle"  # compiled in the compiled build (tools/package/backend.py)


def build_kind() -> str:
    """Return "compiled" if the modules of the cycle are machine code, else "interpreted"."""
    spec = find_spec(CYCLE)
    origin = "" if spec is None else spec.origin or ""
    return "compiled" if origin.endswith(tuple(EXTENSION_SUFFIXES)) else "interpreted"
