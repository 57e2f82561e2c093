"""Feedforward torque control of a joint driven through a pair of tendon-sheaths."""

__version__ = "0.1.0"
