"""tools/environment.sh reports a missing requirement in one line, and keeps the compiled build."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from tests.conftest import ROOT

OLD = "#!/bin/sh\ncase $1 in --version) echo Python 3.9.2;; *) exit 1;; esac\n"
WITHOUT_VENV = '#!/bin/sh\ncase "$*" in -c*) exit 0;; *) echo "ensurepip is not available" >&2; exit 1;; esac\n'
WITHOUT_REGISTRY = """#!/bin/sh
case "$*" in
    -c*) exit 0;;
    "-m venv"*) mkdir -p "$4/bin"; cp "$0" "$4/bin/python";;
    *"pip install"*) echo "WARNING: Retrying" >&2; echo "ERROR: No matching distribution found for numpy" >&2; exit 1;;
esac
"""


@pytest.mark.parametrize(
    ("python", "message"),
    [
        (OLD, "Python 3.11 or later is needed, found Python 3.9.2"),
        (WITHOUT_VENV, "python3-venv"),
        (WITHOUT_REGISTRY, "pip could not install the project: ERROR: No matching distribution found for numpy"),
    ],
)
def test_a_lack_is_one_line(tmp_path: Path, python: str, message: str) -> None:
    """tools/demo runs on a machine whose python3 is too old or has no venv, or that reaches no registry."""
    (tmp_path / "tools").mkdir()
    for name in ("environment.sh", "demo"):
        shutil.copy(ROOT / "tools" / name, tmp_path / "tools")
    (tmp_path / "pyproject.toml").touch()
    stub = tmp_path / "bin"
    stub.mkdir()
    for name in ("python3", "python", *(f"python3.{minor}" for minor in range(11, 16))):
        (stub / name).write_text(python)
        (stub / name).chmod(0o755)
    environment = {"PATH": f"{stub}:/usr/bin:/bin", "HOME": str(tmp_path)}
    done = subprocess.run([tmp_path / "tools" / "demo"], capture_output=True, text=True, env=environment)
    assert done.returncode == 1
    *progress, line = done.stderr.splitlines()
    assert line.startswith("tools/demo: ")
    assert message in line
    assert all("installing into .venv" in line for line in progress)
