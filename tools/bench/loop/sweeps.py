"""What a cycle costs by axes, by estimator and by effect, and where its time goes; used by tools/bench_cycle."""

from __future__ import annotations

import contextlib
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import tomlkit

from tools.bench.effects import EFFECTS, STACK
from tools.bench.loop import ways
from tools.bench.loop.blocks import Factory, measure, nodes
from tools.bench.loop.rig import controller_text
from tsa_ctrl.bus.wire.socketcan import SocketCan
from tsa_ctrl.config import Configuration, load_configuration
from tsa_ctrl.control.axis import ControlAxis
from tsa_ctrl.control.cycle import follow_up, run_cycle

AXES = (1, 2, 4, 8)
ANSWERS = "answers: nodes, bus, kernel"
ESTIMATORS = ("fixed", "map", "sensor", "motor", "stretch")
Table = list[dict[str, Any]]


def by_axes(interface: str, rounds: int, cycles: int) -> Table:
    """Floor and ours for each number of axes, each against its own responder.

    Lateness is the median over the blocks of a block's p99: the p99 of all is that of the machine's few stalls.
    """
    rows: Table = []
    for axes in AXES:
        with _configuration(interface, axes) as configuration, nodes(configuration):
            rate = configuration.file.controller.rate
            found = measure(
                {
                    "bare sleep": ways.bare_sleep,
                    "raw socket": partial(ways.raw_socket, configuration),
                    "ours": partial(ways.ours, configuration),
                },
                rate,
                rounds,
                cycles,
            )
        floor, ours = found["raw socket"]["cycle_p50"], found["ours"]["cycle_p50"]
        row = {"axes": axes, "rate": rate, "floor": floor, "ours": ours, "of floor": ours / floor}
        if rows:
            first = rows[0]
            more = axes - 1
            row["each more, floor"] = (floor - first["floor"]) / more
            row["each more, ours"] = (ours - first["ours"]) / more
        bare, late = (found[way]["lateness_p99_median"] for way in ("bare sleep", "ours"))
        row |= {"late p99, bare": bare, "late p99, ours": late, "ours to bare": late / bare}
        rows.append(row)
    return rows


def by_estimator(interface: str, rounds: int, cycles: int) -> Table:
    """The whole cycle (with what follows the RPDO) for every estimator; its estimate is used by the law."""
    with contextlib.ExitStack() as stack:
        table: dict[str, Factory] = {}
        for kind in ESTIMATORS:
            each = f'[axis.estimator]\nkind = "{kind}"\nuse = {"false" if kind == "fixed" else "true"}'
            if kind == "map":
                each += '\n[axis.bending]\nsource = "command"'
            configuration = stack.enter_context(_configuration(interface, 1, each))
            table[kind] = partial(_whole, configuration)
        stack.enter_context(nodes(configuration))
        return _against_first(measure(table, configuration.file.controller.rate, rounds, cycles), "estimator")


def by_effect(interface: str, rounds: int, cycles: int) -> Table:
    """The cycle, and the law alone in it, with the model extended by each effect, and by all that go together."""
    stacks: dict[str, dict[str, Any]] = {"none": {}}
    stacks.update({name: {name: values} for name, values in EFFECTS.items()})
    stacks[f"all {len(STACK)} that go together"] = STACK
    with contextlib.ExitStack() as stack:
        table: dict[str, Factory] = {}
        alone: dict[str, list[float]] = {name: [] for name in stacks}
        for name, effects in stacks.items():
            configuration = stack.enter_context(_configuration(interface, 1, effects=effects))
            table[name] = partial(ways.ours, configuration, prepare=_stamp_law(alone[name]))
        stack.enter_context(nodes(configuration))
        rows = _against_first(measure(table, configuration.file.controller.rate, rounds, cycles), "effect")
    for row in rows:
        row["law alone"] = statistics.median(alone[row["effect"]])
    return rows


def _stamp_law(spans: list[float]) -> Callable[[Sequence[ControlAxis]], None]:
    """Keep how long each update of the first axis' law takes, us."""

    def put(axes: Sequence[ControlAxis]) -> None:
        update = axes[0].law.update

        def stamped(*arguments: Any) -> Any:
            start = time.perf_counter()
            result = update(*arguments)
            spans.append(1e6 * (time.perf_counter() - start))
            return result

        axes[0].law.update = stamped  # type: ignore[method-assign, assignment]

    return put


def stages(interface: str, cycles: int) -> Table:
    """Where the time of a cycle goes: time stamps around its parts, the clock's own cost taken off; medians."""
    with _configuration(interface, 1) as configuration, nodes(configuration):
        return _stages(configuration, cycles)


def _stages(configuration: Configuration, cycles: int) -> Table:
    spans: dict[str, float] = {}
    calls: dict[str, int] = {}
    clock = time.perf_counter
    cost = statistics.median(-(clock() - clock()) for _ in range(1000))

    def timed(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def stamped(*arguments: Any) -> Any:
            start = clock()
            result = function(*arguments)
            spans[name] = spans.get(name, 0.0) + clock() - start - cost
            calls[name] = calls.get(name, 0) + 1
            return result

        return stamped

    found: dict[str, list[float]] = {}
    with ways.parts_of_ours(configuration) as (rig, axes, telemetry):
        rig.sync = timed("SYNC out", rig.sync)
        bus = rig.bus
        if isinstance(bus, SocketCan):
            bus.answers = timed(ANSWERS, bus.answers)  # type: ignore[method-assign]
            bus.recv = timed(ANSWERS, bus.recv)  # type: ignore[method-assign]
        rig.collect = timed("collect", rig.collect)
        for axis in axes:
            axis.supervisor.update = timed("supervisor", axis.supervisor.update)
            axis.law.update = timed("law", axis.law.update)
            axis.limiter.update = timed("limiter", axis.limiter.update)
            axis.io.command = timed("encode, RPDO out", axis.io.command)
        period = configuration.period
        collect = configuration.file.controller.collect * period
        deadline = time.monotonic()
        for count in range(cycles):
            deadline = max(deadline + period, time.monotonic())
            now = rig.wait(deadline)
            if count == 10:
                for axis in axes:
                    axis.enable()
            spans.clear()
            calls.clear()
            start = clock()
            run_cycle(rig, axes, now, now + collect)
            middle = clock()
            follow_up(rig, axes, now)
            after = clock()
            telemetry.record(count * period, count, 0.0, 0.0)
            end = clock()
            if count < cycles // 4 or not all(axis.image.fresh for axis in axes):
                continue
            inner = calls[ANSWERS]  # a stamp's second half lies outside of its span
            spans["decode, freshness"] = spans.pop("collect") - spans[ANSWERS] - inner * cost
            stamps = cost * (1 + sum(calls.values()))
            spans["the rest, and what the stamps cost"] = middle - start - sum(spans.values()) - stamps
            spans["after the RPDO: estimator, guard"] = after - middle - cost
            spans["after the RPDO: record"] = end - after - cost
            for name, span in spans.items():
                found.setdefault(name, []).append(1e6 * span)
    return [{"stage": name, "p50": statistics.median(values)} for name, values in found.items()]


@contextlib.contextmanager
def _configuration(
    interface: str, axes: int, each: str = "", effects: dict[str, Any] | None = None
) -> Iterator[Configuration]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "controller.toml"
        path.write_text(controller_text(folder, interface, axes, each=each), encoding="utf-8")
        actuator = Path(folder) / "actuator.toml"
        text = actuator.read_text("utf-8")
        if effects:
            document = tomlkit.parse(text)
            document["effects"] = effects
            text = tomlkit.dumps(document)
        actuator.write_text(text, encoding="utf-8")
        yield load_configuration(path)


@contextlib.contextmanager
def _whole(configuration: Configuration) -> Iterator[ways.Way]:
    """`ours` with what follows the RPDO inside the measured part."""
    with ways.ours(configuration) as way:

        def cycle(now: float) -> bool:
            complete = way.cycle(now)
            way.rest(now)
            return complete

        yield ways.Way(cycle, way.wait)


def _against_first(found: dict[str, dict[str, float]], title: str) -> Table:
    first = next(iter(found.values()))["cycle_p50"]
    return [
        {title: name, "cycle p50": row["cycle_p50"], "p99": row["cycle_p99"], "more": row["cycle_p50"] - first}
        for name, row in found.items()
    ]
