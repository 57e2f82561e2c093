"""A limb of several joints by MuJoCo (extra `limb`): mass matrix, gravity, limits of the joints, contact.

MuJoCo computes the limb, not the tendons. It is an independent implementation of rigid bodies and contact, so an error
of this project's single joint is not repeated in it.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

import numpy as np

from tsa_ctrl.errors import UsageError

# Steps of the axes per step of the limb. Between two steps of the limb a tendon, K = 62 N*m/rad at the joint with the
# demo's actuator, is stretched by an angle that the limb does not know yet: this damps or drives the joint by at most
# K h. One step gives 6 mN*m*s/rad, as much as the implicit integration of a single joint. Five steps would give
# 31 mN*m*s/rad, a third of the damping of a limb. MuJoCo's step of a leg takes 11 us.
STEPS = 1


class Limb:
    """The joints `names` of an MJCF model; the tendons act on them as torques."""

    def __init__(self, path: Path, names: Sequence[str], angles: Sequence[float], step: float) -> None:
        """Put the joints `names` at `angles` (rad), at rest; `step`: s of the axes. Raises UsageError."""
        mujoco = _package()
        self._mujoco = mujoco
        try:
            model = mujoco.MjModel.from_xml_path(str(path))
        except ValueError as error:
            text = " ".join(str(error).split())
            raise UsageError(f"{path}: no model of a limb ({text}); give an MJCF file") from None
        joints = {model.joint(i).name: i for i in range(model.njnt)}
        for name in names:
            if name not in joints:
                raise UsageError(
                    f"{path}: no joint '{name}', which is an axis of the plant; the joints are {', '.join(joints)}; "
                    "give axes and joints the same names"
                )
            if model.jnt_type[joints[name]] != mujoco.mjtJoint.mjJNT_HINGE:
                raise UsageError(f"{path}: joint '{name}' is no hinge; an axis turns a joint, choose another one")
        places = [joints[name] for name in names]
        self.travel = {
            name: (float(model.jnt_range[i][0]), float(model.jnt_range[i][1]))
            for name, i in zip(names, places, strict=True)
            if model.jnt_limited[i]
        }  # rad
        self._step = STEPS * step
        self._count = 0
        model.opt.timestep = self._step
        # A model that has become unstable is not put back to its start in silence: its angles then show it.
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self._model, self._data = model, mujoco.MjData(model)
        self._angles, self._speeds = model.jnt_qposadr[places], model.jnt_dofadr[places]
        self._data.qpos[self._angles] = angles
        mujoco.mj_forward(model, self._data)

    @property
    def next(self) -> float:
        """Return the time of the end of the next step, s."""
        return (self._count + 1) * self._step

    def step(self, torques: Sequence[float]) -> list[tuple[float, float, float]]:
        """Let `torques` (N*m, one for each joint) act for one step.

        Returns angle (rad), speed (rad/s) and acceleration (rad/s^2, over the step) of each joint.
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
        return importlib.import_module("mujoco")  # slow to import, and an extra
    except ImportError:
        raise UsageError(
            '[mechanism] kind = "mujoco" needs the package mujoco-core, which is not installed; '
            "pip install '.[limb]', or set kind = \"joints\""
        ) from None
