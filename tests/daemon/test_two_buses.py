"""Test plant and daemon as two processes on two buses of local sockets, with a bus record for each bus."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import can
import pytest

from tests.virtual.files import controller, plant, write
from tests.virtual.test_two_buses import TWO, on_buses

pytestmark = [pytest.mark.hil, pytest.mark.slow]
TSA = [sys.executable, "-m", "tsa_ctrl"]


def test_one_daemon_and_one_plant_share_two_buses(tmp_path: Path) -> None:
    buses = [{"name": name, "interface": "datagram", "channel": f"{name}-{os.getpid()}"} for name in ("left", "right")]
    rate = {"rate": 250.0, "settle_cycles": 20}
    common = {"realtime": {"allow_without": True}, "socket": {"path": str(tmp_path / "tsa.sock")}}
    tables = on_buses(controller(file={"controller": rate, **common}), TWO, buses)
    files = write(tmp_path, tables, on_buses(plant(joint={"load": "held"}), TWO, buses))
    with subprocess.Popen([*TSA, "plant", str(files[1])], stdout=subprocess.PIPE, text=True) as nodes:
        try:
            assert nodes.stdout is not None
            assert any(line.startswith("plant: ready") for line in nodes.stdout)
            run = [*TSA, "run", str(files[0]), "--seconds", "2", "--json", "--record-bus", str(tmp_path / "run.log")]
            done = subprocess.run(run, capture_output=True, text=True, check=False, timeout=120.0)
        finally:
            nodes.terminate()
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert summary["bus"] == ", ".join(str(bus["channel"]) for bus in buses)
    assert not any(event["fault"] for event in summary["events"])
    assert summary["cycles"]["missed_pdo"] <= 0.02 * summary["cycles"]["sent"]
    for name, node in (("left", 1), ("right", 2)):
        found = {message.arbitration_id for message in can.LogReader(tmp_path / f"run-{name}.log")}
        assert {0x080, 0x200 + node, 0x180 + node} <= found
        assert not found & {0x200 + 3 - node, 0x180 + 3 - node}
