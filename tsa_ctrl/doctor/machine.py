"""Check kernel, processors, rights, governor and clock, measure the wake-up latency, and check CAN interrupts.

The checks include scheduling and memory-lock rights, and the processors and priorities of the loop and of the CAN
interface's interrupts. Values are read from /proc and /sys, which requires no privileges. Both roots are arguments for
tests.
"""

from __future__ import annotations

import multiprocessing
import os
import platform
import time
from collections.abc import Iterator
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.doctor.can_interface import Check, Result, judge
from tsa_ctrl.errors import BusError
from tsa_ctrl.system import realtime
from tsa_ctrl.system.process_supervisor import begin_worker, terminal_blocked
from tsa_ctrl.system.realtime import RealtimeSettings
from tsa_ctrl.system.sleep import sleep_until
from tsa_ctrl.version import build_kind

PROC, SYS = Path("/proc"), Path("/sys")
FIFO = 1  # scheduling policy, sched(7)
PRIORITY, POLICY = 37, 38  # fields of /proc/PID/stat after the name of the process, from 0: proc_pid_stat(5)
HIGHEST = 99  # highest priority of SCHED_FIFO


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

    An interrupt has the name of the interface or of its device. Otherwise it belongs to the nearest parent device with
    interrupts, because a USB adapter uses the interrupts of its host controller.
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
    """Return the words after the counters of each numbered line of /proc/interrupts, by number."""
    found = {}
    for line in text_of(proc / "interrupts").splitlines():
        number, colon, rest = line.partition(":")
        if colon and number.strip().isdigit():
            words = rest.replace(",", " ").split()
            found[int(number)] = [word for word in words if not word.isdigit()]
    return found


def affinity_of(number: int, proc: Path) -> set[int]:
    """Return the processors that may handle an interrupt, or the kernel's choice if it reports one."""
    folder = proc / "irq" / str(number)
    return processors_of(text_of(folder / "effective_affinity_list") or text_of(folder / "smp_affinity_list"))


def threads_of(number: int, proc: Path) -> list[tuple[int, int]]:
    """Return process id and SCHED_FIFO priority of each thread of an interrupt; priority 0 means another policy."""
    found = []
    for folder in sorted(proc.glob("[0-9]*"), key=lambda path: int(path.name)):
        if text_of(folder / "comm").startswith(f"irq/{number}-"):
            fields = text_of(folder / "stat").rpartition(")")[2].split()
            fifo = int(fields[POLICY]) == FIFO
            found.append((int(folder.name), int(fields[PRIORITY]) if fifo else 0))
    return found


def processors_of(text: str) -> set[int]:
    """Return the processors of a list such as 0-2,5, or an empty set for any other text."""
    found: set[int] = set()
    for part in text.split(","):
        first, _, last = part.partition("-")
        if first.strip().isdigit():
            found |= set(range(int(first), int(last or first) + 1))
    return found


def spelled(processors: set[int]) -> str:
    """Return processors in the kernel's list format, or "none" for an empty set."""
    return ",".join(map(str, sorted(processors))) or "none"


def text_of(path: Path) -> str:
    """Return the text of a file of the kernel, empty if it cannot be read."""
    try:
        return path.read_text(encoding="ascii", errors="replace").strip()
    except OSError:
        return ""


GOOD_CLOCKS = ("tsc", "arch_sys_counter", "kvm-clock", "hyperv_clocksource_tsc_page")
REALTIME = Path("/sys/kernel/realtime")
CPUS = Path("/sys/devices/system/cpu")
CLOCKS = Path("/sys/devices/system/clocksource/clocksource0")


def checks(settings: RealtimeSettings, rate: float, seconds: float) -> Iterator[Check]:
    """Yield all checks of the machine. The last sleeps at `rate` Hz for `seconds` s with the rights of `settings`."""
    yield build()
    yield kernel()
    yield processors()
    yield isolation(settings)
    yield governor()
    yield clock_source()
    yield throttling()
    yield from _rights_and_lateness(settings, rate, *_in_a_process(settings, rate, seconds))


def build() -> Check:
    """Report which build of this package runs. Both are correct; the compiled one needs less time per cycle."""
    return Check("build", Result.PASS, build_kind(), "interpreted or compiled")


def kernel() -> Check:
    """Return the check of the kernel's preemption model."""
    version = platform.version()
    realtime_kernel = text_of(REALTIME) == "1" or "PREEMPT_RT" in version
    model = "PREEMPT_RT" if realtime_kernel else "PREEMPT" if "PREEMPT" in version else "no full preemption"
    return judge(
        "kernel",
        realtime_kernel,
        f"{platform.system()} {platform.release()}, {model}",
        "PREEMPT_RT",
        "install the distribution's real-time kernel (Debian: apt install linux-image-rt-amd64)",
    )


def processors() -> Check:
    """Return the check of the number of processors."""
    count = os.cpu_count() or 1
    return judge(
        "processors",
        count >= 2,
        f"{count}",
        "at least 2",
        "use a machine with at least two processors: one for the loop, one for the rest",
    )


def governor() -> Check:
    """Return the check of the frequency governor. A processor that must first increase its frequency wakes up late."""
    found = sorted({text_of(path) for path in CPUS.glob("cpu[0-9]*/cpufreq/scaling_governor")})
    return judge(
        "governor",
        found in ([], ["performance"]),
        ", ".join(found) or "none (fixed frequency)",
        "performance",
        "cpupower frequency-set -g performance",
    )


def clock_source() -> Check:
    """Return the check of the clock: each reading takes a microsecond or more unless it is a processor counter."""
    found = text_of(CLOCKS / "current_clocksource") or "unknown"
    available = text_of(CLOCKS / "available_clocksource")
    better = next((name for name in GOOD_CLOCKS if name in available.split()), None)
    return judge(
        "clock source",
        found in GOOD_CLOCKS,
        found,
        " or ".join(GOOD_CLOCKS[:2]),
        f"echo {better} > {CLOCKS / 'current_clocksource'}" if better else f"this machine offers only: {available}",
    )


def throttling() -> Check:
    """Return the check of the share of time that the kernel grants to real-time tasks."""
    found = text_of(Path("/proc/sys/kernel/sched_rt_runtime_us"))
    share = (
        1.0 if found in ("-1", "") else int(found) / int(text_of(Path("/proc/sys/kernel/sched_rt_period_us")) or 1e6)
    )
    return judge(
        "real-time throttling",
        share >= 0.9,
        f"{100 * share:.0f} % of each period" if found else "unknown",
        "at least 90 %",
        "sysctl kernel.sched_rt_runtime_us=950000",
    )


Measured = tuple[bool, int, int, tuple[str, ...], NDArray[np.float64]]  # as `_measure` sends them


def _in_a_process(settings: RealtimeSettings, rate: float, seconds: float) -> Measured:
    """Acquire the rights and measure the latency in a separate process, so that this process keeps its own rights."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_measure, args=(theirs, settings, rate, seconds), daemon=True)
    resource_tracker.ensure_running()  # before the signals are blocked, because its start would unblock them
    with terminal_blocked():
        process.start()
    theirs.close()
    try:
        found: Measured = ours.recv()
        return found
    except EOFError:
        raise BusError("doctor: the measuring process ended; see the system's log (dmesg)") from None
    except BaseException:
        process.terminate()
        raise
    finally:
        process.join()


def _rights_and_lateness(
    settings: RealtimeSettings,
    rate: float,
    fifo: bool,
    priority: int,
    locked: int,
    missing: tuple[str, ...],
    late: NDArray[np.float64],
) -> Iterator[Check]:
    """Yield the checks of scheduling, memory lock and wake-up latency `late` (s)."""
    wanted = Result.WARN if settings.allow_without else Result.FAIL
    yield judge(
        "scheduling",
        fifo and priority == settings.priority,
        f"SCHED_FIFO {priority}" if fifo else "SCHED_OTHER: real-time scheduling is rejected",
        f"SCHED_FIFO {settings.priority}",
        _first(missing, "SCHED_FIFO") or "give the user an rtprio limit: '@realtime - rtprio 95' in limits.conf",
        wanted,
    )
    yield judge(
        "memory lock",
        not settings.lock_memory or locked > 0,
        f"{locked / 2**20:.0f} MiB locked",
        "all memory locked",
        _first(missing, "memory") or "give the user memlock unlimited: '@realtime - memlock unlimited' in limits.conf",
        wanted,
    )
    p50, p99, worst = (float(v) for v in np.quantile(late, [0.5, 0.99, 1.0]) * 1e6)
    period = 1e6 / rate
    yield judge(
        "lateness",
        worst < 0.3 * period,
        f"p50 {p50:.0f}, p99 {p99:.0f}, worst {worst:.0f} us in {len(late)} cycles at {rate:g} Hz",
        f"worst below {0.3 * period:.0f} us (30 % of the period)",
        "fix the lines above, stop other load, or lower [controller] rate",
        Result.FAIL if p99 > 0.3 * period else Result.WARN,
    )


def _measure(pipe: Connection, settings: RealtimeSettings, rate: float, seconds: float) -> None:
    """Sleep to absolute deadlines at the loop's rate, and send the rights and the latency (s) of each wake-up."""
    begin_worker()
    rights = realtime.acquire(msgspec.structs.replace(settings, allow_without=True))
    period = round(1e9 / rate)
    late = np.zeros(max(1, round(seconds * rate)))
    deadline = time.monotonic_ns() + period
    for i in range(late.size):
        sleep_until(deadline)
        now = time.monotonic_ns()
        late[i] = (now - deadline) * 1e-9
        deadline += period * max(1, -(-(now - deadline) // period))
    pipe.send((rights.fifo, rights.priority, rights.locked_bytes, rights.missing, late))


def _first(lines: tuple[str, ...], word: str) -> str:
    return next((line for line in lines if line.startswith(word)), "")
