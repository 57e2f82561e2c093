"""Live page of `tsa status`: values and their recent past, latency, faults, and keys that change parameters."""

from __future__ import annotations

import contextlib
import itertools
import math
import os
import select
import shutil
import sys
import termios
import tty
from collections import defaultdict, deque
from collections.abc import Iterator
from typing import Any, TypeAlias

from rich.console import Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from tsa_ctrl.errors import UsageError
from tsa_ctrl.ipc.client import Client
from tsa_ctrl.ipc.parameters import of_unit
from tsa_ctrl.ipc.protocol import Set, Status
from tsa_ctrl.signals import GROUPS, Kind, Place, signals_of

PERIOD = 0.1  # s between two updates
HISTORY = 60  # values in a sparkline
STEP = 0.02  # share of a parameter's range per key press
DECADES = 1000.0  # ratio of its bounds from which a key press changes a parameter by `SHARE` of its value
SHARE = 0.1
BANDS = 72  # columns of a terminal with room for bands, and for parameters next to the values
WIDE = 100  # columns of a terminal with room for the recent past
STALE = 0.5  # s; an older status means that the loop is silent
VALUES = ("", "value", "unit")
PARAMETERS = ("parameter", "set to")
BARS = " ▁▂▃▄▅▆▇█"
SHOWN = sorted(  # torques first
    (
        signal
        for signal in signals_of(Place.STATUS)
        if signal.kind is Kind.VALUE
        and signal.unit != "s"
        and not signal.name.endswith(("_low", "_high"))
        and not signal.name.startswith(GROUPS)  # their long names leave no room in a narrow terminal
    ),
    key=lambda signal: signal.unit != "N*m",
)

Cell: TypeAlias = str | Text


class Page:
    """The received status, and the parameter that the keys change."""

    def __init__(self) -> None:
        self.message = ""
        self._status: dict[str, Any] = {}
        self._past: dict[tuple[str, str], deque[float]] = defaultdict(lambda: deque(maxlen=HISTORY))
        self._chosen = 0

    def take(self, status: dict[str, Any]) -> None:
        """Store a new answer of the daemon."""
        self._status = status
        for axis in status["axes"]:
            for signal in SHOWN:
                value = _value(axis[signal.name])
                self._past[axis["name"], signal.name].append(math.nan if value is None else value)

    def parameters(self) -> list[tuple[str, str, dict[str, Any]]]:
        """Return the axis, name and figures of every parameter that can be set."""
        return [
            (axis["name"], name, figures)
            for axis in self._status["axes"]
            for name, figures in axis["parameters"].items()
            if figures["low"] is not None
        ]

    def key(self, key: str) -> Set | None:
        """Return the request of a key, if any: j and k choose a parameter, + and - change it."""
        known = self.parameters()
        if key in "jk" and known:
            self._chosen = (self._chosen + (1 if key == "j" else -1)) % len(known)
        if key not in "+-" or not known:
            return None
        axis, name, figures = known[self._chosen]
        if figures["value"] is None:
            return None
        low, high, value = figures["low"], figures["high"], figures["value"]
        step = SHARE * value if 0.0 < low * DECADES <= high else STEP * (high - low)
        return Set(f"{axis}.{name}", min(max(value + (step if key == "+" else -step), low), high))

    def render(self) -> RenderableType:
        status = self._status
        cycles = status["cycles"]
        head = Text(f"{status['name']}: {status['phase']}", style="bold red" if status["faults"] else "bold green")
        head.append(
            f"   up {_number(status['uptime'], '.0f')} s, {cycles['cycles']} cycles, {cycles['skipped']} skipped, "
            f"{cycles['dropped']} frames dropped, {cycles['log_lost']} records lost",
            style="not bold default",
        )
        if cycles.get("log_silent"):
            head.append(f"   the log's process hangs, for {cycles['log_silent']:.1f} s", style="bold red")
        if status.get("monitor", "off") != "off":
            head.append(f"   monitor {status['monitor']}", "not bold default")
        if status.get("lease"):
            head.append("   set-points of process {process}, user {user}".format(**status["lease"]), "not bold default")
        if status["waiting_for"]:
            head.append(f"   since {status['waiting']:.1f} s: {status['waiting_for']}", style="bold yellow")
        elif status["age"] > STALE:
            head.append(f"   no news for {status['age']:.1f} s: the loop hangs or is gone", style="bold red")
        parts: list[RenderableType] = [head]  # a screen has 24 lines: the urgent ones first
        if status["faults"] and status["faults"][0].get("cure"):
            parts.append(Text(f"do: {status['faults'][0]['cure']}", style="bold red"))
        if self.message:
            parts.append(Text(self.message, style="yellow"))
        parts += [self._axis(axis) for axis in status["axes"]]
        parts.append(_times(status))
        parts += [Text(line, style="yellow") for line in status.get("loose_bounds", [])]
        for event in [*status["events"], *status["faults"]][-8:]:
            where = f"{event['axis']}: " if event["axis"] else ""
            parts.append(Text(f"{event['t']:.3f} s  {where}{event['text']}", style="red" if event["fault"] else ""))
        return Group(*parts)

    def _axis(self, axis: dict[str, Any]) -> RenderableType:
        """Return values next to parameters, or above them on a narrow terminal, so that no name is cut."""
        kind = f" ({axis['estimator'].partition(' (')[0]})" if axis.get("estimator") else ""
        title = (
            f"{axis['name']}: {axis['state'] or '-'}, limiter {axis['limit_reason'] or '-'}, "
            f"estimate {axis['estimate_state'] or '-'}{kind}"
        )
        columns = shutil.get_terminal_size().columns
        values, parameters = self._values(axis, columns), self._set(axis)
        if columns < BANDS:
            return Group(_table(title, VALUES, values), _table("", PARAMETERS, parameters))
        past = ("past",) if columns >= WIDE else ()
        empty = ("",) * (len(VALUES) + len(past))
        rows = itertools.zip_longest(values, parameters)
        beside = [(*(left or empty), *(right or ("", ""))) for left, right in rows]
        return _table(title, (*VALUES, *past, *PARAMETERS), beside)

    def _values(self, axis: dict[str, Any], columns: int) -> list[tuple[Cell, ...]]:
        found: list[tuple[Cell, ...]] = []
        for signal in SHOWN:
            name = signal.name
            value = _value(axis[name])
            shown = "-" if value is None else f"{value:.4f}{_half(axis[name]) if columns >= BANDS else ''}"
            past = (sparkline(self._past[axis["name"], name]),) if columns >= WIDE else ()
            found.append((name, shown, of_unit(signal.unit).strip(), *past))
        return found

    def _set(self, axis: dict[str, Any]) -> list[tuple[Cell, ...]]:
        known = self.parameters()
        chosen = known[self._chosen][:2] if known else ("", "")
        return [
            (
                Text(name, style="reverse" if (where, name) == chosen else ""),
                f"{_number(figures['value'], '.4g')}{of_unit(figures['unit'])}",
            )
            for where, name, figures in known
            if where == axis["name"]
        ]


def _table(title: str, headings: tuple[str, ...], rows: list[tuple[Cell, ...]]) -> Table:
    table = Table(title=title or None, title_justify="left")
    for heading in headings:
        table.add_column(heading, no_wrap=heading != "past")
    for row in rows:
        table.add_row(*row)
    return table


def _number(value: float | None, form: str) -> str:
    """Return a number as text, or "-" if it is unknown."""
    return "-" if value is None else format(value, form)


def _value(found: float | dict[str, Any] | None) -> float | None:
    """Return the value of a number with or without a band."""
    return found["value"] if isinstance(found, dict) else found


def _half(found: float | dict[str, Any] | None) -> str:
    """Return the half width of the band as text."""
    return f" ± {0.5 * (found['high'] - found['low']):.2g}" if isinstance(found, dict) else ""


def _times(status: dict[str, Any]) -> Table:
    """Return a table of latency and execution time: percentiles, and histograms as bars with logarithmic height."""
    edges = [edge for edge, _ in status["lateness"]["bins"] if edge is not None]
    table = Table("", "p50", "p99", "p99.9", f"up to {edges[0] * 1e6:g} us ... {edges[-1] * 1e6:g} us, above")
    for name in ("lateness", "work"):
        found = status[name]
        times = ("-" if found[p] is None else f"{found[p] * 1e6:.0f} us" for p in ("p50", "p99", "p999"))
        table.add_row(name, *times, sparkline(deque(math.log1p(number) for _, number in found["bins"])))
    return table


def sparkline(values: deque[float]) -> str:
    """Return the recent values as bars between their extremes."""
    finite = [value for value in values if math.isfinite(value)]
    if not finite:
        return ""
    low, high = min(finite), max(finite)
    span = (high - low) or 1.0
    return "".join(
        BARS[1 + round((value - low) / span * (len(BARS) - 2))] if math.isfinite(value) else " " for value in values
    )


def watch(client: Client) -> None:
    """Show the page until q or Ctrl-C; raise BusError if the daemon ends."""
    page = Page()
    page.take(client.ask(Status()))
    page.message = "j, k: choose a parameter   +, -: move it   q: leave"
    with contextlib.suppress(KeyboardInterrupt), _keys(), Live(page.render(), auto_refresh=False, screen=True) as live:
        while True:
            readable, _, _ = select.select([sys.stdin], [], [], PERIOD)
            if readable:
                key = os.read(sys.stdin.fileno(), 1).decode(errors="replace")
                if key in ("q", "\x03", ""):
                    return
                request = page.key(key)
                if request is not None:
                    try:
                        answer = client.ask(request)
                        now = f"{answer['value']:.4g}{of_unit(answer['unit'])}"
                        before = "-" if answer["before"] is None else f"{answer['before']:.4g}"
                        page.message = f"{answer['name']}: {before} -> {now}"
                    except UsageError as error:
                        page.message = str(error)
            page.take(client.ask(Status()))
            live.update(page.render(), refresh=True)


@contextlib.contextmanager
def _keys() -> Iterator[None]:
    """Receive single keys without return and without echo during the block."""
    before = termios.tcgetattr(sys.stdin)
    tty.setcbreak(sys.stdin)
    try:
        yield
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)
