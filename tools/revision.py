"""Check out another revision of the package in a worktree, with a copy of the present tools, for comparisons.

A module of the package may have moved since that revision. Therefore each import in the copied tools is redirected to
the module that defines the name there. If the revision does not define a constant, its present value is copied.
"""

from __future__ import annotations

import ast
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from tools import command
from tsa_ctrl.errors import UsageError

WORKTREES = command.ROOT / ".cache" / "against"
PACKAGE = "tsa_ctrl"


def commit_of(revision: str) -> str:
    """Return the full hash of a revision.

    Raises:
        UsageError: The revision does not exist.
    """
    try:
        return _git(command.ROOT, revision, "rev-parse", "--verify", f"{revision}^{{commit}}")
    except UsageError:
        raise UsageError(f"--against {revision}: no such revision; git log --oneline lists them") from None


def worktree(revision: str, place: Path, copied: Sequence[str] = ("tools",)) -> None:
    """Check `revision` out at `place`, and replace the folders `copied` by the folders of the present revision.

    Raises:
        UsageError: The revision does not exist, or git failed.
    """
    commit = commit_of(revision)
    _git(command.ROOT, revision, "worktree", "prune")
    if not place.is_dir():
        place.parent.mkdir(parents=True, exist_ok=True)
        _git(command.ROOT, revision, "worktree", "add", "--detach", str(place), commit)
    _git(place, revision, "checkout", "--force", "--detach", commit)
    defined = _definitions(place)
    for name in copied:
        shutil.rmtree(place / name, ignore_errors=True)
        shutil.copytree(command.ROOT / name, place / name, ignore=shutil.ignore_patterns("__pycache__"))
        for path in (place / name).rglob("*.py"):
            _lead_imports(path, defined)


def _git(where: Path, revision: str, *words: str) -> str:
    done = subprocess.run(["git", "-C", str(where), *words], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise UsageError(f"--against {revision}: {(done.stderr.strip().splitlines() or ['git failed'])[-1]}")
    return done.stdout.strip()


def _definitions(place: Path) -> dict[str, set[str]]:
    """Return the names that each module of the package defines, its submodules included."""
    found: dict[str, set[str]] = {}
    for path in (place / PACKAGE).rglob("*.py"):
        module = ".".join(path.relative_to(place).with_suffix("").parts).removesuffix(".__init__")
        names = found.setdefault(module, set())
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                names.add(node.name)
            elif isinstance(node, ast.ImportFrom) and path.name == "__init__.py":
                names.update(alias.asname or alias.name for alias in node.names)
            elif isinstance(node, ast.Assign | ast.AnnAssign):
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                names.update(part.id for target in targets for part in ast.walk(target) if isinstance(part, ast.Name))
        parent, _, last = module.rpartition(".")
        found.setdefault(parent, set()).add(last)
    return found


def _lead_imports(path: Path, defined: dict[str, set[str]]) -> None:
    """Redirect the imports of a file to the modules in which the revision defines the imported names."""
    text = path.read_text(encoding="utf-8")
    lines = text.splitlines(keepends=True)
    imports = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.ImportFrom) and node.module]
    for node in sorted(imports, key=lambda node: -node.lineno):
        module = node.module or ""
        missing = [alias for alias in node.names if alias.name not in defined.get(module, {alias.name})]
        if module.partition(".")[0] != PACKAGE or (module in defined and not missing):
            continue
        wanted = {alias.name for alias in node.names}
        home = {alias.name: module for alias in node.names}
        copied = {}
        for name in wanted - defined.get(module, set()):
            places = [other for other, names in defined.items() if name in names]
            home[name] = max(places, key=lambda other: len(wanted & defined[other]), default=module)
            if not places and (value := _constant(module, name)) is not None:
                copied[name] = value
        words = (
            f"{one.asname or one.name} = {copied[one.name]}"
            if one.name in copied
            else f"from {home[one.name]} import {one.name}" + (f" as {one.asname}" if one.asname else "")
            for one in node.names
        )
        indent = " " * node.col_offset
        lines[node.lineno - 1 : node.end_lineno] = [f"{indent}{line}\n" for line in words]
    path.write_text("".join(lines), encoding="utf-8")


def _constant(module: str, name: str) -> str | None:
    """Return the literal that a module of the present revision assigns to a name, as source text, or None."""
    path = command.ROOT / Path(*module.split(".")).with_suffix(".py")
    for node in ast.parse(path.read_text(encoding="utf-8")).body if path.is_file() else ():
        if isinstance(node, ast.Assign) and any(isinstance(at, ast.Name) and at.id == name for at in node.targets):
            return ast.unparse(node.value) if isinstance(node.value, ast.Constant) else None
    return None
