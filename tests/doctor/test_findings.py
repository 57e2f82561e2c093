"""Test that each check of `tsa doctor` fails for its cause and prints the command that corrects it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.bus.fake import FakeBus
from tsa_ctrl.bus.settings import AxisNodes, BusSettings, DriveSettings
from tsa_ctrl.bus.wire.link import CanState, Interface
from tsa_ctrl.doctor import can_interface, machine
from tsa_ctrl.doctor.can_interface import Check, Result
from tsa_ctrl.system.realtime import RealtimeSettings

GOOD = Interface(
    up=True, kind="can", queue_length=128, bitrate=1_000_000, state=CanState.ERROR_ACTIVE, errors=(0, 0), is_can=True,
    restart_ms=0, name="can0",
)  # fmt: skip


def of_link(monkeypatch: pytest.MonkeyPatch, **changes: Any) -> dict[str, Check]:
    """Return the checks of the interface by name. `changes` replaces values reported by the kernel."""
    monkeypatch.setattr(can_interface, "read", lambda channel: replace(GOOD, **changes))
    checks = can_interface.checks(BusSettings(channel="can0"), [], 1000.0)
    return {check.name: check for check in checks}


def test_a_good_interface_passes_in_every_line(monkeypatch: pytest.MonkeyPatch) -> None:
    lines = of_link(monkeypatch)
    names = {"CAN interface", "bit rate", "error counters", "automatic restart", "transmit queue", "lost frames"}
    assert {name for name in names if lines[name].result is Result.PASS} == names


@pytest.mark.parametrize(
    ("changes", "name", "result", "found", "fix"),
    [
        ({"up": False}, "CAN interface", Result.FAIL, "down", "ip link set can0 up"),
        ({"bitrate": 500_000}, "bit rate", Result.FAIL, "500000 bit/s", "bitrate 1000000"),
        ({"state": CanState.ERROR_PASSIVE}, "error counters", Result.FAIL, "ERROR-PASSIVE", "termination"),
        ({"errors": (0, 3)}, "error counters", Result.FAIL, "rx 3", "termination"),
        ({"restart_ms": 100}, "automatic restart", Result.WARN, "restart-ms 100", "restart-ms 0"),
        ({"queue_length": 1000}, "transmit queue", Result.WARN, "1000 frames", "txqueuelen 128"),
        ({"queue_length": 0}, "transmit queue", Result.WARN, "0 frames", "txqueuelen 128"),
        ({"lost": 5}, "lost frames", Result.WARN, "5 errors and drops", "bus load"),
    ],
)
def test_each_line_of_an_interface_can_say_no(
    monkeypatch: pytest.MonkeyPatch, changes: dict[str, Any], name: str, result: Result, found: str, fix: str
) -> None:
    line = of_link(monkeypatch, **changes)[name]
    assert (line.result, found in line.found, fix in line.fix) == (result, True, True)


def judged(bus: FakeBus) -> Check:
    axis = AxisNodes(name="knee", drive=DriveSettings(node_id=1, slot=2))
    return can_interface.judged(bus, can_interface.listen(bus), BusSettings(), [axis], "")


def test_somebody_who_sends_what_a_master_sends_fails() -> None:
    """A bus with answers alone passes."""
    for can_id in (0x000, 0x080, 0x201, 0x27F, 0x301, 0x605, 0x77F):
        bus = FakeBus()
        bus.waiting.extend([(0x181, bytes(8)), (can_id, b"")])
        check = judged(bus)
        assert check.result is Result.FAIL
        assert f"another master sends 0x{can_id:03X}" in check.found
        assert "tsa stop" in check.fix
    bus = FakeBus()
    bus.waiting.extend([(0x181, bytes(8)), (0x701, b"\x05")])
    assert judged(bus).result is Result.PASS


@pytest.mark.parametrize(
    ("release", "flag", "result", "found"),
    [
        ("#1 SMP PREEMPT_RT Debian", "", Result.PASS, "PREEMPT_RT"),
        ("#1 SMP", "1", Result.PASS, "PREEMPT_RT"),
        ("#1 SMP PREEMPT_DYNAMIC", "", Result.WARN, "PREEMPT"),
        ("#1 SMP", "0", Result.WARN, "no full preemption"),
    ],
)
def test_the_kernels_preemption(
    monkeypatch: pytest.MonkeyPatch, release: str, flag: str, result: Result, found: str
) -> None:
    monkeypatch.setattr(machine.platform, "version", lambda: release)
    monkeypatch.setattr(machine, "text_of", lambda path: flag)
    check = machine.kernel()
    assert (check.result, check.found.rpartition(", ")[2]) == (result, found)


@pytest.mark.parametrize(("runtime", "result"), [("950000", Result.PASS), ("-1", Result.PASS), ("500000", Result.WARN)])
def test_real_time_throttling(monkeypatch: pytest.MonkeyPatch, runtime: str, result: Result) -> None:
    monkeypatch.setattr(machine, "text_of", lambda path: runtime if "runtime" in path.name else "1000000")
    check = machine.throttling()
    assert check.result is result
    assert check.fix == ("" if result is Result.PASS else "sysctl kernel.sched_rt_runtime_us=950000")


def test_one_processor_is_too_few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine.os, "cpu_count", lambda: 1)
    assert machine.processors().result is Result.WARN


@pytest.mark.parametrize(
    ("fifo", "locked", "late", "results"),
    [
        (True, 1 << 20, 50e-6, (Result.PASS, Result.PASS, Result.PASS)),
        (False, 1 << 20, 50e-6, (Result.FAIL, Result.PASS, Result.PASS)),
        (True, 0, 50e-6, (Result.PASS, Result.FAIL, Result.PASS)),
        (True, 1 << 20, 400e-6, (Result.PASS, Result.PASS, Result.FAIL)),
    ],
)
def test_rights_and_lateness_as_found(
    monkeypatch: pytest.MonkeyPatch, fifo: bool, locked: int, late: float, results: tuple[Result, ...]
) -> None:
    found = (fifo, 80 if fifo else 0, locked, (), np.full(100, late))
    monkeypatch.setattr(machine, "_in_a_process", lambda *_: found)
    lines = list(machine.checks(RealtimeSettings(), 1000.0, 0.1))[-3:]
    assert tuple(line.result for line in lines) == results
    assert all(bool(line.fix) == (line.result is not Result.PASS) for line in lines)


def test_a_single_late_cycle_is_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    late = np.full(1000, 20e-6)
    late[7] = 2e-3
    monkeypatch.setattr(machine, "_in_a_process", lambda *_: (True, 80, 1 << 20, (), late))
    assert list(machine.checks(RealtimeSettings(), 1000.0, 0.1))[-1].result is Result.WARN


def test_an_existing_vcan_that_is_down_is_set_up_without_a_bit_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    assert of_link(monkeypatch, up=False, kind="vcan")["CAN interface"].fix == "ip link set can0 up"
