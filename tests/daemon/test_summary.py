"""Test the summary of a run."""

from __future__ import annotations

import io
import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from tsa_ctrl.daemon.notices import MOST, Events
from tsa_ctrl.daemon.summary import BAR, SENSOR, UNKNOWN, NodeCount, Summary, TorqueError
from tsa_ctrl.ipc.mailbox import TEXT
from tsa_ctrl.ipc.protocol import Event
from tsa_ctrl.safety.causes import Cause
from tsa_ctrl.safety.limiter import MEANINGS, Reason
from tsa_ctrl.system.histogram import BINS, coarse, count, distribution


def summary() -> Summary:
    bins = [0] * BINS
    for duration in (20_000, 30_000, 10**8):
        count(bins, duration)
    return Summary(
        bus="vcan0",
        rate=1000.0,
        start=12.0,
        cause="SIGTERM",
        failed=True,
        planned=10,
        sent=8,
        skipped=2,
        overruns=1,
        late=1,
        error_frames=0,
        flooded=0,
        dropped=0,
        load=(0.5, 0.6),
        rights="SCHED_FIFO 80, 100 MiB locked",
        lateness=distribution(bins),
        work=distribution([0] * BINS),
        lateness_bins=coarse(bins),
        work_bins=coarse([0] * BINS),
        nodes=(NodeCount("knee", "drive node 1", 3, 1, 0, 0), NodeCount("knee", "joint encoder node 32", 1, 0, 0, 0)),
        torque=(
            TorqueError("knee", SENSOR, 8.0, 0.0123, -0.001, 0.05, 0.35, {"UNPROVEN": 0.25, "RATE": 0.001}),
            TorqueError("hip", UNKNOWN, 0.0, math.nan, math.nan, math.nan, math.nan, {}),
        ),
        events=(Event(0, 1.5, "knee", "heartbeat lost: [drive] node 1", True),),
        unconfirmed=(),
        simulated=False,
        joints={},
        log="/logs/a.mcap",
        log_written=8,
        log_lost=0,
    )


def shown(found: Summary, width: int = 100) -> str:
    stream = io.StringIO()
    found.show(Console(file=stream, width=width, markup=False))
    return stream.getvalue()


def test_json_has_no_nan_and_counts_cycles() -> None:
    """The JSON object contains the counts of cycles. A percentile without samples is null."""
    text = json.dumps(summary().as_dict(), allow_nan=False)
    found = json.loads(text)
    cycles = {"planned": 10, "sent": 8, "skipped": 2, "overruns": 1, "late": 1, "missed_pdo": 4, "dropped": 0}
    cycles |= {"error_frames": 0, "flooded": 0}
    assert found["cycles"] == cycles
    assert found["work"]["p50"] is None
    assert found["torque"][1]["rms"] is None
    assert found["lateness"]["bins"][-1] == [None, 1]


def test_tables_show_everything_that_matters() -> None:
    """The table begins with the torque error, and contains cause, counts, load, histograms, nodes and events."""
    text = shown(summary())
    for words in ("SIGTERM", "10 / 8", "2 in 1", "50 to 60 %", "SCHED_FIFO 80", "/logs/a.mcap: 8 records, 0 lost"):
        assert words in text
    for words in ("joint encoder node 32", "heartbeat lost: [drive] node 1", "p99", "not measured"):
        assert words in text
    assert "12.3" in text[: text.index("SIGTERM")]
    assert "unproven 25 %" in text
    assert "rate 0 %" not in text
    assert "unproven: the sensors confirm less friction" in text
    assert "rate: " not in text  # a limit that hardly acted is not explained
    assert "p99" not in shown(replace(summary(), late=0, skipped=0))  # a run on time needs no histogram


def test_the_bars_keep_their_lengths_in_a_terminal_of_80_characters() -> None:
    text = shown(summary(), 80)
    assert "…" not in text
    assert any("█" * BAR in line for line in text.splitlines())


def test_each_limit_that_may_act_on_a_torque_is_explained() -> None:
    assert set(Reason) - set(MEANINGS) == {Reason.NONE, Reason.DISABLED, Reason.NOT_FINITE, Reason.OVER_SPEED}


def test_is_kept_beside_the_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The summary with its events is saved as a JSON file with the name of the log. Without a log, none is written."""
    monkeypatch.chdir(tmp_path)
    replace(summary(), log=None).save()
    assert not list(tmp_path.iterdir())
    replace(summary(), log=str(tmp_path / "a.mcap")).save()
    kept = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    assert kept["events"][0]["text"] == "heartbeat lost: [drive] node 1"


def test_the_first_fault_is_never_dropped_and_the_newest_events_fit_the_mailbox() -> None:
    """Long events are reduced to the size of the mailbox. The first fault remains after any number of later events."""
    events = Events()
    events.add(0.0, "", "log: written again")
    events.add(1.0, "k" * 10_000, "the cause" + "\0" * 10_000, cause=Cause.SKIPPED)
    for n in range(3 * MOST):
        events.add(2.0 + n, "knee", "x" * 1000, cause=Cause.SKIPPED if n % 2 == 0 else None)
    assert events.first_fault is not None
    assert events.first_fault.text.startswith("the cause")
    assert len(events.all) == MOST
    told = json.loads(events.encoded())
    assert (told[0]["number"], told[0]["t"]) == (1, 1.0)
    assert told[-1]["t"] == 3 * MOST + 1
    assert len(events.encoded()) <= TEXT
