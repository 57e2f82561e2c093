"""Each error of a failed startup contains a remedy. The messages are read from the source code."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from tests.conftest import ROOT

PLACES = ("tsa_ctrl/bus", "tsa_ctrl/drills")
# Verbs in the imperative that state a remedy.
DO = re.compile(
    r"\b(correct|write|give|raise|check|use|choose|power|cut|stop|start|leave|map|lower|remove|repair|load|plug|set|watch|"
    r"mend|did you mean|allowed are|needs more)\b"
)
ELSEWHERE = (  # messages that another function completes; the listed tests check them
    "another_master",
    "_not_booted",
    "node {node_id} rejects {entry}",  # cure() appends the remedy where it is caught: test_start, test_matrix
    "{path}: {error}",
    "{name}: {error}{holds}; {cure(",
    "read back {kept}; {cure(",
    "supported modes 0x{modes:08X}{_instead(modes)}",
    "the drive {refusal}",  # set_node_id raises both errors with a remedy: test_lss
    "absent: unknown object '{absent}'; {advice}",  # suggests a similar name or lists the names: test_profile
    "SYNCs in time (late {health.late}",  # _said completes it
    "torque was lost before anything was done",  # ends with the first message of the loop
    "the loop ended before there was torque",
)


def text(node: ast.expr) -> str:
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(text(value) for value in node.values)
    return (
        "{" + ast.unparse(node.value) + _format(node) + "}"
        if isinstance(node, ast.FormattedValue)
        else ast.unparse(node)
    )


def _format(node: ast.FormattedValue) -> str:
    return "" if node.format_spec is None else ":" + text(node.format_spec)


def raised() -> Iterator[tuple[str, str]]:
    """Yield the place of each raised error, and its message with the fields in braces."""
    for place in PLACES:
        for path in sorted((ROOT / place).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
                    name = ast.unparse(node.exc.func)
                    if name in ("BusError", "UsageError", "SdoRefusedError"):
                        yield f"{path.relative_to(ROOT)}:{node.lineno}", text(node.exc.args[0])


def test_a_refusal_says_what_mends_it() -> None:
    messages = list(raised())
    lacking = [one for one in messages if not (DO.search(one[1]) or any(part in one[1] for part in ELSEWHERE))]
    assert lacking == []
    assert len(messages) > 50
    assert not DO.search("axis 'knee': the drive is blue")
