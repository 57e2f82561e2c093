"""What tools/test makes of tests in real time that fail: tried once more, alone; told; and a defect fails again."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

TOOLS = Path(__file__).parents[2] / "tools"
ENVIRONMENT = """
root=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd)
export PATH=$root/bin:$PATH
ensure_venv() { :; }
compile_plant() { :; }
"""
# Fails what `fails` names, on a vcan and on a bus; tried by its name, what `defect` names.
PYTEST = """#!/usr/bin/env bash
echo "$* ${TSA_CLAIMS:-alone}" >>"$STATE/calls"
stage=others
for word in "$@"; do
    case $word in
        *::*) stage=again ;;
        *'not vcan and not hil') stage=others ;;
        *'hil and not vcan') stage=bus ;;
        *') and vcan') stage=vcan ;;
    esac
done
if [[ " $FAILS " == *" $stage "* ]]; then
    echo "ERROR    some.module:file.py:110 a line of a log"
    echo "FAILED tests/test_real.py::test_it[a b] - AssertionError: late"
    echo "1 failed in 0.1s"
    exit 1
fi
echo "1 passed in 0.1s"
"""


@pytest.mark.parametrize(
    ("fails", "code", "told"),
    [
        ("", 0, 0),
        ("vcan", 0, 1),
        ("bus", 0, 1),
        ("vcan again", 1, 1),
        ("bus again", 1, 1),
        ("others", 1, 0),  # nothing of it is in real time: no second try
    ],
)
def test_a_failure_in_real_time_is_tried_once_more_and_alone(tmp_path: Path, fails: str, code: int, told: int) -> None:
    for folder in ("tools", "tests", "bin", ".cache"):
        (tmp_path / folder).mkdir()
    shutil.copy(TOOLS / "test", tmp_path / "tools" / "test")
    (tmp_path / "tools" / "environment.sh").write_text(ENVIRONMENT)
    scripts = {"bin/pytest": PYTEST, "tools/vcan": '#!/usr/bin/env bash\nexec "$@"\n'}
    scripts |= dict.fromkeys(("bin/ruff", "bin/mypy"), "#!/usr/bin/env bash\n")
    for name, text in scripts.items():
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o755)
    environment = {**os.environ, "STATE": str(tmp_path), "FAILS": fails, "CI": "", "TSA_VCAN": ""}
    done = subprocess.run([tmp_path / "tools" / "test"], env=environment, capture_output=True, text=True)
    assert done.returncode == code, done.stdout + done.stderr
    assert done.stdout.count("tests/test_real.py::test_it[a b]: failed beside other work, tried once more") >= told
    tried = [line for line in (tmp_path / "calls").read_text().splitlines() if "::" in line]
    assert len(tried) == told
    assert all(line.endswith("tests/test_real.py::test_it[a b] alone") for line in tried)
    assert ("passed" if code == 0 else "failed") in done.stdout.split("\nonce more")[-1].split("\n")[0] or not told
