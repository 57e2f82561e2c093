"""Architecture rules: a table lists which modules each part of the package may import. Nothing is executed.

A room is a folder of `tsa_ctrl` or a file next to the folders. A row of the table lists the rooms that a room may
import. A row may also contain a single file of another room, if the rest of that room is private. A row contains only
rows above it, so the table reads from the base modules upwards. A row contains only rooms that are in use. Every
import counts: at the top of a file, inside a function, and under TYPE_CHECKING.
"""

from __future__ import annotations

import ast
import re
import statistics
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from tests.conftest import ROOT

PACKAGE = ROOT / "tsa_ctrl"
pytestmark = pytest.mark.xdist_group("layers")  # one worker reads the import graph once

ROOMS: dict[str, str] = {
    # base modules
    "errors": "",
    "version": "",
    "arguments": "errors",  # checks arguments of the Python interface
    "settings": "arguments errors",
    "outputs": "errors",
    "display": "",
    "system": "errors",
    "signals": "",  # table that defines the fields of log, status and client
    # logs, sensors and the model, which both pipelines share
    "log": "arguments errors display version settings outputs system signals",
    "sensors": "errors system",
    "model": "arguments errors settings system.compiling",
    "observer": "errors model system.compiling",  # estimates the joint torque without a sensor
    # the bus, from frames to SI units
    "bus": "",  # its __init__.py
    "bus.settings": "",
    "bus.wire": "errors system bus.settings",
    "bus.canopen": "errors",
    "bus.drive": "errors settings bus.settings bus.wire bus.canopen",
    "bus.live": "errors system bus.settings bus.wire bus.canopen bus.drive",
    "monitor": "bus.canopen",  # the second safety channel: without clock, I/O and loop code
    # live control: torque from a set-point. Safety imports neither the control law nor the model.
    "safety": "errors bus.settings bus.wire bus.canopen bus.drive.session bus.live",
    "control": "errors log.table model observer bus.canopen bus.live safety",
    "config": "arguments errors settings system sensors model bus.settings bus.canopen.eds bus.drive safety control",
    "readiness": "errors settings model bus.canopen.objects safety control.law_design config",
    "ipc": "arguments errors system signals",
    "daemon": (
        "arguments errors settings outputs system signals log sensors model observer bus monitor safety control config "
        "readiness ipc"
    ),
    # offline: parameters and causes from logs, without bus and loop
    "identify": "arguments errors display version settings outputs system signals log model observer",
    # the simulated machine, independent of control and identification
    "plant": (
        "arguments errors settings system.compiling log.table model.parameters model.routing model.catalogue bus.wire"
    ),
    # daemon and plant in one process, in virtual time
    "virtual": (
        "arguments errors settings display outputs signals log bus.wire bus.drive.network bus.live monitor safety "
        "config ipc daemon plant"
    ),
    # user interfaces
    "published": "errors outputs",
    "doctor": "errors version system bus.settings bus.wire bus.drive",
    "bench": "errors system log ipc bus safety control config daemon doctor",
    "drills": "errors version settings outputs system log.table model bus safety control config readiness daemon",
    "dashboard": "errors signals ipc",
    "live": "errors outputs signals ipc",
    "tune": (
        "errors display version settings outputs system signals log model control config ipc daemon.joint_files doctor "
        "identify virtual"
    ),
    "investigate": "errors settings model identify tune",
    "demo": "errors outputs system log model bus.wire identify virtual tune",
    "cli": (
        "errors version settings outputs system signals log model observer bus config readiness ipc daemon identify "
        "plant virtual published safety.causes doctor bench drills dashboard live tune investigate demo"
    ),
    "__init__": "errors version system ipc.client identify virtual model daemon.controller",
    "__main__": "system cli",
}

# Known import cycles that must be removed. An entry that no longer exists fails the test.
CIRCLES: tuple[frozenset[str], ...] = ()
MOST_LINES = 700  # of a module; split a longer one
MEDIAN_LINES = (120, 200)  # of the modules: neither one file per function nor a few large files


@cache
def sources() -> dict[str, Path]:
    """Return the path of every module of the package by its name without "tsa_ctrl.".

    A package is listed under the name of its folder.
    """
    return {
        name.removesuffix(".__init__"): path
        for path in PACKAGE.rglob("*.py")
        if (name := ".".join(path.relative_to(PACKAGE).with_suffix("").parts))
    }


def imported(tree: ast.AST, known: frozenset[str]) -> Iterator[tuple[str, int]]:
    """Yield the modules of the package that a file imports, with the line of the import.

    A name that is imported from a module counts as an import of that module.
    """
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: a relative import; write the whole name"
            whole = [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            whole = [alias.name for alias in node.names]
        else:
            continue
        for name in whole:
            if name == "tsa_ctrl" or name.startswith("tsa_ctrl."):
                yield nearest(name.removeprefix("tsa_ctrl").removeprefix("."), known), node.lineno


def nearest(name: str, known: frozenset[str]) -> str:
    """Return the module that the dotted name refers to or lies in."""
    while name and name not in known:
        name = name.rpartition(".")[0]
    return name or "__init__"


@cache
def trees() -> dict[str, ast.Module]:
    return {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in sources().items()}


@cache
def graph() -> dict[str, dict[str, int]]:
    """Return the imports of each module with the line of each import."""
    known = frozenset(sources())
    found = {}
    for name, tree in trees().items():
        found[name] = {other: line for other, line in imported(tree, known) if other != name}
    return found


def room(module: str) -> str:
    """Return the longest row name that contains the module."""
    parts = module.split(".")
    for length in range(len(parts), 0, -1):
        if ".".join(parts[:length]) in ROOMS:
            return ".".join(parts[:length])
    raise AssertionError(f"tsa_ctrl/{module.replace('.', '/')}: lies in no room; give its folder a row in ROOMS")


def entry(module: str, row: str) -> str | None:
    """Return the entry of a row that permits this module, or None."""
    return next((name for name in row.split() if module == name or module.startswith(f"{name}.")), None)


def test_a_room_imports_only_what_its_row_names() -> None:
    """Every import between rooms is permitted by the row of the importing room."""
    wrong = [
        f"tsa_ctrl/{sources()[module].relative_to(PACKAGE)}:{line}: {room(module)} imports {other}, allowed are: "
        f"{ROOMS[room(module)] or 'nothing'}"
        for module, others in graph().items()
        for other, line in others.items()
        if room(other) != room(module) and entry(other, ROOMS[room(module)]) is None
    ]
    assert not wrong, "\n" + "\n".join(wrong)


def test_a_row_names_only_rows_above_it() -> None:
    """This order excludes cycles between rooms."""
    rows = list(ROOMS)
    for place, (name, row) in enumerate(ROOMS.items()):
        for other in row.split():
            inside = [place for place, row in enumerate(rows) if row == other or row.startswith(f"{other}.")]
            assert max(inside or [rows.index(room(other))]) < place, f"{name} names {other}, which is not above it"


def test_a_row_names_nothing_that_is_not_used() -> None:
    """An entry that no import uses must be removed."""
    used = {(room(module), entry(other, ROOMS[room(module)])) for module, others in graph().items() for other in others}
    idle = [f"{name}: {other}" for name, row in ROOMS.items() for other in row.split() if (name, other) not in used]
    assert not idle


def test_every_row_is_there() -> None:
    """The rows of the table are exactly the rooms of the package."""
    assert set(ROOMS) == {room(module) for module in graph()}


def test_no_files_import_each_other_in_a_circle() -> None:
    """Only the cycles listed in CIRCLES exist. A listed cycle that no longer exists fails the test."""
    assert set(circles(graph())) == set(CIRCLES)


def circles(of: dict[str, dict[str, int]]) -> Iterator[frozenset[str]]:
    """Yield the groups of modules in which each module reaches every other one."""
    reached = {name: reach(name, of) for name in of}
    seen: set[str] = set()
    for name in of:
        group = {other for other in reached[name] if name in reached[other]}
        if group and name not in seen:
            seen |= group
            yield frozenset(group)


def reach(start: str, of: dict[str, dict[str, int]]) -> set[str]:
    found: set[str] = set()
    waiting = [start]
    while waiting:
        for other in of[waiting.pop()]:
            if other not in found:
                found.add(other)
                waiting.append(other)
    return found


def test_no_module_is_too_long_to_be_read() -> None:
    lines = {name: len(path.read_text("utf-8").splitlines()) for name, path in sources().items()}
    assert not {name: count for name, count in lines.items() if count > MOST_LINES}


def test_modules_are_neither_fragments_nor_collections() -> None:
    lines = [len(path.read_text("utf-8").splitlines()) for path in sources().values() if path.name != "__init__.py"]
    assert MEDIAN_LINES[0] <= statistics.median(lines) <= MEDIAN_LINES[1]


def imports_of(folder: str) -> Iterator[tuple[str, str]]:
    """Yield the path of each file below a folder of the project, and each dotted name that it imports."""
    for path in (ROOT / folder).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.level == 0:
                yield from ((str(path.relative_to(ROOT)), f"{node.module}.{alias.name}") for alias in node.names)
            elif isinstance(node, ast.Import):
                yield from ((str(path.relative_to(ROOT)), alias.name) for alias in node.names)


def test_the_package_imports_neither_tests_nor_tools() -> None:
    assert not [found for found in imports_of("tsa_ctrl") if found[1].split(".")[0] in ("tests", "tools")]


def test_tests_import_tools_only_to_test_them() -> None:
    """Tools may import test helpers such as tests/blind. Only tests/tools may import tools."""
    wrong = [(path, name) for path, name in imports_of("tests") if name.split(".")[0] == "tools"]
    assert not [found for found in wrong if not found[0].startswith("tests/tools/")]


def test_tools_import_no_test() -> None:
    """Tools may import helpers of the tests (hidden effects, nodes, a browser) but no test module."""
    parts = [(path, name.split(".")) for path, name in imports_of("tools")]
    assert not [found for found in parts if found[1][0] == "tests" and any(p.startswith("test_") for p in found[1])]


def test_no_file_of_the_tools_is_too_long_to_be_read() -> None:
    for path in (ROOT / "tools").rglob("*.py"):
        assert len(path.read_text(encoding="utf-8").splitlines()) <= 700, path


def test_the_map_names_what_is_there() -> None:
    """Every file in the map of the code exists. Paths in capitals are excluded, because those files are to be added."""
    text = (PACKAGE / "README.md").read_text(encoding="utf-8")
    for path in re.findall(r"`([\w/]+\.\w+)`", text):
        if not re.search(r"[A-Z]{2}", path):
            assert (ROOT / path).is_file() or any(list((ROOT / top).rglob(path)) for top in ("tsa_ctrl", "tests")), path


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("from tsa_ctrl.bus.live.rig import Rig", "bus.live.rig"),
        ("from tsa_ctrl.bus.live import rig", "bus.live.rig"),
        ("import tsa_ctrl.bus.live.rig", "bus.live.rig"),
        ("def f():\n    from tsa_ctrl.bus.live import rig", "bus.live.rig"),
        ("if TYPE_CHECKING:\n    from tsa_ctrl.bus.live.rig import Rig", "bus.live.rig"),
        ("from tsa_ctrl.bus import live", "bus.live"),
        ("from tsa_ctrl import __version__", "__init__"),
        ("from tsa_ctrl import errors", "errors"),
    ],
)
def test_every_way_to_import_is_seen(source: str, found: str) -> None:
    known = frozenset({"errors", "bus", "bus.live", "bus.live.rig", "__init__"})
    assert [name for name, _ in imported(ast.parse(source), known)] == [found]


def test_a_circle_is_found_with_all_its_files() -> None:
    of = {"a": {"b": 1}, "b": {"c": 1}, "c": {"a": 1, "d": 1}, "d": {}}
    assert list(circles(of)) == [frozenset("abc")]
