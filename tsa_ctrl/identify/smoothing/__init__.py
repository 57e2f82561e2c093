"""Position, velocity and acceleration from the counts of an encoder: a zero-phase smoother, its bandwidth by the data.

Every verb that derives a velocity or an acceleration does it by this one (`identify.motion`).
"""

from tsa_ctrl.identify.smoothing.bandwidth import LowPass
from tsa_ctrl.identify.smoothing.smoother import Smoothed, smoothed

__all__ = ["LowPass", "Smoothed", "smoothed"]
