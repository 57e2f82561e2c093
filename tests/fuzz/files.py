"""Corrupted configuration files: each reader accepts the file or raises a one-line error."""

from __future__ import annotations

import random
import re
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

from tests.conftest import ROOT
from tests.fuzz.part import Holdings, Part
from tsa_ctrl.bus.drive.profile import load_profile
from tsa_ctrl.config import load_configuration
from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.parameters import load_model
from tsa_ctrl.plant.process import check as load_plant

CONFIG = ROOT / "config"
VALUES = (
    *("nan", "inf", "-inf", "0", "-1", "-0.0", "1e308", "1e-320", "9" * 20, "true", "1_000", "1979-05-27"),
    *('""', '"x"', '"\u0000"', '"../../etc/passwd"', '"/dev/null"', "07:32:00", "0x7FFFFFFFFFFFFFFFFF"),
    *("[]", "[[]]", "{}", "{ a = 1 }", "[1, nan]", "[-1e308, 1e308]", '"' + "a" * 5000 + '"', "[" * 2000 + "]" * 2000),
)
LINES = (
    *("[axis]", "[[axis]]", "[bus]", "[axis.drive]", "[axis.effects.backlash]", "[[axis.serial]]"),
    *("a.b.c = 1", "=", "[", "\t", "\\"),
)
MODEL = CONFIG / "actuator.toml"

Reader = Callable[[Path], object]
READERS: dict[str, tuple[Path, Reader]] = {
    "controller": (CONFIG / "controller.toml", load_configuration),
    "plant": (CONFIG / "plant.toml", load_plant),
    "actuator": (MODEL, load_model),
    "profile epos4": (CONFIG / "drives" / "epos4.toml", lambda path: load_profile(str(path), path.parent)),
    "profile elmo_gold": (CONFIG / "drives" / "elmo_gold.toml", lambda path: load_profile(str(path), path.parent)),
}


def run(files: int, seed: int) -> Part:
    """Read this many files, each a corrupted copy of an example."""
    part = Part("files")
    draw = random.Random(seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copytree(CONFIG, folder, dirs_exist_ok=True)
        path = folder / "spoiled.toml"
        for number in range(files):
            kind = draw.choice(list(READERS))
            original, reader = READERS[kind]
            path.write_bytes(_spoil(original.read_text(encoding="utf-8"), draw))
            part.inputs += 1
            before = path.read_bytes()
            with part.surviving(f"{kind} {number}"):
                try:
                    reader(path)
                    part.counts["taken"] += 1
                except UsageError as error:
                    part.counts["refused"] += 1
                    if len(str(error).splitlines()) != 1:
                        part.blame(f"{kind} {number}: not one line: {error}")
            if path.read_bytes() != before:
                part.blame(f"{kind} {number}: the file was changed")
            if number <= files // 4:
                part.before = Holdings.of()
    part.after = Holdings.of()
    return part


def _spoil(text: str, draw: random.Random) -> bytes:
    """Return a corrupted copy of the text.

    Commented defaults become keys, values are replaced, lines are copied, deleted or inserted, and a byte may change.
    """
    lines = text.splitlines()
    for _ in range(draw.choice((1, 1, 2, 4))):
        at = draw.randrange(len(lines))
        kind = draw.randrange(8)
        if kind <= 2:
            lines[at] = re.sub(r"=\s*\S.*", lambda _: f"= {draw.choice(VALUES)}", lines[at].removeprefix("# "), count=1)
        elif kind == 3:
            lines[at] = lines[at].removeprefix("# ")
        elif kind == 4:
            lines.insert(at, lines[draw.randrange(len(lines))])
        elif kind == 5:
            del lines[at]
        elif kind == 6:
            lines.insert(at, draw.choice(LINES))
        else:
            lines[at] = lines[at].replace("axis", draw.choice(("Axis", "axes", "axis.axis")))
        lines = lines or [""]
    data = bytearray("\n".join(lines).encode())
    if draw.random() < 0.1 and data:
        data[draw.randrange(len(data))] = draw.randrange(256)
    return bytes(data)
