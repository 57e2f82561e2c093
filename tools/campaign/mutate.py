"""Measure how many small mistakes in the modules that decide the torque the tests detect.

Usage: tools/run campaign/mutate [MODULE...] [--sample N] [--jobs N] [--json]

A mutant is a module with one mistake: a moved boundary, a forced condition, another number, a statement left out. The
tests of the module run against each mutant in a separate process. A mutant that fails a test is killed. The score
is the share of killed mutants; the survivors are printed with their line. Many survivors change nothing that matters:
a list of reasons did not survive the edits of the code. MODULE selects by a part of the path. --sample N takes every
so many, until N mutants of each module are chosen.

mutmut 3.8 leaves out the defaults and bounds of settings and cosmic-ray 8.7 starts pytest again for each mutant (13
minutes for the limiter instead of 64 s), so these operators and the fork are here.
"""

from __future__ import annotations

import ast
import importlib.machinery
import importlib.util
import math
import os
import resource
import signal
import sys
from collections.abc import Iterator
from importlib.machinery import ModuleSpec
from types import CodeType

from tools import command
from tsa_ctrl.errors import UsageError

TARGETS: dict[str, tuple[str, ...]] = {  # module: the tests that must detect its mistakes, quick ones first
    "tsa_ctrl/safety/limiter.py": ("tests/safety/test_limiter.py",),
    "tsa_ctrl/safety/supervisor.py": ("tests/safety/test_supervisor.py",),
    "tsa_ctrl/safety/guard.py": ("tests/safety/test_guard.py",),
    "tsa_ctrl/control/law.py": ("tests/control/test_law_bounds.py", "tests/control/test_law.py"),
}
CPU_TIME = 2.0  # s beyond 1.5 times the duration of the original's tests that the tests of a mutant may take
WAITS = 30.0  # times its CPU time that a mutant may last: one that waits forever takes none

_LT, _LE, _GT, _GE = ast.Lt, ast.LtE, ast.Gt, ast.GtE
_COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    _LT: (_LE, _GE),
    _LE: (_LT, _GT),
    _GT: (_GE, _LE),
    _GE: (_GT, _LT),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
_OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Mod: ast.FloorDiv,
    ast.FloorDiv: ast.Mod,
    ast.Pow: ast.Mult,
    ast.BitOr: ast.BitAnd,
    ast.BitAnd: ast.BitOr,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
}
_CALLS = {"min": "max", "max": "min"}
_UNTOUCHED = ("decorator_list", "returns", "annotation", "bases", "keywords", "type_params")


def mutants(source: str) -> Iterator[tuple[str, str]]:
    """Yield the name (line, before, after) and the source of each mutant of a module."""
    tree = ast.parse(source)
    for parent, field, index, node in list(_places(tree)):
        for other in _replacements(node):
            _put(parent, field, index, other)
            text = ast.unparse(tree)
            _put(parent, field, index, node)
            before, after = (" ".join(ast.unparse(each).split())[:80] for each in (node, other))
            yield f"{getattr(node, 'lineno', 0)}: {before} -> {after}", text


def _put(parent: ast.AST, field: str, index: int | None, node: ast.AST) -> None:
    if index is None:
        setattr(parent, field, node)
    else:
        getattr(parent, field)[index] = node


def _places(node: ast.AST) -> Iterator[tuple[ast.AST, str, int | None, ast.AST]]:
    """Yield every node below this one that may be mutated, with its parent, field and index."""
    for field, value in ast.iter_fields(node):
        if field in _UNTOUCHED and isinstance(node, (ast.FunctionDef, ast.ClassDef, ast.arg)):
            continue
        for index, child in enumerate(value) if isinstance(value, list) else [(None, value)]:
            if isinstance(child, ast.AST) and not isinstance(child, (ast.Import, ast.ImportFrom, ast.JoinedStr)):
                yield node, field, index, child
                yield from _places(child)


def _replacements(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the replacements of a node; a removed statement becomes `pass`."""
    match node:
        case ast.Compare():
            for k, operator in enumerate(node.ops):
                for other in _COMPARISONS[type(operator)]:
                    yield ast.Compare(node.left, [*node.ops[:k], other(), *node.ops[k + 1 :]], node.comparators)
        case ast.BoolOp():
            yield ast.BoolOp(ast.Or() if isinstance(node.op, ast.And) else ast.And(), node.values)
            for k in range(len(node.values)):
                rest = node.values[:k] + node.values[k + 1 :]
                yield ast.BoolOp(node.op, rest) if len(rest) > 1 else rest[0]
        case ast.UnaryOp(op=ast.Not() | ast.USub()):
            yield node.operand
        case ast.BinOp(right=right) if type(node.op) in _OPERATORS:
            if not (isinstance(right, ast.Constant) and right.value is None):  # a type that may be None
                yield ast.BinOp(node.left, _OPERATORS[type(node.op)](), right)
        case ast.AugAssign() if type(node.op) in _OPERATORS:
            yield ast.AugAssign(node.target, _OPERATORS[type(node.op)](), node.value)
            yield ast.Pass()
        case ast.Constant(value=bool() as truth):
            yield ast.Constant(not truth)
        case ast.Constant(value=int() as number):
            yield from (ast.Constant(each) for each in (number + 1, number - 1) if each >= 1)
        case ast.Constant(value=float() as number):
            yield from (ast.Constant(each) for each in ([1.0] if number == 0.0 else [1.25 * number, 0.8 * number]))
        case ast.IfExp():
            yield from (node.body, node.orelse)
        case ast.If() | ast.While():
            for truth in (False, True) if isinstance(node, ast.If) else (False,):
                yield type(node)(ast.Constant(truth), node.body, node.orelse)
        case ast.Return():
            yield ast.Pass()
            if node.value is not None and not isinstance(node.value, ast.Constant):
                yield ast.Return(ast.Constant(None))
        case ast.Expr(value=ast.Constant() | ast.Yield()):
            pass
        case ast.Expr() | ast.Assign() | ast.Raise() | ast.Break() | ast.Continue():
            yield ast.Pass()
        case ast.Call(func=ast.Name(id="abs")):
            yield node.args[0]
        case ast.Call(func=ast.Name(id=name)) if name in _CALLS:
            yield ast.Call(ast.Name(_CALLS[name], ast.Load()), node.args, node.keywords)
        case ast.Dict(keys=[_, _, *_]):
            for k in range(len(node.keys)):
                yield ast.Dict(node.keys[:k] + node.keys[k + 1 :], node.values[:k] + node.values[k + 1 :])
        case ast.Set(elts=[_, _, *_]):
            yield from (ast.Set(node.elts[:k] + node.elts[k + 1 :]) for k in range(len(node.elts)))


def run(path: str, source: str, cpu: float) -> int:
    """Fork a process that runs the tests of a module with this source in its place; return its pid."""
    pid = os.fork()
    if pid == 0:
        code = 9
        try:
            sink = os.open(os.devnull, os.O_WRONLY)
            os.dup2(sink, 1)
            os.dup2(sink, 2)
            resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(cpu), math.ceil(cpu) + 1))
            signal.alarm(math.ceil(WAITS * cpu))
            code = _tested(path, source)
        finally:
            os._exit(code)
    return pid


class _Mutated(importlib.machinery.SourceFileLoader):
    """Load one module from a source other than its file."""

    def __init__(self, path: str, source: str) -> None:
        super().__init__(path.removesuffix(".py").replace("/", "."), str(command.ROOT / path))
        self._code = compile(source, self.path, "exec")

    def get_code(self, fullname: str) -> CodeType:
        return self._code

    def find_spec(self, name: str, path: object, target: object = None) -> ModuleSpec | None:
        """As a finder in sys.meta_path."""
        return importlib.util.spec_from_file_location(name, self.path, loader=self) if name == self.name else None


def _tested(path: str, source: str) -> int:
    import pytest

    sys.meta_path.insert(0, _Mutated(path, source))
    return 0 if pytest.main(["-x", "-q", "-p", "no:cacheprovider", *TARGETS[path]]) == 0 else 1


def ended() -> tuple[int, bool, float]:
    """Wait for a process; return its pid, whether its tests passed, and its CPU time in s."""
    pid, status, used = os.wait3(0)
    return pid, os.waitstatus_to_exitcode(status) == 0, used.ru_utime + used.ru_stime


def score(path: str, sample: int, jobs: int) -> command.Row:
    """Return mutants, killed and survivors of one module.

    Raises:
        UsageError: The tests fail without any mistake.
    """
    source = (command.ROOT / path).read_text(encoding="utf-8")
    run(path, source, 600.0)
    _, good, cpu = ended()
    if not good:
        raise UsageError(f"{', '.join(TARGETS[path])}: fail without any mutant; repair them first")
    found = list(mutants(source))
    chosen = found[:: max(1, len(found) // sample)][:sample] if sample else found
    running: dict[int, str] = {}
    survived: list[str] = []
    for name, text in [*chosen, *[("", "")] * jobs]:  # the empty ones wait for the last of the others
        if len(running) == jobs or (not name and running):
            pid, passed, _ = ended()
            of = running.pop(pid)
            survived += [of] if passed else []
        if name:
            running[run(path, text, 1.5 * cpu + CPU_TIME)] = name
    killed = len(chosen) - len(survived)
    return {
        "module": path,
        "mutants": len(chosen),
        "killed": killed,
        "score": killed / len(chosen),
        "survived": survived,
    }


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("modules", nargs="*", metavar="MODULE")
    parser.add_argument("--sample", type=int, default=0, metavar="N", help="at most N mutants of each module")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="tests that run at the same time (1)")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    os.environ["CI"] = "true"  # hypothesis draws the same examples each time
    os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"  # none is needed, and each process would load them again
    os.chdir(command.ROOT)
    sys.dont_write_bytecode = True  # of a mutant
    import numba  # noqa: F401  # what all tests import, before the fork

    chosen = [path for path in TARGETS if not options.modules or any(part in path for part in options.modules)]
    rows = [score(path, options.sample, options.jobs) for path in chosen]
    command.show(rows, ("module", "mutants", "killed", "score"), options.json)
    for row in [] if options.json else rows:
        print("\n".join(f"{row['module']}:{name}" for name in row["survived"]))
    return 0
