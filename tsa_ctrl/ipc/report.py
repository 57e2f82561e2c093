"""The daemon's status as one JSON object, from the mailbox' snapshot: no NaN, null for unknown."""

from __future__ import annotations

import math
from typing import Any

import msgspec

from tsa_ctrl.ipc.mailbox import AXIS, COUNTS, GENERAL, Mailbox
from tsa_ctrl.ipc.protocol import Description
from tsa_ctrl.system.histogram import coarse, distribution

SCHEMA = 1


def status_report(mailbox: Mailbox, description: Description, now: float) -> dict[str, Any]:
    """What `tsa status --json` prints; `now` in s, monotonic."""
    general, axes = mailbox.status()
    values = dict(zip(GENERAL, general, strict=True))
    _, text = mailbox.text()
    events = msgspec.json.decode(text) if text else []
    report: dict[str, Any] = {
        "schema": SCHEMA,
        "name": description.name,
        "phase": description.phases[int(values["phase"])],
        "age": max(0.0, now - values["time"]),
        "uptime": values["time"] - values["start"],
        "axes": [_axis(description, index, row) for index, row in enumerate(axes)],
        "faults": [event for event in events if event["fault"]],
        "events": [event for event in events if not event["fault"]],
        "cycles": {
            "period": description.period,
            **{name: int(values[name]) for name in ("planned", "cycles", "skipped", "overruns", "dropped", "log_lost")},
        },
        "lateness": _histogram(mailbox.lateness),
        "work": _histogram(mailbox.work),
        "figures": description.figures,
    }
    return report


def _axis(description: Description, index: int, row: tuple[float, ...]) -> dict[str, Any]:
    values: dict[str, Any] = {name: _known(value) for name, value in zip(AXIS, row, strict=False)}
    values["state"] = description.states[int(row[AXIS.index("state")])]
    values["estimate_state"] = description.estimate_states[int(row[AXIS.index("estimate_state")])]
    values["limit_reason"] = description.reasons[int(row[AXIS.index("limit_reason")])]
    values |= {name: int(row[AXIS.index(name)]) for name in COUNTS}
    live = zip(description.parameters[index], row[len(AXIS) :], strict=True)
    parameters = {
        known.name: {"value": _known(value), "low": known.low, "high": known.high, "unit": known.unit}
        for known, value in live
    }
    return {"name": description.axes[index], **values, "parameters": parameters}


def _histogram(bins: memoryview) -> dict[str, Any]:
    found = distribution(bins)
    return {
        "samples": found.samples,
        "p50": _known(found.p50),
        "p99": _known(found.p99),
        "p999": _known(found.p999),
        "bins": [[_known(edge), samples] for edge, samples in coarse(bins)],
    }


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None
