"""Test tools/run: its commands, and errors for unknown names."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.conftest import ROOT
from tools.__main__ import commands


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(ROOT / "tools"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_alone_it_lists_every_command_with_its_first_line() -> None:
    done = run()
    assert (done.returncode, done.stderr) == (0, "")
    for name, text in commands().items():
        assert name in done.stdout
        assert text in done.stdout


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("bench_diagnose", "did you mean 'bench/diagnose'?"),
        ("xyz", "tools/run alone lists what there is"),
        ("figures/look", "no such command"),  # a part of commands
        ("bench/../bench/cycle", "no such command"),
    ],
)
def test_a_name_that_is_none_is_one_line(name: str, hint: str) -> None:
    done = run(name)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert hint in done.stderr
