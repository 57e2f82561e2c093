"""Describe the supervisor's faults: the node, the counted errors, and the received values."""

from __future__ import annotations

from tsa_ctrl.bus.canopen import cia402
from tsa_ctrl.bus.canopen.cia402 import PowerState
from tsa_ctrl.bus.live.image import Image, NodeHealth

_LATE = 'if it shows its mode only when it is enabled, mode_shows = "enabled" in its profile'


def stale(image: Image) -> str:
    """Return the nodes without answers, and the late, repeated or malformed answers since startup."""
    silent = [health for health in image.nodes if health.misses]
    in_all = f"{image.misses} cycles in a row"
    words = "; ".join(_missing(health) for health in silent)
    if words and max(health.misses for health in silent) < image.misses:
        return f"{in_all} without all answers, at the end {words}"
    return words or in_all


def lossy(image: Image, cycles: int) -> str:
    """Return the lost answers by node, and the lost commands and periods, when single losses add up to a fault."""
    lost = [f"{health} {health.missed}" for health in image.nodes if health.missed]
    lost += [f"commands {image.dropped}"] if image.dropped else []
    lost += [f"skipped periods {image.skipped}"] if image.skipped else []
    return f"{cycles} cycles within a second lost answers or commands (since the start: {', '.join(lost)})"


def skipped(image: Image, begin: float, planned: int) -> str:
    """Return how many of the `planned` periods since `begin` (s) the loop skipped, and the remedy."""
    overruns = image.overruns
    return f"{overruns.skipped(begin)} of {planned} periods had no cycle: {overruns.remedy(begin, planned)}"


def silent(health: NodeHealth, now: float) -> str:
    """Return how long a node has sent no heartbeat, and how often its node guarding answers repeated a toggle bit."""
    stuck = f"; {health.untoggled} answers to node guarding repeated their toggle bit" if health.untoggled else ""
    return f"{health}: none for {1e3 * (now - health.heard):.0f} ms{stuck}"


def _missing(health: NodeHealth) -> str:
    counts = (("late", health.late), ("repeated", health.repeated), ("wrong length", health.malformed))
    instead = ", ".join(f"{name} {count}" for name, count in counts if count)
    return f"{health}: {health.misses} cycles in a row" + (f" (since the start {instead})" if instead else "")


def not_enabled(image: Image, waited: float, in_mode: bool, following: bool, shows_late: bool) -> str:
    """Return the state in which a drive stayed on its way to operation enabled after `waited` s."""
    state = cia402.decode(image.statusword)
    found = f"drive is in {state.value} after {waited:g} s"
    if not in_mode and (state is PowerState.OPERATION_ENABLED or not shows_late):
        late = "" if shows_late else f"; {_LATE}"
        return f"{found}, in mode {image.mode} instead of 10 (cyclic torque){late}"
    if state is PowerState.OPERATION_ENABLED and not following:
        return (
            f"{found}, and bit 12 of statusword 0x{image.statusword:04X} is low: it says that it does not follow "
            "the command; reports_following = false in its profile, if this drive has no such bit"
        )
    if state is PowerState.OPERATION_ENABLED:
        return f"{found}, without fresh PDOs"
    power = "" if image.statusword & cia402.VOLTAGE_ENABLED else ", without voltage (statusword bit 4 is low)"
    return f"{found}{power}"
