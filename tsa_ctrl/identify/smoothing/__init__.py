"""Derive position, velocity and acceleration from encoder counts by a zero-phase smoother of data-driven bandwidth.

All commands that derive a velocity or an acceleration use this smoother (`identify.motion`).
"""

from tsa_ctrl.identify.smoothing.bandwidth import LowPass
from tsa_ctrl.identify.smoothing.smoother import Smoothed, smoothed

__all__ = ["LowPass", "Smoothed", "smoothed"]
