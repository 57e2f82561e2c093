"""The turn of the friction term: a motion of the motor that is planned so that it ends without a swing.

When the direction of the tendon changes, the tension at the motor must go through the whole loop, and the motor must
move by the stretch that goes with it (`front`). Its inertia forbids a step. So the stretch follows a cycloid in time,

    s/s_end = y - sin(2 pi y) / 2 pi,     y = time / duration in [0, 1],     s'' = 0 at both ends,

the torque follows from the stretch by the front, p = S^-1(s), and the inertia's own torque J_M s'' / r_M is added by
the law. Evenly bent the torque is the root of the stretch. A turn that begins before another has ended is added to it.
No feedback: a delay of the command only shifts it, and is led. (Input shaping by one period of the ringing, which is
the other way, needs 10 ms at 100 Hz and more for a heavier motor; this needs no more than the drive can follow.)
"""

from __future__ import annotations

import itertools
import math

from tsa_ctrl.control.front import Front

_STEPS = 64  # of y
_SOFT = 0.02  # of s_c: no part of the torque turns without any stretch, where all bends sit at the motor


class Turn:
    """A turn of the friction term.

    Attributes: `force` and `stretch`: in [-1, 1], how far torque and stretch have turned. `bend`: d^2 stretch / dt^2,
    1/s^2. `turning`: False once the turn is over.
    """

    def __init__(self, front: Front, duration: float, period: float) -> None:
        """`duration` of a whole turn and `period` in s."""
        self.duration = duration
        self._step = period / duration
        self._force = _course(front)
        self._ramps: list[list[float]] = []
        self.reset()

    def reset(self, sigma: float = 0.0) -> None:
        """Be turned to `sigma` without having moved."""
        self.force = self.stretch = self._end = self._base = sigma
        self.bend = 0.0
        self.turning = False
        self._ramps.clear()

    def update(self, sigma: float, age: float = 0.0) -> None:
        """One period on; a new `sigma` begins a turn to it, which is `age` periods old already."""
        ramps = self._ramps
        if sigma != self._end:
            ramps.append([sigma - self._end, age * self._step])
            self._end = sigma
        elif not ramps:
            self.force = self.stretch = self._end
            self.bend = 0.0
            return
        force = stretch = self._base
        bend = 0.0
        two_pi = 2.0 * math.pi
        for ramp in ramps:
            size, y = ramp
            sine = math.sin(two_pi * y)
            place = y * _STEPS
            i = int(place)
            force += size * (self._force[i] + (place - i) * (self._force[i + 1] - self._force[i]))
            stretch += size * (y - sine / two_pi)
            bend += size * sine
            ramp[1] = y + self._step
        self.force, self.stretch = force, stretch
        self.bend = two_pi * bend / (self.duration * self.duration)
        while ramps and ramps[0][1] >= 1.0:
            self._base += ramps.pop(0)[0]
        self.turning = bool(ramps)

    def steepest(self) -> float:
        """Largest change of `force` within a period, for a turn from 0 to 1."""
        count = max(1, math.ceil(1.0 / self._step))
        values = [self.at(i * self._step) for i in range(count + 1)]
        return max(after - before for before, after in itertools.pairwise(values))

    def at(self, y: float) -> float:
        """Share of the torque that has turned at y."""
        place = min(1.0, max(0.0, y)) * _STEPS
        i = min(int(place), _STEPS - 1)
        return self._force[i] + (place - i) * (self._force[i + 1] - self._force[i])


def _course(front: Front) -> tuple[float, ...]:
    """The torque's share at equal steps of y."""
    table, soft = front.table, _SOFT * max(front.centre, 1e-6)
    last = len(table) - 1
    softened = [s + soft * i / last for i, s in enumerate(table)]
    shares = []
    for k in range(_STEPS + 1):
        y = k / _STEPS
        wanted = softened[-1] * (y - math.sin(2.0 * math.pi * y) / (2.0 * math.pi))
        i = 0
        while i < last - 1 and softened[i + 1] <= wanted:
            i += 1
        shares.append(min(1.0, (i + (wanted - softened[i]) / (softened[i + 1] - softened[i])) / last))
    return tuple(shares)
