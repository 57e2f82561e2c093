"""The long run on a vcan ends its daemon, whatever happens."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from tests.system.test_parent import alive
from tools.bench import soak
from tsa_ctrl.errors import BusError

DEAF = "import os, pathlib, time\npathlib.Path('pid').write_text(str(os.getpid()))\ntime.sleep(600)\n"


def test_a_daemon_that_never_answers_is_reported_and_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "tsa_ctrl").mkdir()  # python -m finds the package of its folder first
    (tmp_path / "tsa_ctrl" / "__init__.py").touch()
    (tmp_path / "tsa_ctrl" / "__main__.py").write_text(DEAF)
    monkeypatch.setattr(soak, "START", 2.0)
    begin = time.monotonic()
    with pytest.raises(BusError, match="the daemon does not answer"):
        soak.soak(tmp_path, 1.0)
    assert time.monotonic() - begin < 20.0
    assert not alive(int((tmp_path / "pid").read_text()))
