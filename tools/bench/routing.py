"""Tune random legs whose joints bend each other's sheaths by `tsa tune --joint`, and compare with the true models.

Usage: tools/run bench/routing [--seed N] [--legs N] [--from-log] [--processes N] [--json]

A leg has 2 or 3 joints. The sheath of the last joint crosses 1 or 2 others, with gains of 0.3 to 1 rad/rad and either
sign. Every third leg routes its two tendons differently. The file has no routing. Its friction and pretension are wrong
by up to 15 %, and its stiffness by up to 5 %. The plant's tendons are distributed. The goal for the gains is an error
of at most 5 % of the largest gain. The goal for the torque (mN*m) is at most twice the error of the true model, on a
motion that tuning did not use. --from-log tunes from one log of all joints instead of the whole procedure, in a third
of the time.
"""

from __future__ import annotations

import copy
import dataclasses
import itertools
import json
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from tests.virtual import joints
from tools import command
from tools.command import Row
from tsa_ctrl import simulate_loop
from tsa_ctrl.demo.rig import NOMINAL
from tsa_ctrl.model.parameters import TendonSheath, save_model
from tsa_ctrl.model.routing import Route, Routing
from tsa_ctrl.tune.excitation import FREQUENCIES, most_torque, multi_sine
from tsa_ctrl.tune.procedure import Outcome
from tsa_ctrl.tune.session import Plan, Session

RATE = {2: 500.0, 3: 400.0}  # Hz by the number of joints on one bus
SECONDS, VERIFIED, COMPARED = 15.0, 5.0, 6.0  # s of an excitation, a verification and a comparison
LOGGED = 20.0  # s of the log of --from-log
NAMES = ("hip", "knee", "ankle")


@dataclasses.dataclass(frozen=True)
class Leg:
    """A random leg: the joints, and the true model and the model file of the last joint."""

    names: tuple[str, ...]
    true: TendonSheath
    file: TendonSheath
    motions: dict[str, dict[str, Any]]  # motions of the other joints by name


def draw(seed: int) -> Leg:
    """Return the random leg of a seed."""
    rng = np.random.default_rng([seed, 31])
    names = NAMES[: 2 + int(rng.integers(2))]
    others = names[:-1]
    crossed = others if rng.random() < 0.5 else (others[int(rng.integers(len(others)))],)
    sign = {name: float(rng.choice([-1.0, 1.0])) for name in crossed}
    size = {name: float(rng.uniform(0.3, 1.0 / len(crossed))) for name in crossed}
    apart = float(rng.uniform(0.2, 0.5)) if seed % 3 == 0 else 0.0
    a, b = ({name: sign[name] * size[name] * (1.0 + side * apart) for name in crossed} for side in (1.0, -1.0))
    base = NOMINAL
    true = dataclasses.replace(
        base,
        friction_coefficient=base.friction_coefficient * float(rng.uniform(0.7, 1.3)),
        pretension=float(rng.uniform(45.0, 60.0)),
        bending_angle=float(rng.uniform(2.2, 3.2)),
        routing=Routing(Route(a, {}), Route(b, {})),
    )
    off = {name: float(np.exp(rng.uniform(-w, w))) for name, w in (("x", 0.14), ("t", 0.14), ("k", 0.05))}
    file = dataclasses.replace(
        true,
        friction_coefficient=true.friction_coefficient * off["x"],
        pretension=true.pretension * off["t"],
        axial_stiffness=true.axial_stiffness * off["k"],
        routing=None,
    )
    motions = {
        name: {
            "kind": "sine",
            "amplitude": float(rng.uniform(0.35, 0.6)),
            "frequency": float(rng.uniform(0.12, 0.5)),
            "ramp": 0.5,
        }
        for name in others
    }
    return Leg(names, true, file, motions)


def files(folder: Path, leg: Leg) -> tuple[Path, Path]:
    """Write the files of controller and plant. The last joint moves as in a gait, the others follow a sine."""
    rate = RATE[len(leg.names)]
    paths = joints.files(folder, "imposed", joints.GAIT)
    controller, plant = (tomlkit.parse(path.read_text(encoding="utf-8")).unwrap() for path in paths)
    controller["controller"]["rate"] = rate
    (first,), (machine,) = controller["axis"], plant["axis"]
    first["law"] = {"fade_in": 0.5, "compensation": 1.0}
    del first["estimator"]
    controller["axis"], plant["axis"] = [], []
    for place, name in enumerate(leg.names):
        axis, joint = copy.deepcopy(first), copy.deepcopy(machine)
        axis["name"] = joint["name"] = name
        for node, number in (("drive", 1), ("encoder", 32), ("torque_sensor", 64)):
            axis[node]["node_id"] = number + place
        axis["drive"]["serial_number"] = 1 + place
        if name == leg.names[-1]:
            axis["model"], joint["actuator"] = "tuned.toml", "routed.toml"
        else:
            axis["setpoint"] = {"kind": "constant", "offset": 0.0}
            joint["motion"] = leg.motions[name]
            del axis["torque_sensor"]
        controller["axis"].append(axis)
        plant["axis"].append(joint)
    save_model(leg.true, folder / "routed.toml")
    save_model(leg.file, folder / "tuned.toml")
    for path, tables in zip(paths, (controller, plant), strict=True):
        path.write_text(tomlkit.dumps(tables), encoding="utf-8")
    return paths


def error(folder: Path, paths: tuple[Path, Path], model: Path) -> float:
    """Return the RMS error of the last joint with this model after 2 s, mN*m, or nan after a fault."""
    tables = tomlkit.parse(paths[0].read_text(encoding="utf-8")).unwrap()
    tables["axis"][-1]["model"] = str(model)
    controller = folder / "compared.toml"
    controller.write_text(tomlkit.dumps(tables), encoding="utf-8")
    axis = simulate_loop(controller, paths[1], COMPARED).axes[-1]
    if axis.faults:
        return float("nan")
    t = axis.log["t"][axis.counted]
    return 1e3 * joints.rms(axis.error[t >= 2.0])


def recorded(folder: Path, paths: tuple[Path, Path], leg: Leg) -> str:
    """Record a log without compensation while all joints move. Return its path with the name of the axis."""
    tables = tomlkit.parse(paths[0].read_text(encoding="utf-8")).unwrap()
    wave = multi_sine(FREQUENCIES, most_torque(leg.file, tables["axis"][-1]["limits"]["torque"]), LOGGED)
    table = np.column_stack([wave.t, wave.tau_j_des])
    np.savetxt(folder / "wave.csv", table, delimiter=",", header="t,tau_j_des", comments="")
    for axis in tables["axis"]:
        axis["law"]["compensation"] = 0.0
    tables["axis"][-1]["setpoint"] = {"kind": "file", "file": "wave.csv"}
    controller = folder / "recorded.toml"
    controller.write_text(tomlkit.dumps(tables), encoding="utf-8")
    simulate_loop(controller, paths[1], LOGGED, out=folder / "recorded")
    return f"{folder / 'recorded' / 'tsa.mcap'}:{leg.names[-1]}"


def tune(folder: Path, paths: tuple[Path, Path], leg: Leg, from_log: bool) -> Outcome:
    """Tune the last joint, from a log or by the whole procedure."""
    if from_log:
        return Session(paths[0], leg.names[-1], Plan()).from_logs((recorded(folder, paths, leg),))
    plan = Plan(
        seconds=SECONDS, verification_seconds=VERIFIED, joints=leg.names[:-1], plant=paths[1], allow_simulated=True
    )
    session = Session(paths[0], leg.names[-1], plan)
    with session.workspace(folder / "out", keep=True):
        return session.run(lambda phase, share: None)


def tuned(seed: int, from_log: bool) -> list[Row]:
    """Tune the leg of a seed, and return its rows."""
    leg = draw(seed)
    begun = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="tsa-routing-") as name:
        folder = Path(name)
        paths = files(folder, leg)
        outcome = tune(folder, paths, leg, from_log)
        new = folder / "new.toml"
        new.write_text(outcome.text, encoding="utf-8")
        found = outcome.estimate.model.routing or Routing(Route({}, {}), Route({}, {}))
        true = leg.true.routing
        assert true is not None
        pairs = ((found.a.gains, true.a.gains), (found.b.gains, true.b.gains))
        largest = max(abs(gain) for _, gains in pairs for gain in gains.values())
        wrong = max(abs(f.get(j, 0.0) - t.get(j, 0.0)) for f, t in pairs for j in {*f, *t})
        covered = all(
            q.low <= pairs[name.split(".")[0] == "gain_b"][1].get(name.split(".")[1], 0.0) <= q.high
            for name, q in outcome.estimate.calibration.routing.items()
            if name.startswith("gain")
        )
        save_model(
            leg.true.with_effects({"elongation_coupling": {"curvature_profile": "uniform"}}), folder / "true.toml"
        )
        best, after = error(folder, paths, folder / "true.toml"), error(folder, paths, new)
    what = f"seed {seed}, {len(leg.names)} joints, a {gains_of(true.a)}, b {gains_of(true.b)}"
    more = {"a": dict(found.a.gains), "b": dict(found.b.gains), "covered": covered, "s": time.monotonic() - begun}
    return [
        {"what": f"{what}: error of the gains, %", "goal": 5.0, "found": 100.0 * wrong / largest, **more},
        {"what": f"{what}: torque error, mN*m", "goal": 2.0 * best, "found": after},
    ]


def gains_of(route: Route) -> str:
    return " ".join(f"{name} {gain:.2f}" for name, gain in route.gains.items())


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--seed", type=int, default=101, help="of the first leg")
    parser.add_argument("--legs", type=int, default=10)
    parser.add_argument("--from-log", action="store_true", help="tune from a log instead of the whole procedure")
    parser.add_argument("--processes", type=int, default=2)
    command.share(parser, "json")
    chosen = parser.parse_args()
    rows: list[Row] = []
    seeds = range(chosen.seed, chosen.seed + chosen.legs)
    with ProcessPoolExecutor(chosen.processes) as pool:
        for found in pool.map(tuned, seeds, itertools.repeat(chosen.from_log)):
            rows += found
            if chosen.json:
                for row in found:
                    print(json.dumps(row), flush=True)
    if not chosen.json:
        command.print_goals(rows)
    return 0
