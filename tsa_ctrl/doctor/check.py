"""One finding about the machine: what was found, what is wanted, and the command that mends it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Result(Enum):
    """What a check found."""

    PASS = "pass"
    WARN = "warn"
    FAIL = "fail"


@dataclass(frozen=True)
class Check:
    """`fix` is a command or one sentence; empty for a pass."""

    name: str
    result: Result
    found: str
    wanted: str
    fix: str = ""

    def to_dict(self) -> dict[str, str]:
        return {
            "name": self.name,
            "result": self.result.value,
            "found": self.found,
            "wanted": self.wanted,
            "fix": self.fix,
        }


def judge(name: str, good: bool, found: str, wanted: str, fix: str, otherwise: Result = Result.WARN) -> Check:
    """A pass when `good`, else `otherwise` with its fix."""
    return Check(name, Result.PASS, found, wanted) if good else Check(name, otherwise, found, wanted, fix)
