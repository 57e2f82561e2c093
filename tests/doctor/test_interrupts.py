"""Test the checks of processors and interrupt threads on /proc and /sys trees in the kernel's documented format."""

from __future__ import annotations

from pathlib import Path

import pytest

from tsa_ctrl.doctor.can_interface import Check, Result
from tsa_ctrl.doctor.machine import can_interrupts, isolation
from tsa_ctrl.system.realtime import RealtimeSettings

HEAD = "           CPU0       CPU1       CPU2       CPU3\n"
STAT = "{pid} (irq/{number}-{name}) S 2 0 0 0 -1 2129984 0 0 0 0 0 12 0 0 -51 0 1 0 9 0 0 18446744073709551615 0 0 0 0 0 0 0 2147483647 0 0 0 0 17 1 {priority} {policy} 0 0 0 0 0 0 0 0 0 0 0\n"  # noqa: E501


class Kernel:
    """A machine with four processors. `isolated` is a list in the format of the kernel."""

    def __init__(self, folder: Path, isolated: str = "3") -> None:
        self.proc, self.sys = folder / "proc", folder / "sys"
        cpus = self.sys / "devices/system/cpu"
        cpus.mkdir(parents=True)
        self.proc.mkdir()
        (cpus / "present").write_text("0-3\n")
        (cpus / "isolated").write_text(f"{isolated}\n")
        self.lines = ""

    def interface(self, device: str, name: str = "can0") -> Path:
        """Add a network interface on a device (a path below /sys/devices) and return the folder of the device."""
        folder = self.sys / "devices" / device
        (folder / "net" / name).mkdir(parents=True)
        (folder / "net" / name / "device").symlink_to(folder)
        net = self.sys / "class/net"
        net.mkdir(parents=True, exist_ok=True)
        (net / name).symlink_to(folder / "net" / name)
        return folder

    def interrupt(self, number: int, action: str, affinity: str, priority: int | None = None, policy: int = 1) -> None:
        """Add an interrupt. If a priority is given, it has a thread with the process id 100 + number."""
        self.lines += f" {number}:          0         14          0          0  IR-PCI-MSI 65536-edge      {action}\n"
        (self.proc / "interrupts").write_text(HEAD + self.lines + "NMI:  0  0  0  0  Non-maskable interrupts\n")
        folder = self.proc / "irq" / str(number)
        folder.mkdir(parents=True)
        (folder / "smp_affinity_list").write_text(f"{affinity}\n")
        if priority is not None:
            process = self.proc / str(100 + number)
            process.mkdir()
            (process / "comm").write_text(f"irq/{number}-{action}\n")
            values = {"pid": 100 + number, "number": number, "name": action, "priority": priority, "policy": policy}
            (process / "stat").write_text(STAT.format(**values))

    def checks(self, channel: str = "can0", **settings: int) -> dict[str, Check]:
        found = can_interrupts(channel, RealtimeSettings(**settings), self.proc, self.sys)
        return {check.name: check for check in found}


@pytest.mark.parametrize(
    ("isolated", "cpu", "result", "fix"),
    [
        ("3", 3, Result.PASS, ""),
        ("2-3", 2, Result.PASS, ""),
        ("3", None, Result.WARN, "set [realtime] cpu = 3"),
        ("", 2, Result.WARN, "isolcpus=managed_irq,domain,2 nohz_full=2 rcu_nocbs=2"),
        ("", None, Result.WARN, "isolcpus=managed_irq,domain,3 "),
        ("3", 0, Result.WARN, "choose another processor than 0"),
    ],
)
def test_the_processor_of_the_loop_is_isolated(
    tmp_path: Path, isolated: str, cpu: int | None, result: Result, fix: str
) -> None:
    check = isolation(RealtimeSettings(cpu=cpu), Kernel(tmp_path, isolated).sys)
    assert (check.result, fix in check.fix) == (result, True)


def test_an_interrupt_of_its_own_is_found_by_the_name_of_the_interface(tmp_path: Path) -> None:
    kernel = Kernel(tmp_path)
    kernel.interface("platform/soc/fe204000.spi/spi_master/spi0/spi0.0")
    kernel.interrupt(55, "spi0.0", "0-2", 85)
    kernel.interrupt(56, "eth0", "0-3", 50)
    checks = kernel.checks(cpu=3)
    assert {check.result for check in checks.values()} == {Result.PASS}
    assert checks["CAN interrupt affinity"].found == "irq 55 on 0,1,2"
    assert checks["CAN interrupt thread"].found == "irq 55: priority 85"


def test_a_usb_adapter_is_served_by_its_host_controller(tmp_path: Path) -> None:
    kernel = Kernel(tmp_path)
    kernel.interface("pci0000:00/0000:00:14.0/usb1/1-2/1-2:1.0")
    host = kernel.sys / "devices/pci0000:00/0000:00:14.0"
    (host / "irq").write_text("126\n")
    for number in (127, 128):
        (host / "msi_irqs").mkdir(exist_ok=True)
        (host / "msi_irqs" / str(number)).write_text("msi\n")
    kernel.interrupt(127, "xhci_hcd", "0-3", 50)  # 128 is not in use
    checks = kernel.checks(cpu=3)
    affinity, thread = checks["CAN interrupt affinity"], checks["CAN interrupt thread"]
    assert (affinity.result, affinity.found) == (Result.WARN, "irq 127 on 0,1,2,3")
    assert affinity.fix.startswith("echo 0,1,2 > /proc/irq/127/smp_affinity_list")
    assert (thread.result, thread.fix) == (Result.WARN, "chrt -f -p 81 227")


@pytest.mark.parametrize(
    ("priority", "policy", "result"), [(80, 1, Result.WARN), (81, 1, Result.PASS), (0, 0, Result.WARN)]
)
def test_the_thread_is_above_the_loop(tmp_path: Path, priority: int, policy: int, result: Result) -> None:
    kernel = Kernel(tmp_path)
    (kernel.interface("pci0000:00/0000:01:00.0") / "irq").write_text("16\n")
    kernel.interrupt(16, "peak_pci", "0", priority, policy)
    assert kernel.checks(cpu=3)["CAN interrupt thread"].result is result


def test_a_kernel_without_interrupt_threads_has_no_priority_to_set(tmp_path: Path) -> None:
    kernel = Kernel(tmp_path, isolated="")
    (kernel.interface("pci0000:00/0000:01:00.0") / "irq").write_text("16\n")
    kernel.interrupt(16, "peak_pci", "0-3")
    checks = kernel.checks()
    assert {check.result for check in checks.values()} == {Result.PASS}
    assert "without a thread" in checks["CAN interrupt thread"].found


def test_a_virtual_interface_has_no_interrupt(tmp_path: Path) -> None:
    checks = Kernel(tmp_path).checks("vcan0")
    assert [check.result for check in checks.values()] == [Result.PASS]
