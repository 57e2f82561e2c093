"""What connects the joints of the axes: their sheaths alone, or a limb (MuJoCo) that moves them together.

A joint bends every sheath that crosses it (`[routing]` of the actuator file). The axes are advanced one after another
in pieces. At the beginning of a piece each axis gets the angles and the speeds of the others; in the sub-steps of the
piece the others go on at these speeds.

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

# s between two exchanges of angles where nothing but sheaths connects the joints. What a joint moves otherwise than at
# constant speed meanwhile is a t^2 / 2: at 50 rad/s^2, a fast gait, 25 urad, which change 2.6 rad by 1e-5.
PIECE = 1e-3
_LEAST = 1e-9  # s: less is rounding


class Mechanism(Protocol):
    """Advance all axes of a machine."""

    def advance(self, until: float) -> None:
        """Bring every axis to time `until`, s since the plant's start."""

    def bring_up(self, axis: Axis, until: float) -> None:
        """Bring `axis` to time `until` (s), and with it whatever moves it, because its command is about to change."""


class Apart:
    """Axes that have nothing in common, each in time of its own."""

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
    """Axes whose joints are those of a limb.

    The limb stands at multiples of its step. The axes are brought there, and their torques move the limb by one step
    from where it stood; between two multiples each joint goes on at its speed.
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
    """Give each axis the angles of the joints that bend its sheaths, as they are now."""
    angles = {axis.name: axis.joint[0] for axis in axes}
    speeds = {axis.name: axis.joint[1] for axis in axes}
    for axis in axes:
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
