"""Report the status as one JSON object (null for an unknown value), and print events as they occur."""

from __future__ import annotations

import contextlib
import math
import os
import queue
import sys
import threading
import time
from collections.abc import Sequence
from typing import Any

import msgspec

from tsa_ctrl.ipc.mailbox import Mailbox, Parameters
from tsa_ctrl.ipc.protocol import Description
from tsa_ctrl.signals import BANDED, GROUPS, SIGNALS, Kind, Place, Signal, signals_of
from tsa_ctrl.system.histogram import coarse, distribution

SCHEMA = 1
KNOWN = 1.0  # s; an older value is unknown, because its node or the loop is silent
MONITOR = ("off", "watching", "stopped", "failed")  # by code: daemon.monitoring.MonitorState


def waits_for(mailbox: Mailbox, now: float) -> tuple[float, str]:
    """Return the start (s) and the name of the stage that the loop waits for; the name is empty while the loop runs."""
    since, stage = mailbox.stage()
    if not stage and mailbox.status()[0].time == 0.0:  # nothing was published yet: the loop is not late
        return now, "the first cycle"
    return since, stage


def status_report(
    mailbox: Mailbox, description: Description, now: float, lease: dict[str, Any] | None = None
) -> dict[str, Any]:
    """Return the object of `tsa status --json`; `now` is monotonic, s; `lease` is the holder of the set-point."""
    general, axes = mailbox.status()
    _, text = mailbox.text()
    since, stage = waits_for(mailbox, now)
    events = msgspec.json.decode(text) if text else []
    for event in events:
        if event["fault"]:
            event["cure"] = description.remedies.get(event.get("cause_id", ""))
    present = [event for event in events if event["fault"] and event["number"] >= general.first_fault]
    begun = general.time > 0.0
    age = max(0.0, now - general.time) if begun else math.inf
    return {
        "schema": SCHEMA,
        "name": description.name,
        "phase": description.phases[int(general.phase)],
        "age": max(0.0, now - max(general.time, now if stage else 0.0)),
        "uptime": general.time - general.start if begun else None,
        "waiting_for": stage or None,
        "waiting": max(0.0, now - since) if stage else None,
        "axes": [_axis(description, index, *axis, age) for index, axis in enumerate(axes)],
        "faults": present,
        "events": [event for event in events if event not in present],
        "recovery": {
            "requests": int(general.releases),
            "done": int(general.recovered),
            "failed": int(general.failed),
            "wait": max(0.0, general.release_next - now),
        },
        "cycles": {
            "period": description.period,
            "planned": int(general.planned),
            "cycles": int(general.cycles),
            "skipped": int(general.skipped),
            "overruns": int(general.overruns),
            "dropped": int(general.dropped),
            "log_lost": int(general.log_lost),
            "log_silent": general.log_silent or None,
        },
        "monitor": MONITOR[int(general.monitor)],
        "lateness": _histogram(mailbox.lateness),
        "work": _histogram(mailbox.work),
        "figures": description.figures,
        "loose_bounds": description.loose_bounds,
        "lease": lease,
    }


def measurement(mailbox: Mailbox, description: Description, now: float, clamped: Sequence[bool]) -> dict[str, Any]:
    """Return the measurements of the newest cycle, and the range of each axis' set-point.

    `now` in s, monotonic; `clamped`: per axis, True if the newest set-point was beyond its range.
    """
    time, cycle, phase, axes = mailbox.measured()
    return {
        "time": time,
        "age": max(0.0, now - time) if cycle else None,
        "cycle": cycle,
        "phase": description.phases[phase],
        "axes": [
            {"name": name}
            | {key: _told(SIGNALS[key], value, description) for key, value in axis._asdict().items()}
            | {"set_point_limit": limit, "clamped": flag}
            for name, axis, limit, flag in zip(
                description.axes, axes, description.set_point_limit, clamped, strict=True
            )
        ],
    }


def events_since(mailbox: Mailbox, number: int) -> list[dict[str, Any]]:
    """Return the stored events from this number on."""
    _, text = mailbox.text()
    return [event for event in (msgspec.json.decode(text) if text else []) if event["number"] >= number]


def _axis(description: Description, index: int, axis: Any, live: Parameters, age: float) -> dict[str, Any]:
    """Return the status of one axis (`AxisStatus`), with None for each unknown value; `age` of the values in s."""
    values: dict[str, Any] = {}
    ages: dict[str, float | None] = {}
    for signal, value in zip(signals_of(Place.STATUS), axis, strict=True):
        if signal.kind is Kind.AGE:
            continue
        own = age + max((getattr(axis, source) for source in signal.ages), default=0.0)
        is_known = own < math.inf if signal.kind is Kind.COUNT else own <= KNOWN
        values[signal.name] = _told(signal, value, description) if is_known else None
        ages[signal.name] = _finite(own)
    for name in BANDED:
        ends = {end: values.pop(f"{name}_{end}") for end in ("low", "high")}
        values[name] = None if values[name] is None else {"value": values[name], **ends, "unit": SIGNALS[name].unit}
    values["ages"] = {name: ages[name] for name in values}
    for group in GROUPS:
        members = {name: value for name, value in values.items() if name.startswith(f"{group}_")}
        values[group] = {name.removeprefix(f"{group}_"): value for name, value in members.items()}
    values["estimator"] = description.estimators[index] if description.estimators else None
    parameters = {
        each.name: {
            "value": _finite(value) if age < math.inf else None,
            "low": each.low,
            "high": each.high,
            "unit": each.unit,
            "doc": each.doc,
            "switch": each.switch,
        }
        for each, value in zip(description.parameters[index], live, strict=True)
    }
    limit = description.set_point_limit[index]
    return {"name": description.axes[index], **values, "set_point_limit": limit, "parameters": parameters}


def _told(signal: Signal, value: float, description: Description) -> float | str | bool | None:
    """Return a value as in the JSON: a code by its name, None for a value that is not finite."""
    if not math.isfinite(value):
        return None
    match signal.kind:
        case Kind.CODE:
            return description.codes[signal.name][int(value)]
        case Kind.FLAG:
            return bool(value)
        case Kind.COUNT:
            return int(value)
    return value


def _histogram(bins: memoryview) -> dict[str, Any]:
    found = distribution(bins)
    return {
        "samples": found.samples,
        "p50": _finite(found.p50),
        "p99": _finite(found.p99),
        "p999": _finite(found.p999),
        "bins": [[_finite(edge), samples] for edge, samples in coarse(bins)],
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


WAITING = 256  # lines that wait for a stopped terminal; further lines are not printed, but the log has them


class EventPrinter:
    """Print events on stderr in a thread, so that a stopped terminal (Ctrl-S, a pager) delays no other process.

    The thread ends with the process, even if it hangs in a write.
    """

    def __init__(self, mailbox: Mailbox) -> None:
        """Begin after the last event that an earlier process has printed."""
        self._mailbox = mailbox
        self._lines: queue.Queue[tuple[int, str]] = queue.Queue(WAITING)
        self._sequence, self._last = 0, mailbox.printed
        threading.Thread(target=self._write, daemon=True).start()

    def update(self) -> None:
        """Print new events."""
        sequence, text = self._mailbox.text()
        if sequence == self._sequence:
            return
        self._sequence = sequence
        for event in msgspec.json.decode(text):
            if event["number"] > self._last:
                self._last = event["number"]
                where = f"{event['axis']}: " if event["axis"] else ""
                with contextlib.suppress(queue.Full):
                    self._lines.put_nowait((self._last, f"{event['t']:.3f} s: {where}{event['text']}\n"))

    def finish(self, seconds: float) -> None:
        """Wait up to `seconds` s until the last events are written."""
        end = time.monotonic() + seconds
        while self._lines.unfinished_tasks and time.monotonic() < end:
            time.sleep(0.005)

    def _write(self) -> None:
        while True:
            number, line = self._lines.get()
            data = line.encode(errors="replace")
            with contextlib.suppress(OSError):  # unbuffered: the end of the interpreter would wait for a buffer
                while data:
                    data = data[os.write(sys.stderr.fileno(), data) :]
            with contextlib.suppress(ValueError):  # the mailbox is closed
                self._mailbox.print_up_to(number)
            self._lines.task_done()
