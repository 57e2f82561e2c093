"""Write controller and plant of a knee whose sheath is bent by the hip (Theta = Theta_0 + g q_hip)."""

from __future__ import annotations

import copy
import dataclasses
from pathlib import Path

import tomlkit

from tests.virtual import joints
from tests.virtual.files import Tables
from tsa_ctrl.model.parameters import load_tendon_sheath, save_model
from tsa_ctrl.model.routing import Route, Routing

RATE = 500.0  # Hz, two axes with encoders and torque sensors
GAIN = 0.8  # rad/rad, wrap angle of the knee's sheath by the hip's angle
SWING = 0.5  # rad, of the hip
SECONDS = 7.0


def files(
    folder: Path,
    load: str,
    frequency: float,
    *,
    follows: bool = True,
    bending: Tables | None = None,
    travel: bool = False,
) -> tuple[Path, Path]:
    """Write controller and plant of a knee, while the hip swings at `frequency` Hz (0: it rests).

    With `follows` the controller's actuator file has the routing. `bending` is [axis.bending] of the knee. With
    `travel` the hip has a travel.
    """
    setpoint = joints.GAIT if load == "imposed" else joints.sine(0.5, 0.5)
    paths = joints.files(folder, load, setpoint)
    controller, plant = (tomlkit.parse(path.read_text(encoding="utf-8")).unwrap() for path in paths)
    controller["controller"]["rate"] = RATE
    (first,) = controller["axis"]
    first["law"]["delay"] = 1.5 / RATE + joints.LAG
    first["drive"]["serial_number"] = 1
    hip = copy.deepcopy(first) | {"name": "hip", "setpoint": {"kind": "constant", "offset": 0.0}}
    for node, number in (("drive", 2), ("encoder", 33), ("torque_sensor", 65)):
        hip[node]["node_id"] = number
    hip["drive"]["serial_number"] = 2
    routing = Routing(*[Route({"hip": GAIN}, {})] * 2)
    if travel:
        hip["limits"]["travel"] = [-1.2 * SWING, 1.2 * SWING]
    if follows:
        first["model"] = "followed.toml"
        del first["estimator"]
        followed = dataclasses.replace(load_tendon_sheath(folder / "true.toml"), routing=routing)
        save_model(followed, folder / "followed.toml")
    if bending is not None:
        first["bending"] = bending
    controller["axis"].append(hip)
    (machine,) = plant["axis"]
    motion = {"kind": "sine", "amplitude": SWING, "frequency": frequency, "ramp": 0.001}
    still = {"kind": "still"}
    plant["axis"].append(
        copy.deepcopy(machine)
        | {"name": "hip", "joint": {"load": "imposed"}, "motion": motion if frequency > 0.0 else still}
    )
    machine["actuator"] = "routed.toml"
    save_model(dataclasses.replace(joints.NOMINAL, routing=routing), folder / "routed.toml")
    for path, tables in zip(paths, (controller, plant), strict=True):
        path.write_text(tomlkit.dumps(tables), encoding="utf-8")
    return paths


def apart(folder: Path, a: float, b: float) -> None:
    """Set different gains of tendons a and b in plant and controller, rad/rad."""
    routing = Routing(Route({"hip": a}, {}), Route({"hip": b}, {}))
    for name in ("routed.toml", "followed.toml"):
        save_model(dataclasses.replace(load_tendon_sheath(folder / name), routing=routing), folder / name)
