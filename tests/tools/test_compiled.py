"""The compiled modules have no construct that mypyc compiles incorrectly, and both builds have the same results."""

from __future__ import annotations

import ast
import importlib.util
import subprocess
import sys
from types import ModuleType

import pytest

from tests.conftest import ROOT
from tools import compiled


def backend() -> ModuleType:
    """Load the build backend, which pip imports from its folder."""
    spec = importlib.util.spec_from_file_location("backend", ROOT / "tools" / "package" / "backend.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


MODULES = backend().modules()


def names_of(nodes: list[ast.expr]) -> set[str]:
    return {ast.unparse(node).rpartition(".")[2] for node in nodes}


def defaults(arguments: ast.arguments) -> list[ast.expr]:
    return [*arguments.defaults, *(each for each in arguments.kw_defaults if each)]


def forbidden(tree: ast.Module) -> set[str]:
    """Return constructs that mypyc compiles incorrectly or not at all, for example settings and ctypes structures."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef):
            bases = names_of(node.bases)
            if node.keywords or "Struct" in bases:
                found.add(f"class {node.name}: mypyc ignores the arguments of the class")
            if bases & {"Structure", "Union"}:
                found.add(f"class {node.name}: a structure of ctypes")
            if any("Enum" in base for base in bases) and any(
                isinstance(each, ast.FunctionDef) and each.name == "__init__" for each in node.body
            ):
                found.add(f"class {node.name}: the constructor of an Enum does not accept its members")
            if not any("Enum" in base for base in bases):
                plain = {ast.unparse(each.targets[0]) for each in node.body if isinstance(each, ast.Assign)}
                read = {
                    each.attr
                    for each in ast.walk(node)
                    if isinstance(each, ast.Attribute) and ast.unparse(each.value) == "cls"
                }
                found |= {f"class {node.name}: cls.{name} must be declared as a ClassVar" for name in read & plain}
            if "Protocol" in bases and any(isinstance(each, ast.AnnAssign) and each.value for each in node.body):
                found.add(f"class {node.name}: a value in a Protocol")
        elif isinstance(node, ast.Call) and names_of([node.func]) == {"TypeVar"} and len(node.args) > 1:
            found.add("a TypeVar with values")
        elif isinstance(node, ast.Import | ast.ImportFrom):
            found |= {name for name in ("ctypes", "numba", "plant.compiled") if name in ast.unparse(node)}
        elif isinstance(node, ast.FunctionDef) and "..." in map(ast.unparse, defaults(node.args)):
            found.add(f"{node.name}: the default is evaluated, and an ellipsis is no value of its type")
        elif isinstance(node, ast.Lambda) and any(isinstance(each, ast.Lambda) for each in ast.walk(node.body)):
            found.add(f"line {node.lineno}: a lambda in a lambda ends mypyc with an internal error")
    return found


@pytest.mark.parametrize("path", MODULES)
def test_a_compiled_module_has_nothing_that_mypyc_compiles_wrongly(path: str) -> None:
    """A Struct would lose frozen and forbid_unknown_fields without a message."""
    assert forbidden(ast.parse((ROOT / path).read_text(encoding="utf-8"))) == set()


def test_compiled_and_interpreted_classes_do_not_inherit_from_each_other() -> None:
    """An interpreted class cannot inherit from a compiled one: it raises TypeError when it is used."""
    home = {}
    for path in sorted((ROOT / "tsa_ctrl").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                name = str(path.relative_to(ROOT).with_suffix("")).replace("/", ".")
                home[name, node.name] = (str(path.relative_to(ROOT)) in MODULES, node)
    wrong = []
    for (module, name), (is_compiled, node) in home.items():
        tree = ast.parse((ROOT / f"{module.replace('.', '/')}.py").read_text(encoding="utf-8"))
        imports = [each for each in ast.walk(tree) if isinstance(each, ast.ImportFrom)]
        origin = {
            alias.asname or alias.name: (each.module or "", alias.name) for each in imports for alias in each.names
        }
        bases = [home.get(origin.get(ast.unparse(base), ("", ""))) for base in node.bases]
        wrong += [f"{module}.{name}" for base in bases if base is not None and base[0] != is_compiled]
    assert wrong == []


def test_the_cycle_is_in_the_list() -> None:
    """`tsa doctor` and the header of a log determine the kind of build from this module."""
    from tsa_ctrl.version import CYCLE

    assert f"{CYCLE.replace('.', '/')}.py" in MODULES


def test_a_value_that_is_neither_0_nor_1_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TSA_COMPILE", "yes")
    with pytest.raises(ValueError, match="set it to 1"):
        backend().wanted()


def test_without_the_variable_nothing_is_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("TSA_COMPILE", raising=False)
    module = backend()
    assert module.extensions() == []
    assert module.get_requires_for_build_wheel() == []


def test_an_editable_compiled_build_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    """It would continue to run the old machine code after a change of the source."""
    monkeypatch.setenv("TSA_COMPILE", "1")
    with pytest.raises(ValueError, match="without --editable"):
        backend().get_requires_for_build_editable()


@pytest.mark.slow
def test_both_builds_give_the_same_log_and_truth() -> None:
    if not compiled.build_folder().is_dir():
        pytest.skip("no compiled build of this source: tools/run package/compiled makes one")
    line = [sys.executable, str(ROOT / "tools"), "package/compiled", "--rows", "2"]
    done = subprocess.run(line, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "2 equal to the last bit" in done.stdout
