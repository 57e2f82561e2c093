"""Connect the joints of the axes: by their sheaths only, or by a limb (MuJoCo) that moves them together.

A joint bends every sheath that crosses it (`[routing]` of the actuator file). The axes are advanced one after another
in pieces. At the beginning of a piece each axis gets the angles and the speeds of the others; in the sub-steps of the
piece the other joints keep these speeds.

A limb replaces the joints' own loads. It gets the torque that arrives at each of its joints, and gives back how they
move. Joints of the limb that no axis drives (a rail, a toe) move by the limb alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from tsa_ctrl.plant.axis import Axis
from tsa_ctrl.plant.limb import Limb
from tsa_ctrl.plant.settings import PlantSettings

# s between two exchanges of angles if only sheaths connect the joints. In this time a joint deviates from constant
# speed by a t^2 / 2: 25 urad at 50 rad/s^2, a fast gait, which is 1e-5 of a wrap angle of 2.6 rad.
PIECE = 1e-3
_LEAST = 1e-9  # s: less is rounding


class Mechanism(Protocol):
    """Advance all axes of a machine."""

    def advance(self, until: float) -> None:
        """Bring every axis to time `until`, s since the plant's start."""

    def bring_up(self, axis: Axis, until: float) -> None:
        """Bring `axis` to time `until` (s), and with it whatever moves it, because its command is about to change."""


class Apart:
    """Axes without a connection; each is advanced on its own."""

    def __init__(self, axes: Sequence[Axis]) -> None:
        self._axes = axes

    def advance(self, until: float) -> None:
        for axis in self._axes:
            axis.advance(until)

    def bring_up(self, axis: Axis, until: float) -> None:
        axis.advance(until)


class Bent:
    """Axes whose joints bend each other's sheaths, or their own."""

    def __init__(self, axes: Sequence[Axis]) -> None:
        self._axes = axes
        share_angles(axes)

    def advance(self, until: float) -> None:
        time = self._axes[0].time
        while until - time > _LEAST:
            time = min(time + PIECE, until)
            for axis in self._axes:
                axis.advance(time)
            share_angles(self._axes)

    def bring_up(self, axis: Axis, until: float) -> None:
        self.advance(until)


class OnLimb:
    """Axes whose joints belong to a limb.

    The state of the limb is known at multiples of its step. The axes are advanced to the next multiple, and then their
    torques move the limb by one step. Between two multiples each joint keeps its speed.
    """

    def __init__(self, axes: Sequence[Axis], limb: Limb) -> None:
        self._axes = axes
        self._limb = limb
        share_angles(axes)

    def advance(self, until: float) -> None:
        limb = self._limb
        while until - limb.next > _LEAST:
            for axis in self._axes:
                axis.advance(limb.next)
            moved = limb.step([axis.load_torque for axis in self._axes])
            for axis, joint in zip(self._axes, moved, strict=True):
                axis.carry(*joint)
            share_angles(self._axes)
        for axis in self._axes:
            axis.advance(until)

    def bring_up(self, axis: Axis, until: float) -> None:
        self.advance(until)


def share_angles(axes: Sequence[Axis]) -> None:
    """Give each axis the present angles of the joints that bend its sheaths; nothing without a routing."""
    routed = [axis for axis in axes if axis.routing is not None]
    if not routed:
        return
    angles = {axis.name: axis.joint[0] for axis in axes}
    speeds = {axis.name: axis.joint[1] for axis in axes}
    for axis in routed:
        axis.see(angles, speeds)


def build_mechanism(plant: PlantSettings, axes: Sequence[Axis], where: str = "plant") -> Mechanism:
    """Connect the axes of a machine; raises UsageError, whose text begins with `where`, for what does not fit."""
    limb = None
    if plant.mechanism.kind == "mujoco":
        angles = [axis.settings.joint.initial_angle for axis in axes]
        limb = Limb(Path(str(plant.mechanism.model)), [axis.name for axis in axes], angles, plant.physics.step)
    names = [axis.name for axis in axes]
    spans = {axis.name: axis.travel for axis in axes} if limb is None else limb.travel
    travel = {name: span for name, span in spans.items() if span is not None}
    for axis in axes:
        if axis.routing is not None:
            axis.routing.check_joints(names, f"{where}: axis '{axis.name}'")
            axis.routing.check_travel(axis.bending_angle, travel, f"{where}: axis '{axis.name}'")
    if limb is not None:
        return OnLimb(axes, limb)
    return Apart(axes) if all(axis.routing is None for axis in axes) else Bent(axes)
