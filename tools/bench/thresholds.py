"""A number at the head of a module of tsa_ctrl/identify, by its name, and another value in its place."""

from __future__ import annotations

import ast
import importlib
import pkgutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tools import command

ROOT = "tsa_ctrl.identify"
NO_CHOICE = ("SHRINK", "SINGULAR", "TRIAL", "AT_BOUND", "RIDGE")  # of geometry and of rounding: nothing is decided


@dataclass(frozen=True)
class Constant:
    """A number, or several, at the head of a module."""

    module: str
    name: str

    def __str__(self) -> str:
        return f"{self.module.removeprefix(ROOT + '.')}.{self.name}"

    @property
    def value(self) -> Any:
        return getattr(importlib.import_module(self.module), self.name)


def constants_in(path: Path) -> list[str]:
    """Names in capitals at the head of a module that hold numbers, none of them a truth value or a text."""
    names = []
    for statement in ast.parse(path.read_text(encoding="utf-8")).body:
        target = statement.targets[0] if isinstance(statement, ast.Assign) else getattr(statement, "target", None)
        value = getattr(statement, "value", None)
        if not isinstance(statement, ast.Assign | ast.AnnAssign) or target is None or value is None:
            continue
        numbers = [each.value for each in ast.walk(value) if isinstance(each, ast.Constant)]
        if any(isinstance(number, int | float) and not isinstance(number, bool) for number in numbers):
            names += [each.id for each in ast.walk(target) if isinstance(each, ast.Name) and each.id.isupper()]
    return [name for name in names if name not in NO_CHOICE]


def asked_for(text: str) -> list[Constant]:
    """The constants that a name stands for. Raises SystemExit where there is none."""
    folder = command.ROOT / ROOT.replace(".", "/")
    parts = text.split(".")
    for cut, chosen in ((len(parts), None), (len(parts) - 1, parts[-1])):
        path = folder.joinpath(*parts[:cut]).with_suffix(".py")
        if cut and path.is_file():
            module = ".".join([ROOT, *parts[:cut]])
            names = [name for name in constants_in(path) if chosen in (None, name)]
            if names:
                return [Constant(module, name) for name in names]
    raise SystemExit(
        f"tools/run bench/constants: {text}: no number of that name; name one as selection/entry.py has it"
    )


def scaled(value: Any, factor: float) -> Any:
    """The number, or each of a tuple, times a factor; whole ones stay whole, and above 0. TypeError for others."""
    if isinstance(value, tuple):
        return tuple(scaled(each, factor) for each in value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError
    return max(1, round(value * factor)) if isinstance(value, int) and value > 0 else value * factor


@contextmanager
def changed(constant: Constant, factor: float) -> Iterator[None]:
    """The constant scaled in its module, in those that import it from there, and in defaults of their functions."""
    with replaced(constant, scaled(constant.value, factor)):
        yield


@contextmanager
def replaced(constant: Constant, new: Any) -> Iterator[None]:
    """Another value in its place, wherever it is used."""
    old, users = constant.value, users_of(constant)
    defaults = [(each, each.__defaults__) for module in users for each in _defaulting(module, constant)]
    for module in users:
        setattr(module, constant.name, new)
    for function, values in defaults:
        function.__defaults__ = tuple(new if each is old else each for each in values)
    try:
        yield
    finally:
        for module in users:
            setattr(module, constant.name, old)
        for function, values in defaults:
            function.__defaults__ = values


def users_of(constant: Constant) -> list[Any]:
    """Its own module, and those that import it from there."""
    return [module for name, module in list(sys.modules.items()) if _uses(name, module, constant)]


def _uses(name: str, module: Any, constant: Constant) -> bool:
    if not name.startswith(ROOT) or not hasattr(module, constant.name):
        return False
    found = [
        each for each in tree_of(module).body if isinstance(each, ast.ImportFrom) and each.module == constant.module
    ]
    return name == constant.module or any(alias.name == constant.name for each in found for alias in each.names)


def tree_of(module: Any) -> ast.Module:
    return ast.parse(Path(module.__file__).read_text(encoding="utf-8"))


def _defaulting(module: Any, constant: Constant) -> list[Any]:
    """The functions of a module of which a default argument is the constant."""
    functions = [each for each in tree_of(module).body if isinstance(each, ast.FunctionDef)]
    by = {each.name: [part.id for part in each.args.defaults if isinstance(part, ast.Name)] for each in functions}
    return [getattr(module, name) for name, defaults in by.items() if constant.name in defaults]


def import_all() -> None:
    """Every module that may use a constant: one that is imported while it is changed would keep what it found."""
    root = importlib.import_module(ROOT)
    for module in pkgutil.walk_packages(root.__path__, f"{ROOT}."):
        importlib.import_module(module.name)
