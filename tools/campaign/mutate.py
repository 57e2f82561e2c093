"""Makes small mistakes in what decides the torque, and shows that the tests see each of them.

Usage: tools/run campaign/mutate [MODULE...] [--sample N] [--names FILE] [--list] [--json]

Each mutant is a module with one mistake (mutation/mutants.py): a boundary moved, a condition forced, a statement left
out, ... For each, the tests of that module run in a process of their own until one fails: then the mutant is killed.
One that survives must stand in mutation/equivalent.toml with the reason why no test can see it. An entry there that
names no mutant, or one that is killed, is an error. MODULE selects by a part of the path; --sample N takes N
mutants spread over all modules, always the same ones. Exit code 1: a mutant survived, or the list is not current.
"""

from __future__ import annotations

import argparse
import gc
import hashlib
import importlib.abc
import importlib.util
import json
import math
import os
import re
import resource
import signal
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import CodeType, ModuleType

from tools import command
from tools.campaign.mutation.mutants import Mutant, enums_of, mutants
from tsa_ctrl.errors import UsageError

EQUIVALENT = Path(__file__).parent / "mutation" / "equivalent.toml"
TARGETS: dict[str, tuple[str, ...]] = {  # module: the tests that must see its mistakes, quick ones first
    "tsa_ctrl/safety/limiter.py": ("tests/safety/test_limiter.py",),
    "tsa_ctrl/bus/canopen/cia402.py": ("tests/bus/canopen/test_cia402.py", "tests/safety/test_supervisor.py"),
    "tsa_ctrl/safety/supervisor.py": ("tests/safety/test_supervisor.py",),
    "tsa_ctrl/safety/shut_down.py": ("tests/safety/test_shut_down.py",),
    "tsa_ctrl/safety/leaky.py": ("tests/safety/test_leaky.py",),
    "tsa_ctrl/safety/guard.py": ("tests/safety/test_guard.py",),
    "tsa_ctrl/safety/passivity.py": ("tests/safety/test_passivity.py",),
    "tsa_ctrl/safety/buzz.py": ("tests/safety/test_buzz.py",),
    "tsa_ctrl/safety/sense.py": ("tests/safety/test_sense.py",),
    "tsa_ctrl/safety/plausibility.py": ("tests/safety/test_plausibility.py",),
    "tsa_ctrl/control/axis.py": ("tests/control/test_axis.py", "tests/daemon/test_loop.py"),
    "tsa_ctrl/control/cycle.py": ("tests/control/test_cycle.py", "tests/daemon/test_loop.py"),
    "tsa_ctrl/daemon/descent.py": ("tests/daemon/test_descent.py",),
    "tsa_ctrl/safety/unheard.py": ("tests/safety/test_unheard.py",),
    "tsa_ctrl/bus/live/hearing.py": ("tests/bus/live/test_hearing.py",),
    "tsa_ctrl/safety/residuals.py": ("tests/safety/test_residuals.py", "tests/safety/test_plausibility.py"),
    "tsa_ctrl/bus/live/axis.py": ("tests/bus/live/test_axis.py", "tests/bus/live/test_rig.py"),
    "tsa_ctrl/bus/live/rig.py": ("tests/bus/live/test_rig_bounds.py", "tests/bus/live/test_rig.py"),
    "tsa_ctrl/control/direction.py": ("tests/control/test_direction.py",),
    "tsa_ctrl/control/setpoint.py": ("tests/control/test_setpoint.py",),
    "tsa_ctrl/ipc/mailbox.py": ("tests/daemon/test_mailbox.py",),
    "tsa_ctrl/control/live.py": ("tests/control/test_live.py",),
    "tsa_ctrl/bus/live/read_back.py": ("tests/bus/live/test_read_back.py",),
    "tsa_ctrl/control/law.py": ("tests/control/test_law_bounds.py", "tests/control/test_law.py"),
    "tsa_ctrl/ipc/server.py": ("tests/daemon/test_server_steps.py", "tests/daemon/test_lease.py"),
    "tsa_ctrl/daemon/loop.py": ("tests/daemon/test_loop_steps.py",),
}
ENUMS = ("bus/canopen/cia402.py", "bus/canopen/cia301.py", "safety/supervisor.py", "safety/limiter.py")  # confused
BASELINE = 10.0  # s of CPU time that the tests of a module are granted where that is not measured
CPU_TIME = 2  # s that the tests of a mutant may take beyond those of the module as it is, a half longer
MEMORY = 8 << 30  # bytes of address space
WAITS = 30.0  # times its CPU time that a mutant may last: one that waits for ever takes none, and a machine may be busy


class Replaced(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Gives one module's source to whoever imports it."""

    def __init__(self, path: str, source: str) -> None:
        self.name = path.removesuffix(".py").replace("/", ".")
        self.code = compile(source, str(command.ROOT / path), "exec")

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        found = importlib.util.spec_from_loader(fullname, self) if fullname == self.name else None
        if found is not None:
            found.origin, found.has_location = str(self.code.co_filename), True
        return found

    def exec_module(self, module: ModuleType) -> None:
        exec(self.code, module.__dict__)

    def get_code(self, name: str) -> CodeType:
        """For who runs it as a program (runpy)."""
        return self.code


def passes(path: str, sources: Iterable[str], cpu: float, jobs: int) -> Iterator[tuple[int, bool, float]]:
    """As they end: number of the source that is in the module's place, whether the tests pass, and the CPU time, s."""
    running: dict[int, int] = {}
    for number, source in enumerate(sources):
        if len(running) == jobs:
            yield _next_end(running)
        pid = os.fork()
        if pid == 0:
            try:
                _child(path, source, cpu)
            finally:
                os._exit(9)
        running[pid] = number
    while running:
        yield _next_end(running)


def _next_end(running: dict[int, int]) -> tuple[int, bool, float]:
    pid, status, used = os.wait3(0)
    return running.pop(pid), os.waitstatus_to_exitcode(status) == 0, used.ru_utime + used.ru_stime


def _child(path: str, source: str, cpu: float) -> None:
    import pytest

    sink = os.open(os.devnull, os.O_WRONLY)
    os.dup2(sink, 1)
    os.dup2(sink, 2)
    resource.setrlimit(resource.RLIMIT_CPU, (int(cpu), int(cpu) + 1))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    signal.alarm(math.ceil(WAITS * cpu))
    sys.meta_path.insert(0, Replaced(path, source))
    code = pytest.main(["-x", "-q", "-p", "no:cacheprovider", *TARGETS[path]])
    os._exit(0 if code == 0 else 1)


def warm_up(paths: Sequence[str]) -> None:
    """Import here what is not under test, so that no child has to: a scout tells what the tests import."""
    read, write = os.pipe()
    if os.fork() == 0:
        for path in paths:
            for test in ("tests/conftest.py", *TARGETS[path]):
                importlib.import_module(test.removesuffix(".py").replace("/", "."))
        names = [name for name in sys.modules if name.split(".")[0] not in ("tsa_ctrl", "tests", "__main__")]
        os.write(write, json.dumps(names).encode())
        os._exit(0)
    os.close(write)
    with os.fdopen(read) as pipe:
        names = json.loads(pipe.read())
    os.wait()
    import pytest  # noqa: F401

    for name in names:
        try:
            importlib.import_module(name)
        except ImportError:  # made at run time by its package
            continue
    gc.collect()
    gc.freeze()  # no child looks through it


def known_equivalents(path: Path) -> dict[str, str]:
    """Reason by name of mutant, of a TOML file. Raises UsageError when one is listed twice."""
    found: dict[str, str] = {}
    for entry in tomllib.loads(path.read_text(encoding="utf-8")).get("group", []):
        for name in entry["mutants"]:
            if name in found:
                raise UsageError(f"{path}: listed twice: {name}; delete one of the two")
            found[name] = entry["reason"]
    return found


def all_mutants(parts: Sequence[str] = ()) -> dict[str, list[Mutant]]:
    """Of every module, or of those whose path has one of the parts in it."""
    enums = enums_of(*((command.ROOT / "tsa_ctrl" / name).read_text(encoding="utf-8") for name in ENUMS))
    enums |= {"_S": enums["PowerState"], "_C": enums["Controlword"]}
    chosen = [path for path in TARGETS if not parts or any(part in path for part in parts)]
    return {path: mutants((command.ROOT / path).read_text(encoding="utf-8"), path, enums) for path in chosen}


def sample(table: dict[str, list[Mutant]], count: int) -> dict[str, list[Mutant]]:
    """The same `count` mutants each time, spread over the modules by how many each has."""
    everything = [(hashlib.sha256(mutant.name.encode()).hexdigest(), path, mutant)
                  for path, found in table.items() for mutant in found]  # fmt: skip
    chosen = sorted(everything, key=lambda entry: entry[0])[:count]
    return {path: [mutant for _, of, mutant in chosen if of == path] for path in table}


def stale(table: dict[str, list[Mutant]], equivalents: dict[str, str]) -> list[str]:
    """Entries of the list that name no mutant, though they name one of the table's modules, or none at all."""
    names = {mutant.name for found in table.values() for mutant in found}
    others = TARGETS.keys() - table.keys()
    return [name for name in equivalents if name not in names and re.split("[ :]", name)[0] not in others]


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("modules", nargs="*", metavar="MODULE")
    parser.add_argument("--sample", type=int, default=0, metavar="N", help="only N mutants, spread over all")
    parser.add_argument("--names", type=Path, metavar="FILE", help="only those that FILE names, one per line")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="tests that run at the same time (1)")
    parser.add_argument("--equivalent", type=Path, default=EQUIVALENT, help="file of those that no test can see")
    parser.add_argument("--list", action="store_true", help="name the mutants, run nothing")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    os.environ["CI"] = "true"  # hypothesis draws the same examples each time
    os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"  # none of them is needed, and each child would load them anew
    table, equivalents = all_mutants(options.modules), known_equivalents(options.equivalent)
    problems = [f"no such mutant any more: {name}" for name in stale(table, equivalents)]
    if options.sample:
        table = sample(table, options.sample)
    if options.names is not None:
        chosen = set(options.names.read_text(encoding="utf-8").splitlines())
        table = {path: [mutant for mutant in found if mutant.name in chosen] for path, found in table.items()}
    if options.list:
        print("\n".join(mutant.name for found in table.values() for mutant in found))
        return 0
    os.chdir(command.ROOT)
    with tempfile.TemporaryDirectory(prefix="mutate-") as folder:
        warm_up([path for path, found in table.items() if found])  # of the libraries, which are compiled already
        sys.pycache_prefix, sys.dont_write_bytecode = folder, False  # no child has to compile what is not under test
        return run(table, equivalents, problems, options)


def run(
    table: dict[str, list[Mutant]], equivalents: dict[str, str], problems: list[str], options: argparse.Namespace
) -> int:
    """All mutants of the table, a row for each module; returns the exit code."""
    rows: list[dict[str, int | str]] = []
    for path, found in table.items():
        if found:
            rows.append(check(path, found, equivalents, problems, options.sample > 0, options.jobs))
            show(rows[-1], options.json, head=len(rows) == 1)
    total = {key: sum(int(row[key]) for row in rows) for key in ("mutants", "killed", "equivalent", "survived")}
    show({"module": "all", **total}, options.json)
    if options.json:
        print(json.dumps({"schema": 1, "modules": rows, "problems": problems}))
    else:
        print("\n".join(problems), end="\n" if problems else "")
    return 1 if problems else 0


def show(row: dict[str, int | str], quiet: bool, head: bool = False) -> None:
    if quiet:
        return
    if head:
        print(f"{'module':34}{'mutants':>9}{'killed':>9}{'equivalent':>12}{'survived':>10}")
    print(
        f"{row['module']:34}{row['mutants']:9}{row['killed']:9}{row['equivalent']:12}{row['survived']:10}", flush=True
    )


def check(
    path: str, found: list[Mutant], equivalents: dict[str, str], problems: list[str], sampled: bool, jobs: int
) -> dict[str, int | str]:
    """Run the tests against each mutant of one module."""
    cpu = BASELINE
    if not sampled:
        _, good, cpu = next(passes(path, [(command.ROOT / path).read_text(encoding="utf-8")], 600.0, 1))
        if not good:
            raise UsageError(f"{', '.join(TARGETS[path])}: fail without any mutant; mend them first")
    row: dict[str, int | str] = {"module": path, "mutants": len(found), "killed": 0, "equivalent": 0, "survived": 0}
    begin = time.monotonic()
    outcomes = passes(path, (mutant.source for mutant in found), 1.5 * cpu + CPU_TIME, jobs)
    for done, (number, survived, _) in enumerate(outcomes, start=1):
        mutant = found[number]
        listed = mutant.name in equivalents
        key = "killed" if not survived else "equivalent" if listed else "survived"
        row[key] = int(row[key]) + 1
        if survived and not listed:
            problems.append(f"survived (line {mutant.line}): {mutant.name}")
            print(problems[-1], file=sys.stderr)
        elif listed and not survived:
            problems.append(f"listed as equivalent, but killed: {mutant.name}")
        if sys.stderr.isatty():
            left = (time.monotonic() - begin) / done * (len(found) - done)
            print(f"\r{path} {done}/{len(found)}, {left:.0f} s left  ", end="", file=sys.stderr, flush=True)
    return row
