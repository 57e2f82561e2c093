"""Measure how many mutants of the modules that limit the torque are detected by the tests.

Usage: tools/run campaign/mutate [MODULE...] [--sample N] [--json]

A mutant is a module with one mistake: a changed comparison, a forced condition, `and` for `or`, another number, or a
missing statement. The tests of the module run against each mutant in a separate process. A mutant that fails a test is
killed. The score is the share of killed mutants. Surviving mutants are printed with their line. MODULE selects modules
by a part of their path. --sample N selects N mutants of each module, spread over the module.

mutmut 3.8 does not mutate the defaults and bounds of settings, and cosmic-ray 8.7 starts pytest again for each mutant
(13 minutes for the limiter instead of 64 s). Therefore this module has its own operators and forks for each mutant.
"""

from __future__ import annotations

import ast
import importlib
import importlib.util
import os
import resource
import signal
import sys
import time
from collections.abc import Iterator

from tools import command
from tsa_ctrl.errors import UsageError

TARGETS: dict[str, tuple[str, ...]] = {  # tests of each module, fast ones first
    "tsa_ctrl/safety/limiter.py": ("tests/safety/test_limiter.py",),
    "tsa_ctrl/safety/supervisor.py": ("tests/safety/test_supervisor.py",),
    "tsa_ctrl/safety/compensation_backoff.py": ("tests/safety/test_compensation_backoff.py",),
    "tsa_ctrl/control/law.py": ("tests/control/test_law_model.py", "tests/control/test_law.py"),
}
PATIENCE = 3.0  # s beyond twice the duration of the tests without a mutant; a mutant may loop forever
COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE), ast.LtE: (ast.Lt, ast.Gt), ast.Gt: (ast.GtE, ast.LtE), ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,), ast.Is: (ast.IsNot,), ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,), ast.NotIn: (ast.In,),
}  # fmt: skip
OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.BitOr: ast.BitAnd,
    ast.BitAnd: ast.BitOr,
}  # fmt: skip
TYPES = ("returns", "annotation", "decorator_list", "bases")  # fields without effect at run time, or not mutated


def replacements(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the mutated replacements of a node."""
    match node:
        case ast.Compare(ops=[operator]):
            yield from (ast.Compare(node.left, [each()], node.comparators) for each in COMPARISONS[type(operator)])
        case ast.BoolOp():
            yield ast.BoolOp(ast.Or() if isinstance(node.op, ast.And) else ast.And(), node.values)
        case ast.UnaryOp(op=ast.Not() | ast.USub()):
            yield node.operand
        case ast.BinOp() if type(node.op) in OPERATORS:
            yield ast.BinOp(node.left, OPERATORS[type(node.op)](), node.right)
        case ast.Constant(value=bool() as truth):
            yield ast.Constant(not truth)
        case ast.Constant(value=int() | float() as number):
            yield from (ast.Constant(each) for each in ([number + 1] if not number else [1.25 * number, 0.8 * number]))
        case ast.If() | ast.IfExp():
            yield from (type(node)(ast.Constant(truth), node.body, node.orelse) for truth in (False, True))  # type: ignore[arg-type]
        case ast.Call(func=ast.Name(id="min" | "max" as name)):
            yield ast.Call(ast.Name("max" if name == "min" else "min", ast.Load()), node.args, node.keywords)
        case ast.Expr(value=ast.Call()) | ast.Assign() | ast.AugAssign() | ast.Raise() | ast.Return():
            yield ast.Pass()


def mutants(source: str) -> Iterator[tuple[str, str]]:
    """Yield a description (line and change) and the source of each mutant of a module."""
    tree = ast.parse(source)
    for parent in list(ast.walk(tree)):
        for field, value in ast.iter_fields(parent):
            if field in TYPES or isinstance(parent, ast.JoinedStr):
                continue
            for index, node in enumerate(value) if isinstance(value, list) else ((None, value),):
                for other in replacements(node):
                    before, after = (" ".join(ast.unparse(each).split())[:80] for each in (node, other))
                    _put(parent, field, index, other)
                    yield f"{getattr(node, 'lineno', 0)}: {before} -> {after}", ast.unparse(tree)
                    _put(parent, field, index, node)


def _put(parent: ast.AST, field: str, index: int | None, node: ast.AST) -> None:
    if index is None:
        setattr(parent, field, node)
    else:
        getattr(parent, field)[index] = node


def passes(path: str, source: str, seconds: float) -> bool:
    """Return True if the tests of a module pass in a forked process that uses this source instead."""
    pid = os.fork()
    if pid == 0:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        os.dup2(1, 2)
        resource.setrlimit(resource.RLIMIT_CPU, (round(seconds), round(seconds) + 1))
        signal.alarm(10 * round(seconds))
        try:
            os._exit(_tested(path, source))
        finally:
            os._exit(9)
    return os.waitpid(pid, 0)[1] == 0


def _tested(path: str, source: str) -> int:
    import pytest

    name = path.removesuffix(".py").replace("/", ".")
    parent, _, attribute = name.rpartition(".")
    spec = importlib.util.spec_from_file_location(name, command.ROOT / path)
    assert spec is not None
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    exec(compile(source, path, "exec"), module.__dict__)
    setattr(importlib.import_module(parent), attribute, module)
    return int(pytest.main(["-x", "-q", "-p", "no:cacheprovider", *TARGETS[path]]))


def score(path: str, sample: int) -> command.Row:
    """Return the number of mutants, the killed mutants and the survivors of one module.

    Raises:
        UsageError: The tests fail without a mutant.
    """
    source = (command.ROOT / path).read_text(encoding="utf-8")
    begun = time.monotonic()
    if not passes(path, source, 600.0):
        raise UsageError(f"{', '.join(TARGETS[path])}: fail without any mutant; repair them first")
    seconds = 2.0 * (time.monotonic() - begun) + PATIENCE
    chosen = list(mutants(source))
    chosen = chosen[:: max(1, len(chosen) // sample)][:sample] if sample else chosen
    survived = [name for name, text in chosen if passes(path, text, seconds)]
    killed = len(chosen) - len(survived)
    return {"module": path, "mutants": len(chosen), "killed": killed, "score": killed / len(chosen),
            "survived": survived}  # fmt: skip


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("modules", nargs="*", metavar="MODULE")
    command.share(parser, "sample json")
    options = parser.parse_args()
    os.environ |= {"CI": "true", "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}  # hypothesis draws the same examples each time
    os.chdir(command.ROOT)
    sys.dont_write_bytecode = True  # do not write a mutant's bytecode
    import numba  # noqa: F401  # imported before the fork, because all tests need it

    chosen = [path for path in TARGETS if not options.modules or any(part in path for part in options.modules)]
    rows = [score(path, options.sample) for path in chosen]
    heads = ("module", "mutants", "killed", "score")
    survivors = (f"{row['module']}:{name}" for row in rows for name in row["survived"])
    table = command.table(heads, ([row[head] for head in heads] for row in rows))
    command.print_tables(rows, options, lambda: [table, *survivors])
    return 0
