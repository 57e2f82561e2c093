"""Who is to blame for what did not come, in words."""

from __future__ import annotations

from tsa_ctrl.bus.live.image import Image, NodeHealth


def stale(image: Image) -> str:
    """Which node is to blame, and what came instead of its answers since the start."""
    silent = [health for health in image.nodes if health.misses]
    in_all = f"{image.misses} cycles in a row"
    words = "; ".join(_missing(health) for health in silent)
    if words and max(health.misses for health in silent) < image.misses:
        return f"{in_all} without all answers, at the end {words}"
    return words or in_all


def lossy(image: Image, cycles: int) -> str:
    """Whose answers were lost now and then, never enough of them in a row."""
    lost = [f"{health} {health.missed}" for health in image.nodes if health.missed]
    lost += [f"commands {image.dropped}"] if image.dropped else []
    return f"{cycles} cycles within a second lost answers or commands (since the start: {', '.join(lost)})"


def _missing(health: NodeHealth) -> str:
    counts = (("late", health.late), ("repeated", health.repeated), ("wrong length", health.malformed))
    instead = ", ".join(f"{name} {count}" for name, count in counts if count)
    return f"{health}: {health.misses} cycles in a row" + (f" (since the start {instead})" if instead else "")
