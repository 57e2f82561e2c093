"""Feedforward torque control of a joint driven through a pair of tendon-sheaths."""

from __future__ import annotations

from tsa_ctrl.system.compile_cache import choose
from tsa_ctrl.version import __version__

TYPE_CHECKING = False  # not from typing, whose import takes 5 ms in which Ctrl-C would still print a traceback
if TYPE_CHECKING:
    from tsa_ctrl.daemon.controller import Controller
    from tsa_ctrl.errors import LeaseLostError
    from tsa_ctrl.identify.dataset import Dataset
    from tsa_ctrl.identify.python import calibrate, diagnose, predict
    from tsa_ctrl.ipc.client import Client
    from tsa_ctrl.model.parameters import load_model
    from tsa_ctrl.virtual.simulation import simulate_loop

__all__ = [
    "Client",
    "Controller",
    "Dataset",
    "LeaseLostError",
    "__version__",
    "calibrate",
    "diagnose",
    "load_model",
    "predict",
    "simulate_loop",
]

_MODULES = {
    "Client": "ipc.client",
    "Controller": "daemon.controller",
    "Dataset": "identify.dataset",
    "LeaseLostError": "errors",
    "calibrate": "identify.python",
    "diagnose": "identify.python",
    "load_model": "model.parameters",
    "predict": "identify.python",
    "simulate_loop": "virtual.simulation",
}

choose()


def __getattr__(name: str) -> object:
    """Load a public name on first use, so that the command line does not wait for modules that it does not need."""
    if name in _MODULES:
        import importlib

        return getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
