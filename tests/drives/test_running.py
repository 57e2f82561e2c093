"""Drives that deviate from the standard, while the daemon's loop runs in virtual time."""

from __future__ import annotations

from pathlib import Path

import pytest
import tomlkit

from tests.virtual.files import controller, plant, write
from tsa_ctrl import simulate_loop
from tsa_ctrl.virtual.result import Simulation
from tsa_ctrl.virtual.script import Change, Fault


def run(
    folder: Path,
    seconds: float,
    quirks: dict[str, object],
    profile: dict[str, object] | None = None,
    *faults: Fault,
    changes: tuple[Change, ...] = (),
) -> Simulation:
    """Simulate one axis whose plant has these quirks and whose drive has this profile."""
    tables = controller(drive={"profile": "other"} if profile is not None else {})
    paths = write(folder, tables, plant(drive=quirks))
    if profile is not None:
        (folder / "drives").mkdir()
        (folder / "drives" / "other.toml").write_text(tomlkit.dumps(profile), encoding="utf-8")
    return simulate_loop(*paths, seconds, faults=faults, changes=changes)


def texts(result: Simulation) -> list[str]:
    return [event.text for event in result.summary.events]


@pytest.mark.slow
def test_an_emergency_latches_unless_the_profile_calls_it_a_warning(tmp_path: Path) -> None:
    quirks: dict[str, object] = {"warns_when_enabled": 0x2310}
    (tmp_path / "a").mkdir()
    stopped = run(tmp_path / "a", 2.5, quirks)
    assert any("emergency: drive node 1: EMCY 0x2310" in text for text in texts(stopped))
    (tmp_path / "b").mkdir()
    told = run(tmp_path / "b", 2.5, quirks, {"warnings": [0x2310]})
    assert not told.summary.failed
    assert [text for text in texts(told) if text.startswith("warning of drive node 1: EMCY 0x2310")]


@pytest.mark.slow
def test_a_drive_that_faults_when_the_heartbeat_ends_comes_back_after_a_recovery(tmp_path: Path) -> None:
    result = run(
        tmp_path,
        4.0,
        {"watches_always": True, "mode_shows": "operational"},
        {"mode_shows": "operational"},
        Fault("power_cycle duration=0.1", 0.5),
        changes=(Change("recover", 1.0, 1.5),),
    )
    assert any("node booted while running" in text for text in texts(result))
    clock = result.truth["clock"] - result.axes[0].start
    enabled = result.truth["enabled"]
    assert enabled[(clock > 0.7) & (clock < 1.4)].max() == 0.0
    assert enabled[(clock > 3.5) & (clock < 3.9)].min() == 1.0
