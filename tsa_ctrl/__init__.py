"""Feedforward torque control of a joint driven through a pair of tendon-sheaths."""

from tsa_ctrl.system.compile_cache import choose
from tsa_ctrl.version import __version__

__all__ = ["__version__"]

choose()
