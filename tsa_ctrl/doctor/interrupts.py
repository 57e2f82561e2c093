"""Check on which processors the loop and the interrupts of the CAN interface run, and with which priority.

All values are read from /proc and /sys, which requires no rights. Both roots are arguments for tests.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from tsa_ctrl.doctor.can_interface import Check, Result, judge
from tsa_ctrl.system.realtime import RealtimeSettings

PROC, SYS = Path("/proc"), Path("/sys")
FIFO = 1  # scheduling policy, sched(7)
PRIORITY, POLICY = 37, 38  # fields of /proc/PID/stat after the name of the process, from 0: proc_pid_stat(5)
HIGHEST = 99  # of SCHED_FIFO


def isolation(settings: RealtimeSettings, sys: Path = SYS) -> Check:
    """Return the check that the loop has a processor on which the kernel schedules nothing else."""
    isolated = processors_of(text_of(sys / "devices/system/cpu/isolated"))
    present = processors_of(text_of(sys / "devices/system/cpu/present"))
    cpu = max(present, default=0) if settings.cpu is None else settings.cpu
    found = f"isolated: {spelled(isolated)}; [realtime] cpu = {'not set' if settings.cpu is None else settings.cpu}"
    if settings.cpu is None and isolated:
        fix = f"set [realtime] cpu = {min(isolated)}"
    else:
        fix = f"boot with isolcpus=managed_irq,domain,{cpu} nohz_full={cpu} rcu_nocbs={cpu}; set [realtime] cpu = {cpu}"
    if cpu == 0 and cpu not in isolated:
        fix = "choose another processor than 0, which handles the interrupts at boot; see [realtime] cpu"
    if len(present) < 2:
        fix = "use a machine with at least two processors"
    return judge("isolated processor", settings.cpu in isolated, found, "[realtime] cpu is isolated", fix)


def can_interrupts(channel: str, settings: RealtimeSettings, proc: Path = PROC, sys: Path = SYS) -> Iterator[Check]:
    """Yield the checks of affinity and priority of the interrupts that serve a SocketCAN interface."""
    affinity, thread = "CAN interrupt affinity", "CAN interrupt thread"
    numbers = interrupts_of(channel, proc, sys)
    if not numbers:
        yield Check(affinity, Result.PASS, f"{channel} has no interrupt", "not on the processor of the loop")
        return
    isolated = processors_of(text_of(sys / "devices/system/cpu/isolated"))
    present = processors_of(text_of(sys / "devices/system/cpu/present"))
    own = isolated if settings.cpu is None else {settings.cpu}
    others = present - own - isolated
    allowed = {number: affinity_of(number, proc) for number in numbers}
    found = "; ".join(f"irq {number} on {spelled(cpus)}" for number, cpus in allowed.items())
    wrong = [number for number, cpus in allowed.items() if cpus & own]
    moves = "; ".join(f"echo {spelled(others)} > /proc/irq/{number}/smp_affinity_list" for number in wrong)
    fix = f"{moves}; stop irqbalance, which moves it again" if others else "use a machine with more processors"
    yield judge(affinity, not wrong, found, f"not on {spelled(own)}" if own else "any: no processor is reserved", fix)
    threads = {number: threads_of(number, proc) for number in numbers}
    found = ", ".join(f"irq {number}: priority {each[1]}" for number, some in threads.items() for each in some)
    least = min(settings.priority + 1, HIGHEST)
    low = [process for some in threads.values() for process, priority in some if priority < least]
    fix = "; ".join(f"chrt -f -p {least} {process}" for process in low)
    yield judge(
        thread, not low, found or "none: the kernel handles it without a thread",
        f"SCHED_FIFO {least}: above the loop, which waits actively before each deadline", fix,
    )  # fmt: skip


def interrupts_of(channel: str, proc: Path, sys: Path) -> list[int]:
    """Return the numbers of the interrupts in use for a network interface.

    They have the name of the interface or of its device; otherwise they belong to the nearest parent device with
    interrupts: a USB adapter is served by the interrupts of its host controller.
    """
    link = sys / "class/net" / channel / "device"
    if not link.exists():
        return []
    device = link.resolve()
    actions = interrupt_actions(proc)
    named = [number for number, words in actions.items() if {channel, device.name} & set(words)]
    if named:
        return named
    for folder in (device, *device.parents):
        if folder == sys.resolve():
            break
        vectors = {int(path.name) for path in folder.glob("msi_irqs/[0-9]*")}
        line = text_of(folder / "irq")
        own = (vectors or ({int(line)} if line.isdigit() else set())) & set(actions)
        if own:
            return sorted(own)
    return []


def interrupt_actions(proc: Path) -> dict[int, list[str]]:
    """Return the words behind the counters of each numbered line of /proc/interrupts."""
    found = {}
    for line in text_of(proc / "interrupts").splitlines():
        number, colon, rest = line.partition(":")
        if colon and number.strip().isdigit():
            words = rest.replace(",", " ").split()
            found[int(number)] = [word for word in words if not word.isdigit()]
    return found


def affinity_of(number: int, proc: Path) -> set[int]:
    """Return the processors that may handle an interrupt; the kernel's choice where it reports one."""
    folder = proc / "irq" / str(number)
    return processors_of(text_of(folder / "effective_affinity_list") or text_of(folder / "smp_affinity_list"))


def threads_of(number: int, proc: Path) -> list[tuple[int, int]]:
    """Return process id and SCHED_FIFO priority of each thread of an interrupt; priority 0 under another policy."""
    found = []
    for folder in sorted(proc.glob("[0-9]*"), key=lambda path: int(path.name)):
        if text_of(folder / "comm").startswith(f"irq/{number}-"):
            fields = text_of(folder / "stat").rpartition(")")[2].split()
            fifo = int(fields[POLICY]) == FIFO
            found.append((int(folder.name), int(fields[PRIORITY]) if fifo else 0))
    return found


def processors_of(text: str) -> set[int]:
    """Return the processors of a list such as 0-2,5; the empty set for anything else."""
    found: set[int] = set()
    for part in text.split(","):
        first, _, last = part.partition("-")
        if first.strip().isdigit():
            found |= set(range(int(first), int(last or first) + 1))
    return found


def spelled(processors: set[int]) -> str:
    """Return processors as the kernel takes them, "none" for the empty set."""
    return ",".join(map(str, sorted(processors))) or "none"


def text_of(path: Path) -> str:
    """Return the text of a file of the kernel, empty if it cannot be read."""
    try:
        return path.read_text(encoding="ascii", errors="replace").strip()
    except OSError:
        return ""
