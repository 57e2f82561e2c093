"""Connect the joints of the axes: by their sheaths only, or by a limb (MuJoCo) that moves them together.

A joint bends every sheath that crosses it (`[routing]` of the actuator file). The axes advance one after another in
pieces. At the beginning of a piece, each axis receives the angles and the speeds of the others. In the sub-steps of the
piece, the other joints keep these speeds.

A limb replaces the loads of the single joints. It receives the torque on each of its joints and returns their motion.
Limb joints without an axis (a rail, a toe) move only with the limb.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Protocol

import numpy as np

from tsa_ctrl.errors import UsageError
from tsa_ctrl.plant.axis import Axis
from tsa_ctrl.plant.settings import PlantSettings

# MuJoCo (extra `limb`) simulates a limb of several joints: mass matrix, gravity, joint limits, contact. It does not
# simulate the tendons. It is an independent implementation of rigid bodies and contact, so it does not repeat an error
# of this project's single joint.

# The limb has the same step h as the axes. Between two limb steps, the tendon elongation changes by an angle that does
# not act on the limb yet. This damps or drives the joint by at most K h, with K = 62 N*m/rad at the joint of the demo
# actuator. This step adds 6 mN*m*s/rad, as much as the implicit integration of a single joint. A step of five times the
# length would add 31 mN*m*s/rad, a third of the damping of a limb. A MuJoCo step of a leg takes 11 us.


class Limb:
    """Simulate the joints `names` of an MJCF model; the tendons act on them as torques."""

    def __init__(self, path: Path, names: Sequence[str], angles: Sequence[float], step: float) -> None:
        """Set the joints `names` at `angles` (rad), at rest; `step` is that of the axes, s. Raises UsageError."""
        mujoco = _package()
        self._mujoco = mujoco
        try:
            model = mujoco.MjModel.from_xml_path(str(path))
        except ValueError as error:
            text = " ".join(str(error).split())
            raise UsageError(f"{path}: cannot be loaded as a model of a limb ({text}); give an MJCF file") from None
        joints = {model.joint(i).name: i for i in range(model.njnt)}
        for name in names:
            if name not in joints:
                raise UsageError(
                    f"{path}: no joint '{name}' for the axis of that name; the joints with names are "
                    f"{', '.join(filter(None, joints)) or 'none'}; give axes and joints the same names"
                )
            if model.jnt_type[joints[name]] != mujoco.mjtJoint.mjJNT_HINGE:
                raise UsageError(f"{path}: joint '{name}' is not a hinge; an axis drives a hinge: choose another joint")
        places = [joints[name] for name in names]
        self.travel = {
            name: (float(model.jnt_range[i][0]), float(model.jnt_range[i][1]))
            for name, i in zip(names, places, strict=True)
            if model.jnt_limited[i]
        }  # rad
        self._step = step
        self._count = 0
        model.opt.timestep = self._step
        # An unstable model must not be reset silently, because then its angles would not show the instability.
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self._model, self._data = model, mujoco.MjData(model)
        self._angles, self._speeds = model.jnt_qposadr[places], model.jnt_dofadr[places]
        self._data.qpos[self._angles] = angles
        mujoco.mj_forward(model, self._data)

    @property
    def next(self) -> float:
        """Return the end time of the next step, s."""
        return (self._count + 1) * self._step

    def step(self, torques: Sequence[float]) -> list[tuple[float, float, float]]:
        """Advance the limb by one step under `torques` (N*m, one for each joint).

        Returns:
            Angle (rad), speed (rad/s) and mean acceleration over the step (rad/s^2) of each joint.
        """
        data = self._data
        before = data.qvel[self._speeds]
        data.qfrc_applied[self._speeds] = torques
        self._mujoco.mj_step(self._model, data)
        self._count += 1
        speeds = data.qvel[self._speeds]
        moved = np.stack((data.qpos[self._angles], speeds, (speeds - before) / self._step), axis=1)
        return [(angle, speed, acceleration) for angle, speed, acceleration in moved.tolist()]


def _package() -> ModuleType:
    try:
        return importlib.import_module("mujoco")  # imported only if needed: it is slow and optional
    except ImportError:
        raise UsageError(
            '[mechanism] kind = "mujoco" needs the package mujoco-core, which is not installed; '
            "pip install '.[limb]', or set kind = \"joints\""
        ) from None


# s between two exchanges of angles if only sheaths connect the joints. In this time, a joint deviates from constant
# speed by a t^2 / 2. In a fast gait (50 rad/s^2) this is 25 urad, or 1e-5 of a wrap angle of 2.6 rad.
PIECE = 1e-3
_LEAST = 1e-9  # s; a smaller difference is a rounding error


class Mechanism(Protocol):
    """Advance all axes of a machine."""

    def advance(self, until: float) -> None:
        """Bring every axis to time `until`, s since the plant's start."""

    def bring_up(self, axis: Axis, until: float) -> None:
        """Advance `axis` and everything that moves it to time `until` (s), because its command is about to change."""


class Apart:
    """Advance axes that are not connected, each on its own."""

    def __init__(self, axes: Sequence[Axis]) -> None:
        self._axes = axes

    def advance(self, until: float) -> None:
        for axis in self._axes:
            axis.advance(until)

    def bring_up(self, axis: Axis, until: float) -> None:
        axis.advance(until)


class Bent:
    """Advance axes whose joints bend each other's sheaths, or their own."""

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
    """Advance axes whose joints belong to a limb.

    The limb's state is available at multiples of its step. The axes advance to the next multiple, and then their
    torques move the limb by one step. Between two multiples, each joint keeps its speed.
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
    """Pass each axis with a routing the present angles and speeds of the joints that bend its sheaths."""
    routed = [axis for axis in axes if axis.routing is not None]
    if not routed:
        return
    angles = {axis.name: axis.joint[0] for axis in axes}
    speeds = {axis.name: axis.joint[1] for axis in axes}
    for axis in routed:
        axis.see(angles, speeds)


def build_mechanism(plant: PlantSettings, axes: Sequence[Axis], where: str = "plant") -> Mechanism:
    """Connect the axes of a machine; raises UsageError, with a text that begins with `where`, for invalid settings."""
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
