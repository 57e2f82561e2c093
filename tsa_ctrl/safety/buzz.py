"""A motor that buzzes on its tendons: torque that swings by itself, from `LOWEST` to a third of the rate.

Such a swing hardly moves the joint and delivers no energy there, so `passivity` does not see it. It is what the law
adds to the wanted torque, above `LOWEST` Hz, block by block: one turn of the friction at a reversal fills a block or
two, a swing that feeds itself all of them. A set-point that has as much of that band explains it, and a turn that
follows the joint does: a hand that trembles turns the friction 25 times a second, and is looked through.
"""

from __future__ import annotations

import math

LOWEST = 20.0  # Hz: above what a limb does; a turn of the friction term has more
BLOCK = 0.04  # s
BLOCKS = 10  # in a row: 0.4 s; the reversals of a motion of 5 Hz are 0.1 s apart, and leave one in between empty
EXPLAINED = 0.2  # of the band's amplitude that the set-point has, from which on the swing is wanted


class Buzz:
    """Looks for it in the motor torque of each cycle; `frequency` in Hz, of the last that was found."""

    def __init__(self, level: float, period: float) -> None:
        """`level`: RMS in N*m at the motor; `period` in s."""
        self._forget = 1.0 - math.exp(-2.0 * math.pi * LOWEST * period)
        self._length = max(2, round(BLOCK / period))
        self._level = level * level * self._length
        self._hertz = 0.5 / (self._length * period)  # of one change of sign in a block
        self.reset()

    def reset(self) -> None:
        """Silence so far."""
        self._added = self._wanted = math.nan  # slow parts
        self.frequency = 0.0
        self._last = 0.0
        self._blocks = self._swings = 0
        self._empty()

    def _empty(self) -> None:
        self._count = self._turns = 0
        self._power = self._explained = 0.0

    def update(self, added: float, wanted: float, turns: bool = False) -> bool:
        """Whether it buzzes, after this cycle; both N*m at the motor: what the law added, and the set-point's part.

        `turns`: the friction term turns as the joint did, and what it adds says nothing.
        """
        slow = self._added
        if not -1e6 < added + wanted < 1e6:
            return False
        if turns or slow != slow:
            self._added, self._wanted = added, wanted
            return False
        fast = added - slow
        self._added = slow + self._forget * fast
        other = wanted - self._wanted
        self._wanted += self._forget * other
        if fast * self._last < 0.0:
            self._turns += 1
        self._last = fast
        self._power += fast * fast
        self._explained += other * other
        self._count += 1
        if self._count < self._length:
            return False
        loud = self._power > self._level and self._explained < EXPLAINED * EXPLAINED * self._power
        self._blocks, self._swings = (self._blocks + 1, self._swings + self._turns) if loud else (0, 0)
        self._empty()
        if self._blocks < BLOCKS:
            return False
        self.frequency = self._hertz * self._swings / self._blocks
        self._blocks = self._swings = 0
        return True
