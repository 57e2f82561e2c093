"""Feedforward torque control of a joint driven through a pair of tendon-sheaths."""

from __future__ import annotations

from tsa_ctrl.system.compile_cache import choose
from tsa_ctrl.version import __version__

TYPE_CHECKING = False  # as in typing, which takes 5 ms to load: until `tsa` is there Ctrl-C is a traceback
if TYPE_CHECKING:
    from tsa_ctrl.errors import LeaseLostError
    from tsa_ctrl.ipc.client import Client
    from tsa_ctrl.virtual.simulation import simulate_loop

__all__ = ["Client", "LeaseLostError", "__version__", "simulate_loop"]

choose()


def __getattr__(name: str) -> object:
    """Loaded on first use: the command line must not wait for what it does not need."""
    if name == "simulate_loop":
        from tsa_ctrl.virtual.simulation import simulate_loop

        return simulate_loop
    if name == "Client":
        from tsa_ctrl.ipc.client import Client

        return Client
    if name == "LeaseLostError":
        from tsa_ctrl.errors import LeaseLostError

        return LeaseLostError
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
