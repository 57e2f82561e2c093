"""`tsa init`: write commented files, as a template for a rig that moves nothing yet, or as a set for a desk."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tsa_ctrl.errors import UsageError
from tsa_ctrl.outputs import make_folder

if TYPE_CHECKING:
    from tsa_ctrl.demo.rig import Play

SHIPPED = Path(__file__).parents[1] / "shipped"
MOTION = "motion.csv"
COMMENTS = 33  # column of the comments in the example files
_HEADER = re.compile(r"(?:# )?\[\[?(?P<table>[a-z_.]+)\]\]?")
_KEY = re.compile(r"(?:# )?(?P<key>[a-z_]+) = [^#]*(?P<comment>#.*)?$")

# A desk has no CAN and no real-time rights, and its machine is loaded. Stalls of 10 ms and more are tolerated, because
# no motor moves.
LOCAL_BUS = {"interface": '"udp_multicast"', "channel": '"239.255.74.1"'}  # RFC 2365: this machine only
Changes = Mapping[str, Mapping[str, str | None]]  # by table and key: the value, or None to comment the key out
DESK: dict[str, Changes] = {
    "controller.toml": {
        "controller": {"rate": "250.0", "settle_cycles": "20"},
        "bus": LOCAL_BUS,
        "bus.supervision": {"tolerated_misses": "50", "tolerated_drops": "50", "lost_share": "0.5"},
        "realtime": {"allow_without": "true"},
        "axis.drive": {"host_timeout": "0.5", "rpdo_timeout": "0.2", "heartbeat_timeout": "1.0"},
    },
    "plant.toml": {"bus": LOCAL_BUS},
}

# On a rig, set-point, compensation and limit permit no torque until the user has filled in the values.
NODE_ID = "1 to 127"  # for keys without a comment
EMPTY = '""'  # a value that only the user knows; `tsa run --check` lists them all
MODEL: Changes = {
    "actuator": {"motor_pulley_radius": EMPTY, "joint_pulley_radius": EMPTY},
    "tendon": {"axial_stiffness": EMPTY, "unstrained_length": EMPTY, "diameter": EMPTY},
    "sheath": {
        "friction_coefficient": EMPTY,
        "bending_angle": EMPTY,
        "contact_offset": None,
        "bending_centre": None,
    },
    "pretension": {"value": EMPTY},
}
RIG: dict[str, Changes] = {
    "controller.toml": {
        "bus": {"channel": '"can0"'},
        "axis.drive": {
            "node_id": EMPTY,
            "rated_torque": EMPTY,
            "counts_per_revolution": EMPTY,
            "gear_ratio": EMPTY,
            "max_torque": None,
        },
        "axis.encoder": {"node_id": EMPTY, "counts_per_revolution": EMPTY},
        "axis.torque_sensor": {"node_id": EMPTY},
        "axis.setpoint": {"kind": '"constant"', "amplitude": None, "frequency": None},
        "axis.law": {"compensation": "0.0"},
        "axis.limits": {"torque": None, "torque_share": "0.1"},
    },
    "actuator.toml": MODEL,
    "plant.toml": {"bus": LOCAL_BUS},  # never on the bus of the rig
}

AXIS = "[[axis]]"  # start of the part of a file that is repeated for each joint of a leg
LEG_RATE = "500.0"  # Hz: three joints with encoders and torque sensors fit on one bus with lean PDOs


def leg() -> tuple[dict[Path, str], dict[Path, str]]:
    """Return the files of a leg, and the motion and torque of each joint as CSV."""
    from tsa_ctrl.demo.leg import ROUTING, strides

    desk = {name: dict(changes) for name, changes in DESK.items()}
    drive = dict(desk["controller.toml"].pop("axis.drive"))
    desk["controller.toml"]["controller"] = {**desk["controller.toml"]["controller"], "rate": LEG_RATE}
    heads, blocks = {}, {}
    for name, changes in desk.items():
        head, _, block = (SHIPPED / name).read_text(encoding="utf-8").partition(f"\n{AXIS}")
        heads[name], blocks[name] = with_values(head, changes), AXIS + block
    controllers, plants, texts = [heads["controller.toml"]], [heads["plant.toml"]], {}
    for place, (joint, gains) in enumerate(ROUTING.items()):
        motion = f'"{joint}.csv"'
        controllers.append(
            _repeated(
                blocks["controller.toml"],
                place,
                {
                    "axis": {"name": f'"{joint}"', "model": f'"{joint}.toml"'},
                    "axis.drive": {
                        **drive,
                        "node_id": str(1 + place),
                        "serial_number": str(1 + place),
                        "pdo": '"lean"',
                    },
                    "axis.encoder": {"node_id": str(32 + place)},
                    "axis.law": {"motor_inertia": "1e-4"},  # equals the simulated motor's value
                    "axis.torque_sensor": {"node_id": str(64 + place)},
                    "axis.setpoint": {
                        "kind": '"file"',
                        "amplitude": None,
                        "frequency": None,
                        "file": motion,
                        "loop": "true",
                    },
                },
            )
        )
        plants.append(
            _repeated(
                blocks["plant.toml"],
                place,
                {
                    "axis": {"name": f'"{joint}"', "actuator": f'"{joint}.toml"'},
                    "axis.motion": {"kind": '"file"', "file": motion, "repeat": "true"},
                },
            )
        )
        joints = ", ".join(f"{name} = {gain:g}" for name, gain in gains.items())
        actuator = (SHIPPED / "actuator.toml").read_text(encoding="utf-8")
        texts[Path(f"{joint}.toml")] = (
            with_values(actuator, {"routing": {"joints": f"{{ {joints} }}"}}) if gains else actuator
        )
    texts[Path("controller.toml")], texts[Path("plant.toml")] = "\n".join(controllers), "\n".join(plants)
    texts |= {
        path.relative_to(SHIPPED): path.read_text(encoding="utf-8") for path in sorted((SHIPPED / "drives").glob("*"))
    }
    return texts, {Path(f"{name}.csv"): _csv(play) for name, play in strides().items()}


def _repeated(block: str, place: int, changes: Changes) -> str:
    """Return the block of one joint; only the first joint keeps the keys that are commented out."""
    text = with_values(block, changes)
    if place == 0:
        return text
    return "\n".join(line for line in text.splitlines() if not line.lstrip().startswith("#")) + "\n"


@click.command(
    "init",
    epilog="Example: tsa init --rig mine",
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.argument("folder", metavar="[DIR]", default=".", type=click.Path(path_type=Path, file_okay=False))
@click.option(
    "--rig", is_flag=True, help="Files for a rig (default); nothing moves until the empty values are filled in."
)
@click.option(
    "--desk", is_flag=True, help="Files for a trial without CAN: a bus over UDP multicast, no real-time rights."
)
@click.option(
    "--leg", "legs", is_flag=True, help="As --desk, for hip, knee and ankle, which bend each other's sheaths."
)
def command(folder: Path, rig: bool, desk: bool, legs: bool) -> None:
    """Write controller, plant, actuator model, drive profiles, service and a motion to DIR, every key commented.

    The set-point of a rig is 0, its compensation 0, its torque limit a tenth of the rated torque, and values that only
    the user knows are empty. Nothing that is there is replaced.
    """
    if rig + desk + legs > 1:
        raise click.UsageError("--rig, --desk and --leg exclude each other; give one of them")
    if legs:
        texts, motions = leg()
    else:
        texts = {path.relative_to(SHIPPED): path.read_text(encoding="utf-8") for path in _shipped()}
        for name, changes in (DESK if desk else RIG).items():
            texts[Path(name)] = with_values(texts[Path(name)], changes)
        motions = _motion()
    write(folder, {**texts, **motions})
    for path in (*texts, *motions):
        click.echo(f"written: {folder / path}")
    _compile()
    if legs:
        files = f"{folder / 'controller.toml'} {folder / 'plant.toml'}"
        click.echo("next, in virtual time (or tsa plant and tsa run in two terminals, as with --desk):")
        click.echo(f"  tsa simulate-loop {files} --seconds 10")
    elif desk:
        click.echo("next, in two terminals (the second after 'plant: ready'):")
        click.echo(f"  tsa plant {folder / 'plant.toml'}\n  tsa run {folder / 'controller.toml'} --seconds 20")
    else:
        click.echo("next, for a rig (without hardware: tsa init --desk DIR):")
        click.echo("  fill in the empty values, which tsa run --check lists")
        click.echo(f"  tsa run --check {folder / 'controller.toml'}\n  tsa doctor {folder / 'controller.toml'}")


def _compile() -> None:
    """Compile the observer, so that the first start of a daemon on this machine is as fast as later ones."""
    from tsa_ctrl.model.parameters import load_tendon_sheath
    from tsa_ctrl.observer.stretch import StretchObserver

    StretchObserver(load_tendon_sheath(SHIPPED / "actuator.toml"), 1e-3, (1e-4, 1e-4))  # any period and counts


def empty_model() -> str:
    """Return the commented model file of a tendon-sheath without the values that only the user knows."""
    return with_values((SHIPPED / "actuator.toml").read_text(encoding="utf-8"), MODEL)


def _shipped() -> list[Path]:
    return sorted(path for path in SHIPPED.rglob("*") if path.suffix in (".toml", ".service"))


def with_values(text: str, changes: Changes) -> str:
    """Return a commented file with these keys set, including keys that are commented out.

    Raises:
        KeyError: the file does not contain a key.
    """
    open_keys = {(table, key) for table, keys in changes.items() for key in keys}
    lines, table = [], ""
    for line in text.splitlines():
        header = _HEADER.match(line)
        if header:
            table = header["table"]
            line = line.removeprefix("# ") if table in changes else line
        key = _KEY.match(line)
        if key and (table, key["key"]) in open_keys:
            open_keys.remove((table, key["key"]))
            line = _changed(line, key["key"], changes[table][key["key"]], key["comment"] or "")
        lines.append(line)
    if open_keys:
        raise KeyError(*open_keys)
    return "\n".join(lines) + "\n"


def _changed(line: str, key: str, value: str | None, comment: str) -> str:
    """Return a line with another value of its key; None comments the key out."""
    if value is None:
        return line if line.startswith("#") else f"# {line}"
    if value == EMPTY:
        comment = f"# FILL IN: {comment.removeprefix('# ').partition('; default')[0] or NODE_ID}"
    return f"{key} = {value}".ljust(COMMENTS) + comment


def write(folder: Path, texts: Mapping[Path, str]) -> None:
    """Write files to a folder; raise UsageError if one of them exists already or cannot be written."""
    from tsa_ctrl.settings import write_text

    taken = [str(folder / name) for name in texts if (folder / name).exists()]
    if taken:
        raise UsageError(f"{taken[0]}: already exists, nothing was written; choose another folder: tsa init DIR")
    make_folder(folder / "drives", "choose another folder")
    for name, text in texts.items():
        write_text(folder / name, text)


def _motion() -> dict[Path, str]:
    from tsa_ctrl.demo.rig import gait

    return {Path(MOTION): _csv(gait())}


def _csv(play: Play) -> str:
    rows = (f"{t:.3f},{tau:.6g},{q:.6g}" for t, tau, q in zip(play.t, play.tau_j_des, play.q_j, strict=True))
    return "t,tau_j_des,q_j\n" + "\n".join(rows) + "\n"
