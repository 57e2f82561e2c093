"""Whether motor and joint are apart by more than the torque in use explains: torn, loose, slipped, stuck or reversed.

What is left of q_m - (r_J/r_M) q_j when the torque's stretch tau_M/K is taken off stays where the enable found it, but
for what friction winds up, from one way of sliding to the other. So all that was seen of it since then must fit into
that way; what is not known exactly of stiffness, radii and time widens it, by as much as torque, travel and speed ask
for. It may creep: what was seen is forgotten slowly.

A joint encoder that does not move by one bit is held to more: the joint is held, and then the motor goes no further
than its torque's change stretches the tendons by, whatever the friction is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

SMOOTH = 0.01  # s, low-pass of all of it: a motor rings on its tendons at 40 Hz and more
DOUBT = 0.25  # of the stretch, at least: a stiffness that is a fifth less than its file's
LEAST = 0.02  # rad at the motor: pulleys out of round, eccentric encoders, play
LATE = 2e-3  # s by which one encoder may be later than the other
GEARING = 0.02  # of the way since the enable: the radii at which the tendons lie
CREEP = 0.2  # 1/s of the way that friction may wind up, at which what was seen is forgotten
LASTING = 0.005  # s that it must last, smoothed as it is


@dataclass(frozen=True)
class Give:
    """What tendons, pulleys and encoders of an axis give, at the motor.

    `stiffness`: N*m/rad; `wound`: rad, at most, by friction from one way to the other; `domain`: N*m, beyond which one
    tendon pulls alone and gives twice as much; `play`: rad, of counts and backlash; `doubt`: 1, of the stiffness.
    """

    stiffness: float
    wound: float
    domain: float
    play: float
    doubt: float = DOUBT


class Apart:
    """One axis' check; `update` with every fresh sample while torque is permitted, `reset` when it is not."""

    def __init__(self, give: Give, period: float) -> None:
        """`period`: s."""
        self._compliance = 1.0 / give.stiffness
        self._doubt = give.doubt
        self._domain = give.domain
        self._stuck = give.play + LEAST
        self._width = give.wound * (1.0 + give.doubt) + self._stuck
        self._creep = CREEP * self._width * period
        self._smooth = 1.0 - math.exp(-period / SMOOTH)
        self.reset()

    def reset(self) -> None:
        """Torque is not permitted: the next enable starts afresh."""
        self._torque = self._angle = self._joint = math.nan
        self._first = 0.0  # rad, of the motor at the enable
        self._top, self._bottom = -math.inf, math.inf  # rad, that the rest was at least and at most
        self._held = math.nan  # rad, of a joint encoder that does not move
        self._from = self._low = self._high = 0.0  # rad of the motor, N*m, since it does not

    def update(self, torque: float, angle: float, speed: float, joint: float) -> float | None:
        """Rad by which motor and joint are apart beyond what may be, None while they are not.

        `torque`: N*m that the drive reports; `angle`, `speed`: rad, rad/s of the motor; `joint`: rad, geared.
        """
        if self._torque != self._torque:
            self._torque, self._angle, self._joint, self._first = torque, angle, joint, angle
        smooth = self._smooth
        self._torque += smooth * (torque - self._torque)
        self._angle += smooth * (angle - self._angle)
        self._joint += smooth * (joint - self._joint)
        size = abs(self._torque)
        alone = max(0.0, size - self._domain)
        late = LATE * abs(speed)
        unsure = self._compliance * (self._doubt * size + alone) + late + GEARING * abs(self._angle - self._first)
        rest = self._angle - self._joint - self._compliance * self._torque
        low, high = rest - unsure, rest + unsure
        beyond = max(low - self._bottom, self._top - high) - self._width
        if beyond > 0.0:
            return beyond
        self._top = max(self._top - self._creep, low)
        self._bottom = min(self._bottom + self._creep, high)
        return self._still(joint, alone, late)

    def _still(self, joint: float, alone: float, late: float) -> float | None:
        """The same, of a joint encoder that stands still."""
        torque = self._torque
        if joint != self._held:
            self._held, self._from, self._low, self._high = joint, self._angle, torque, torque
            return None
        self._low, self._high = min(self._low, torque), max(self._high, torque)
        stretch = self._compliance * ((1.0 + self._doubt) * (self._high - self._low) + alone)
        beyond = abs(self._angle - self._from) - stretch - late - self._stuck
        return beyond if beyond > 0.0 else None
