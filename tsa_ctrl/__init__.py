"""Feedforward torque control of a joint driven through a pair of tendon-sheaths."""

from tsa_ctrl.compile_cache import choose

__version__ = "0.1.0"

choose()
