"""What every command below this folder needs: its name, its parser, a vcan, processes beside it."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
CONFIG = ROOT / "config"


def name_of(module: str) -> str:
    """`bench/cycle` of the module `tools.bench.cycle`: what `tools/run` calls it."""
    return module.removeprefix("tools.").replace(".", "/")


def parser(module: str, doc: str | None) -> argparse.ArgumentParser:
    """A parser whose help is the module's text."""
    prog = f"tools/run {name_of(module)}"
    return argparse.ArgumentParser(prog, description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)


def process(module: str, *arguments: str) -> list[str]:
    """The command line of a command here as a process of its own."""
    return [sys.executable, str(ROOT / "tools"), name_of(module), *arguments]


def vcan(module: str) -> str:
    """Name of the virtual CAN interface; where there is none this process becomes one under tools/vcan."""
    if "TSA_VCAN" not in os.environ:
        os.execv(ROOT / "tools" / "vcan", ["vcan", *process(module, *sys.argv[1:])])
    return os.environ["TSA_VCAN"]


def measured_data(module: str) -> Path | None:
    """Folder of the measured cable drive, in TSA_DATA, else in ../shared/data; where it is not that is said."""
    base = Path(os.environ.get("TSA_DATA") or ROOT.parent / "shared" / "data")
    for folder in (base / "davinci", base):
        if (folder / "actuator.toml").is_file():
            return folder
    print(f"tools/run {name_of(module)}: no measured data in {base}; name the folder that holds davinci/ in TSA_DATA")
    return None
