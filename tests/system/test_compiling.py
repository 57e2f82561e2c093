"""The first compilation on a machine prints one notice, and later ones none."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from tsa_ctrl.system.compiling import NOTICE

MODULE = """
from numba import njit
from tsa_ctrl.system.compiling import announce

announce()
announce()

@njit(cache=True)
def double(x):
    return 2.0 * x

@njit(cache=True)
def treble(x):
    return 3.0 * x

double(1.0)
treble(1.0)
"""


def test_only_the_first_use_is_announced_and_once(tmp_path: Path) -> None:
    script = tmp_path / "functions.py"
    script.write_text(MODULE, encoding="utf-8")
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    said = [
        subprocess.run(
            [sys.executable, str(script)], env=environment, capture_output=True, text=True, timeout=120, check=True
        ).stderr.splitlines()
        for _ in range(2)
    ]
    assert said == [[NOTICE], []]
