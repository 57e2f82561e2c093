"""What every command below this folder needs: its name, its parser, a vcan, processes beside it."""

from __future__ import annotations

import argparse
import concurrent.futures
import multiprocessing
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TypeVar

ROOT = Path(__file__).resolve().parent.parent
CONFIG = ROOT / "config"
MOST_PROCESSES = 2

Item = TypeVar("Item")
Done = TypeVar("Done")


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
    """Folder of the measured cable drive: TSA_DATA, else ../shared/data, else what was fetched; its lack is said."""
    from tsa_ctrl.published import catalogue

    beside = [] if catalogue.VARIABLE in os.environ else [ROOT.parent / "shared" / "data"]
    places = [*beside, catalogue.folder()]
    for folder in (folder for base in places for folder in (base / "davinci", base)):
        if (folder / "actuator.toml").is_file():
            return folder
    print(
        f"tools/run {name_of(module)}: no measured data in {' or '.join(map(str, places))}; tsa data fetch davinci, "
        f"or name the folder that holds davinci/ in {catalogue.VARIABLE}"
    )
    return None


def parallel(work: Callable[[Item], Done], items: Sequence[Item], processes: int) -> Iterator[Done]:
    """Yield `work(item)` of every item as it is done; the first one compiles what all need, before others begin."""
    first, rest = items[:1], items[1:]
    yield from map(work, first if processes > 1 and rest else items)
    if processes > 1 and rest:
        context = multiprocessing.get_context("fork")
        with concurrent.futures.ProcessPoolExecutor(processes, context) as pool:
            for done in concurrent.futures.as_completed([pool.submit(work, item) for item in rest]):
                yield done.result()
