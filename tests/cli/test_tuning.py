"""Test the display while `tsa tune` moves a rig. The daemon runs in virtual time."""

from __future__ import annotations

import contextlib
import re
from functools import partial
from pathlib import Path

import pytest

from tests.daemon.serving import Serving
from tests.virtual.files import controller, plant, write
from tests.virtual.serving import ServedRun
from tsa_ctrl.cli import tuning
from tsa_ctrl.cli.tuning import Live
from tsa_ctrl.config import load_configuration
from tsa_ctrl.ipc.client import Client
from tsa_ctrl.ipc.connection import CLIENTS
from tsa_ctrl.tune.procedure import PHASES, phase


@pytest.mark.slow
def test_torque_and_angle_come_from_the_daemon_that_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = write(
        tmp_path,
        controller(
            setpoint={"kind": "constant", "offset": 0.3},
            file={"socket": {"path": str(tmp_path / "tsa.sock")}},
        ),
        plant(joint={"load": "held"}),
    )
    run = ServedRun(*files, seconds=2.0)
    monkeypatch.setattr(tuning, "Client", partial(Client, clock=run.clock, sleep=run.sleep))
    found: list[str] = []
    (name,) = (axis.name for axis in load_configuration(files[0]).file.axes)

    def look() -> None:
        live = Live(name, run.path)
        found.append(live.words())
        run.sleep(1.5)
        found.append(live.words())
        live.close()

    run.control(0.1, look)
    run.simulate()
    early, late = (float(re.match(r"([+-]\d\.\d\d) N\*m at the joint, [+-]0\.00 rad; $", words)[1]) for words in found)  # type: ignore[index]
    assert early < 0.1 < 0.2 < late < 0.4


def test_where_no_daemon_answers_nothing_is_shown(tmp_path: Path) -> None:
    live = Live("joint", str(tmp_path / "tsa.sock"))
    assert live.words() == live.words() == ""


def test_a_rejection_by_the_daemon_shows_nothing(tmp_path: Path) -> None:
    """The daemon closes the connection that has been silent longest, with a rejection. The display connects again."""
    serving = Serving(tmp_path / "tsa.sock", ["joint"])
    live = Live("joint", serving.path)
    assert "rad" in live.words()
    with contextlib.ExitStack() as others:
        for _ in range(CLIENTS):
            others.enter_context(Client(serving.path)).measure()
        assert live.words() == ""
        assert "rad" in live.words()
    live.close()
    serving.end()


def test_each_phase_says_its_place() -> None:
    assert phase("probe-2") == f"phase 1 of {len(PHASES)}: probe-2"
    assert [phase(name).split()[1] for name in PHASES] == [str(1 + n) for n in range(len(PHASES))]
