"""Test sign and gain of a motor's torque by the reports of its nodes while a small torque begins.

The tendons stretch by the torque, so that motor and joint move apart with its sign, held or free; the joint torque
sensor, where there is one, follows it by r_J/r_M at most. Both are straight lines through all samples of the pull. The
tested loop decides with its own filter (`safety.polarity_check`). A joint that something else moves is not judged: its
friction stretches the tendons a hundred times as far as a small torque does.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import msgspec

from tsa_ctrl.bus.canopen import cia301
from tsa_ctrl.bus.live.axis import Axis
from tsa_ctrl.config import Configuration
from tsa_ctrl.model.steady_sliding import wound_by_friction
from tsa_ctrl.safety.polarity_check import CLEAR, EXCESS, FAR, RESTING, SHOWN

KEPT = 4000  # samples of each axis: the last seconds
LEAST = 20  # samples
HALF = 0.5  # of the largest torque
MOVED = 0.03  # of rated torque that it must have moved by, to show anything


class Pull(msgspec.Struct, frozen=True, kw_only=True):
    """The observations of one axis; correlations are 1, None where there is nothing to see it by."""

    stretch: float | None  # of the motor's torque with how far motor and joint are apart
    sensor: float | None  # with the joint torque sensor
    gain: float | None  # N*m at the joint per N*m of the motor, where the sensor follows clearly
    geared: float  # r_J/r_M: the most that the pulleys give

    @property
    def wrong(self) -> str:
        """In words; empty when nothing contradicts."""
        shown = self.stretch if self.stretch is not None else self.sensor
        if shown is not None and shown < -SHOWN:
            return (
                "motor and joint answer the motor's torque the wrong way round: torque_sign and position_sign of the "
                "drive, sign of the encoder, crossed tendons or motor wires"
            )
        if self.gain is not None and self.gain > EXCESS * self.geared:
            return (
                f"the joint torque sensor follows the motor's torque by {self.gain:.2f}, the pulleys give "
                f"{self.geared:.2f} at most: torque constant and rated torque of the motor, gain of the sensor"
            )
        return ""

    def __str__(self) -> str:
        """For a table."""
        shown = self.stretch if self.stretch is not None else self.sensor
        if self.wrong:
            return "WRONG"
        if shown is None or shown < SHOWN:
            return "not shown"
        return "right" if self.gain is None else f"right, gain {self.gain:.2f} of {self.geared:.2f}"


class Row(NamedTuple):
    """One cycle; nan if it is missing."""

    torque: float  # N*m, the motor's
    apart: float  # rad, q_m - (r_J/r_M) q_j
    joint: float  # N*m, of the joint torque sensor
    angle: float  # rad, of the joint, geared to the motor; the motor's without a joint encoder


def pull(rows: Sequence[Row], rated: float, geared: float, wound: float) -> Pull:
    """`rated`: N*m; `geared`: r_J/r_M; `wound`: rad at the motor by which friction stretches the tendons."""
    torques = [row.torque for row in rows]
    nothing = Pull(stretch=None, sensor=None, gain=None, geared=geared)
    if len(rows) < LEAST or max(torques) - min(torques) < MOVED * rated:
        return nothing
    least = RESTING * wound
    if _moved_by_something(rows, MOVED * rated, least):
        return nothing
    stretch, _ = _line(torques, [row.apart for row in rows])
    most = max(map(abs, torques))
    upper = [row for row in rows if abs(row.torque) > HALF * most]  # below it the sheath's friction may keep all of it
    sensor, slope = _line([row.torque for row in upper], [row.joint for row in upper])
    held = _range([row.angle for row in rows]) <= least  # otherwise a hand may also act
    clear = sensor is not None and slope is not None and sensor > CLEAR and slope < (FAR if held else EXCESS) * geared
    return Pull(stretch=stretch, sensor=sensor, gain=slope if clear else None, geared=geared)


def _moved_by_something(rows: Sequence[Row], begun: float, least: float) -> bool:
    """Return True if the joint moved `least` rad without torque (`begun`, N*m), or against the motor.

    A motor that moves its joint goes ahead of it; one that is drawn along stays behind.
    """
    if _range([row.angle for row in rows if abs(row.torque) < begun]) > least:
        return True
    angles = [row.angle for row in rows]
    against, _ = _line(angles, [row.apart for row in rows])
    return _range(angles) > least and against is not None and against < -SHOWN


def _range(values: Sequence[float]) -> float:
    """0 where nothing is known."""
    known = [value for value in values if math.isfinite(value)]
    return max(known) - min(known) if known else 0.0


def _line(x: Sequence[float], y: Sequence[float]) -> tuple[float | None, float | None]:
    """Correlation and slope; None for a quantity that is not there or does not move."""
    if not all(map(math.isfinite, (*x, *y))):
        return None, None
    mean_x, mean_y = math.fsum(x) / len(x), math.fsum(y) / len(y)
    xx = math.fsum((value - mean_x) ** 2 for value in x)
    yy = math.fsum((value - mean_y) ** 2 for value in y)
    xy = math.fsum((one - mean_x) * (other - mean_y) for one, other in zip(x, y, strict=True))
    return (xy / math.sqrt(xx * yy), xy / xx) if xx * yy > 0.0 else (None, None)


class Watch:
    """Receive the frames of the nodes of one axis in parallel with its loop; `take` every frame, SYNC among them."""

    def __init__(self, configuration: Configuration, index: int, axis: Axis) -> None:
        """`axis`: one of ours, which commands nothing."""
        model, drive = configuration.models[index], axis.nodes.drive
        self._axis = axis
        self._geared = model.joint_pulley_radius / model.motor_pulley_radius
        self._rated = drive.rated_torque * drive.gear_ratio
        self._wound = wound_by_friction(model)
        self._inboxes = dict(zip(axis.tpdo_ids, axis.inboxes, strict=True))
        self._rows: deque[Row] = deque(maxlen=KEPT)
        self._arm()

    @property
    def can_ids(self) -> Iterable[int]:
        """Return the frames that it must receive."""
        return (cia301.SYNC, *self._inboxes)

    def begin(self) -> None:
        """Another loop is started."""
        self._rows.clear()

    def take(self, can_id: int, data: bytes, now: float) -> None:
        """`now` in s."""
        if can_id == cia301.SYNC:
            self._close(now)
            return
        inbox = self._inboxes.get(can_id)
        if inbox is not None and len(data) == inbox.length:
            inbox.store(inbox.unpack(data))
            inbox.armed = False

    def _close(self, now: float) -> None:
        """Everything that answered the last SYNC is one sample."""
        image = self._axis.image
        if not any(inbox.armed for inbox in self._inboxes.values() if inbox.every == 1):
            self._axis.settle(now, True)
            geared = self._geared * image.q_j
            angle = geared if math.isfinite(geared) else image.q_m
            self._rows.append(Row(image.tau_m, image.q_m - geared, image.tau_j, angle))
        self._arm()

    def _arm(self) -> None:
        for inbox in self._inboxes.values():
            inbox.armed = True

    def seen(self) -> Pull:
        return pull(tuple(self._rows), self._rated, self._geared, self._wound)
