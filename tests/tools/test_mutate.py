"""campaign/mutate: mutants are what they say, the list of equivalents is current, and a fixed sample is killed."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import ROOT
from tools.campaign.mutate import EQUIVALENT
from tools.campaign.mutation.mutants import enums_of, mutants

SAMPLE = 2
SOURCE = '''
class Limit:
    high: float = 2.0

    def update(self, wanted: float, fresh: bool) -> float:
        """A docstring."""
        if not fresh or wanted > self.high:
            return 0.0
        return wanted
'''


def run(*arguments: str) -> tuple[int, dict[str, Any]]:
    done = subprocess.run(
        [sys.executable, str(ROOT / "tools"), "campaign/mutate", "--json", *arguments],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout, done.stderr
    return done.returncode, json.loads(done.stdout)


def test_each_mutant_is_another_program_with_a_name_of_its_own() -> None:
    """Every one compiles, differs, and keeps annotations of functions and docstrings."""
    found = mutants(SOURCE, "m.py", {})
    assert len({mutant.name for mutant in found}) == len(found)
    assert len({mutant.source for mutant in found}) == len(found)
    for mutant in found:
        compile(mutant.source, "m.py", "exec")
        assert mutant.source != ast.unparse(ast.parse(SOURCE))
        assert "wanted: float, fresh: bool) -> float" in mutant.source
        assert "A docstring." in mutant.source


@pytest.mark.parametrize(
    "name",
    [
        "m.py Limit: high: float = 2.0 -> high: float = 2.5",
        "m.py Limit.update: if not fresh or wanted > self.high: -> if not fresh or wanted >= self.high:",
        "m.py Limit.update: if not fresh or wanted > self.high: -> if not fresh and wanted > self.high:",
        "m.py Limit.update: if not fresh or wanted > self.high: -> if wanted > self.high:",
        "m.py Limit.update: if not fresh or wanted > self.high: -> if False:",
        "m.py Limit.update: return 0.0 -> pass",
        "m.py Limit.update: return wanted -> return None",
    ],
)
def test_mistakes_that_somebody_could_make_are_among_them(name: str) -> None:
    """Boundaries, conditions, statements, constants, results."""
    assert name in {mutant.name for mutant in mutants(SOURCE, "m.py", {})}


def test_members_of_an_enum_are_confused() -> None:
    """Each with the next one."""
    source = "from enum import Enum\nclass S(Enum):\n    A = 'a'\n    B = 'b'\ndef f():\n    return S.B\n"
    assert enums_of(source) == {"S": ["A", "B"]}
    assert "m.py f: return S.B -> return S.A" in {mutant.name for mutant in mutants(source, "m.py", enums_of(source))}


@pytest.mark.slow
def test_a_fixed_sample_is_killed_and_the_list_is_current() -> None:
    """The same mutants each time; entries of the list that name none would be problems here, too."""
    code, found = run("--sample", str(SAMPLE), "--jobs", "2")
    assert found["problems"] == []
    assert code == 0
    assert sum(row["mutants"] for row in found["modules"]) == SAMPLE


@pytest.mark.slow
def test_a_mutant_that_no_test_sees_is_found(tmp_path: Path) -> None:
    """With a list that is empty the equivalent mutants of a small module survive, and that is an error."""
    listed = EQUIVALENT.read_text(encoding="utf-8")
    names = [line.strip().strip('",') for line in listed.splitlines() if "shut_down.py" in line]
    assert names
    (tmp_path / "names").write_text(names[0], encoding="utf-8")
    (tmp_path / "none.toml").touch()
    only = ("shut_down", "--names", str(tmp_path / "names"))
    code, found = run(*only, "--equivalent", str(tmp_path / "none.toml"))
    assert (code, len(found["problems"])) == (1, 1)
