"""Every number at the top of a module of identify has a comment that gives its meaning and the reason for its value."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import tsa_ctrl.identify

MODULES = sorted(Path(tsa_ctrl.identify.__file__).parent.rglob("*.py"))
FEWEST_WORDS = 3  # a unit alone is not a reason; "at most" with a quantity is one


def reasons(source: str) -> dict[str, str]:
    """Return the comment of each upper-case assignment that contains a number.

    The comment is on the lines of the assignment or directly above it.
    """
    lines, found = source.splitlines(), {}
    for statement in ast.parse(source).body:
        if not isinstance(statement, ast.Assign | ast.AnnAssign) or statement.value is None:
            continue
        target = statement.targets[0] if isinstance(statement, ast.Assign) else statement.target
        names = [node.id for node in ast.walk(target) if isinstance(node, ast.Name) and node.id.isupper()]
        numbers = [node.value for node in ast.walk(statement.value) if isinstance(node, ast.Constant)]
        if not names or not any(isinstance(n, int | float) and not isinstance(n, bool) for n in numbers):
            continue
        own = lines[statement.lineno - 1 : statement.end_lineno]
        words = [line.split("# ", 1)[1] for line in own if "# " in line]
        above = statement.lineno - 2
        while above >= 0 and lines[above].startswith("# "):
            words.insert(0, lines[above].removeprefix("# "))
            above -= 1
        found[", ".join(names)] = " ".join(words)
    return found


@pytest.mark.parametrize("module", MODULES, ids=lambda path: str(path.relative_to(MODULES[0].parent)))
def test_each_number_says_why_it_has_its_value(module: Path) -> None:
    silent = [
        name for name, why in reasons(module.read_text(encoding="utf-8")).items() if len(why.split()) < FEWEST_WORDS
    ]
    assert not silent, f"{module.name}: {', '.join(silent)}: say in a comment what the number is and why"


def test_a_number_without_a_comment_is_found() -> None:
    source = (
        "# above it, with a reason\nA = 1\nB = 2.0\nC = 3  # s\n"
        "D, E = 1, 2  # two of them at once\nF = 'text'\nG = True\n"
    )
    assert reasons(source) == {"A": "above it, with a reason", "B": "", "C": "s", "D, E": "two of them at once"}
