"""A run in virtual time in place of the processes plant and daemon: the same files in a folder, the same summary."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from tsa_ctrl.errors import BusError
from tsa_ctrl.virtual.simulation import simulate_loop


def play(
    folder: Path, name: str, seconds: float, tick: Callable[[float], None], plant: Path | None = None
) -> dict[str, Any]:
    """Run `controller-NAME.toml` in `folder` on `plant` (default: its `plant.toml`); the log is in a folder NAME.

    Returns the summary that `tsa run --json` prints.

    Raises:
        BusError: the run failed, as in `system.process_supervisor.daemon`.
    """
    plant = folder / "plant.toml" if plant is None else plant
    result = simulate_loop(folder / f"controller-{name}.toml", plant, seconds, out=folder / name, tick=tick)
    if result.summary.failed:
        raise BusError(f"the run '{name}' failed: {result.summary.cause}")
    return result.summary.as_dict()
