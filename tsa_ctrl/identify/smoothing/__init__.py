"""Position, velocity and acceleration from what an encoder counted: one zero-phase smoother, its bandwidth by the data.

A library so far, for who reads counts in Python: the verbs still filter at cut-offs of their own, since with this one
in their place the diagnosis answered two cases of its blind benchmark worse (warmth, a lag).
"""

from tsa_ctrl.identify.smoothing.smoother import Smoothed, smoothed
from tsa_ctrl.identify.smoothing.zero_phase import LowPass

__all__ = ["LowPass", "Smoothed", "smoothed"]
