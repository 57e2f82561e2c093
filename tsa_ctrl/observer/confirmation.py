"""Compare the innovations of the elongation observer with their uncertainty, to confirm the reported motor torque."""

from __future__ import annotations

import math

from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.observer import tendons

MISFIT = 3.0  # standard deviations of the innovation, beyond which the motor torque or the tendons are others
SMOOTH = 0.005  # s, low-pass of the innovation
# s for which it must last: on healthy rigs single samples come there every ten seconds, four in a row at most
LASTING = 0.01


class Confirmation:
    """`confirmed`: since the last reset, the elongation was as predicted, but for single samples."""

    def __init__(self, model: TendonSheath, noise: float, period: float) -> None:
        """Prepare the test; `noise`: m^2 of one measured elongation; `period`: s."""
        self._stiffest = math.exp(model.axial_stiffness_uncertainty)
        self._softest = 1.0 / self._stiffest
        self._noise = float(noise)
        self._least = MISFIT**2 * self._noise  # m^2: the variance is never less than the noise
        self._share = 1.0 - math.exp(-period / SMOOTH)
        self._most = max(1, round(LASTING / period))  # cycles
        self.reset()

    def reset(self) -> None:
        """Begin again."""
        self.confirmed = True
        self._innovation = 0.0  # m
        self._beyond = 0  # cycles in a row

    def update(self, innovation: float, stiff: float, slid: bool, memory: Array) -> None:
        """Compare the innovation (m) with its standard deviation, and the stiffness (1) with the bounds of the file.

        Args:
            innovation, stiff, slid: of `tendons.observe`.
            memory: of `tendons`, with the uncertainty of its states.
        """
        self._innovation += self._share * (innovation - self._innovation)
        if not self.confirmed:
            return
        squared = self._innovation**2
        if squared <= self._least and self._softest <= stiff <= self._stiffest:  # as expected whatever is known
            self._beyond = 0
            return
        if not slid:
            return
        by_x, by_k = float(memory[tendons.GAIN_S]), float(memory[tendons.GAIN_S + 1])
        x, k, passing, zero = memory[tendons.COVARIANCE :: tendons.STATES + 1].tolist()
        variance = by_x * by_x * (x + passing) + by_k * by_k * k + zero + self._noise
        off = not self._softest <= stiff <= self._stiffest
        self._beyond = self._beyond + 1 if off or squared > MISFIT**2 * variance else 0
        self.confirmed = self._beyond < self._most
