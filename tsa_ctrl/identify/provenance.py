"""Create the `[provenance]` table of a model file, which states the source of its numbers."""

from __future__ import annotations

import datetime
from collections.abc import Mapping, Sequence
from pathlib import Path

from tsa_ctrl import settings
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.model.provenance import NodeIdentity, Origin, nodes_table, origin_of
from tsa_ctrl.version import __version__


def provenance(
    command: str,
    logs: Sequence[Dataset] | Mapping[str, str],
    nominal: str | Path,
    found: Mapping[str, Quantity],
    origin: Origin | None = None,
    **more: object,
) -> dict[str, object]:
    """Return the provenance for `save_model` as plain values.

    The table states command, date, version, nominal file, logs with their hashes, and intervals.

    Args:
        command: name of the command that wrote the file.
        nominal: nominal model file.
        logs: datasets, or hash by name.
        found: quantities whose 95 % intervals are kept as [low, high] in SI units.
        origin: the measured joint. Without it, the source is logs, which may be of any joint, or simulated if one of
            them is the log of a virtual run. The joint of the nominal file is kept.
        more: further entries of the table.
    """
    if origin is None:
        simulated = not isinstance(logs, Mapping) and any(log.simulated for log in logs)
        origin = Origin("simulated" if simulated else "logs", _nodes_of(Path(nominal)))
    return {
        "command": command,
        **({"source": origin.source} if origin.source else {}),
        "date": datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "version": __version__,
        "nominal": Path(nominal).name,
        "logs": dict(logs) if isinstance(logs, Mapping) else _hashes(logs),
        **more,
        "intervals": {name: [_digits(quantity.low), _digits(quantity.high)] for name, quantity in found.items()},
        **nodes_table(origin.nodes),
    }


def _nodes_of(nominal: Path) -> Mapping[str, NodeIdentity]:
    """Return the nodes that a model file belongs to; empty if the file does not exist."""
    if not nominal.is_file():
        return {}
    return origin_of(settings.read_toml(nominal).get("provenance", {}), str(nominal)).nodes


def _digits(end: float) -> float:
    """Return the end of an interval, rounded to five digits."""
    return float(f"{end:.5g}")


def _hashes(logs: Sequence[Dataset]) -> dict[str, str]:
    names = [log.name for log in logs]
    return {log.name if names.count(log.name) == 1 else log.label: log.sha256 for log in logs}
