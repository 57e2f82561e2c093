"""How long the model takes: prediction of a log, its growth with length, and the live feedforward per effect.

Usage: tools/run bench/model [--repeats 9]

The log is synthetic, 60 s at 1 kHz. Times are the best and the median of the repeats, after one run that is printed
apart (it loads the compiled loops). Aims: simplified model under 10 ms, heaviest stack under 300 ms.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable

import numpy as np

from tools import command
from tools.bench.effects import EFFECTS, STACK
from tools.bench.tendon_runs import make_axis, run
from tsa_ctrl.demo.rig import NOMINAL
from tsa_ctrl.model.catalogue import CATALOGUE
from tsa_ctrl.model.feedforward import Feedforward
from tsa_ctrl.model.parameters import TendonSheath, load_tendon_sheath
from tsa_ctrl.model.predict import predict
from tsa_ctrl.model.signals import Signals

PLANT_SECONDS = 3.0
PERIOD = 1e-3  # s
UPDATES = 4000  # of the feedforward, per effect


def example_log(seconds: float) -> Signals:
    t = np.arange(round(seconds / PERIOD), dtype=np.float64) * PERIOD
    q = 0.6 * np.sin(2 * np.pi * 0.7 * t) + 0.2 * np.sin(2 * np.pi * 1.9 * t)
    return Signals(
        t=t,
        tau_m=1.2 * np.sin(2 * np.pi * 0.3 * t),
        omega_j=np.gradient(q, t),
        q_j=q,
        q_m=1.25 * q,
        temperature=25.0 + 0.1 * t,
    )


def timed(run: Callable[[], object], repeats: int) -> tuple[float, float]:
    """Best and median time, s."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return min(times), statistics.median(times)


def prediction(model: TendonSheath, repeats: int) -> None:
    print(f"prediction of {60 / PERIOD:.0f} samples (60 s)   first run      best    median")
    log = example_log(60.0)
    stacks = {"simplified model": {}, f"heaviest stack ({len(STACK)} effects)": STACK}
    for title, effects in stacks.items():
        extended = model.with_effects(effects)
        first, _ = timed(lambda: predict(extended, log), 1)  # noqa: B023 - called at once
        best, median = timed(lambda: predict(extended, log), repeats)  # noqa: B023 - called at once
        print(f"  {title:36s} {1e3 * first:8.1f} ms {1e3 * best:6.2f} ms {1e3 * median:6.2f} ms")


def each_effect(model: TendonSheath, repeats: int) -> None:
    print("\neach effect alone: prediction of 60 s, and one live update")
    log = example_log(60.0)
    rows = live_rows(log)
    none = live_cost(model, rows)
    print(f"  {'none':36s} {1e3 * timed(lambda: predict(model, log), repeats)[0]:6.2f} ms {1e6 * none:7.2f} us")
    for name in CATALOGUE:
        extended = model.with_effects({name: EFFECTS[name]})
        best, _ = timed(lambda: predict(extended, log), repeats)  # noqa: B023 - called at once
        print(f"  {name:36s} {1e3 * best:6.2f} ms {1e6 * live_cost(extended, rows):7.2f} us")
    print(f"  {'heaviest stack':36s} {'':9s} {1e6 * live_cost(model.with_effects(STACK), rows):7.2f} us")


def growth(model: TendonSheath, repeats: int) -> None:
    print("\ngrowth with the log's length        simplified   heaviest stack")
    extended = model.with_effects(STACK)
    for seconds in (15, 30, 60, 120, 240):
        log = example_log(seconds)
        simple, _ = timed(lambda: predict(model, log), repeats)  # noqa: B023 - called at once
        heavy, _ = timed(lambda: predict(extended, log), repeats)  # noqa: B023 - called at once
        print(f"  {seconds:4d} s                            {1e3 * simple:8.2f} ms      {1e3 * heavy:8.2f} ms")


def live_rows(log: Signals) -> list[tuple[float, ...]]:
    desired = 0.6 * np.sin(2 * np.pi * 0.5 * log.t)
    columns = (desired, np.sign(log.omega_j), log.omega_j, log.q_j, log.q_m, log.temperature, log.t)
    rows = zip(*(np.asarray(column)[:UPDATES].tolist() for column in columns), strict=True)
    return [(*row[:6], math.nan, row[6]) for row in rows]


def live_cost(model: TendonSheath, rows: list[tuple[float, ...]]) -> float:
    """Seconds per update, best of three passes."""
    feedforward = Feedforward(model, PERIOD)

    def run() -> None:
        for row in rows:
            feedforward.update(*row)

    return timed(run, 3)[0] / len(rows)


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--repeats", type=int, default=9, help="timed runs of each (default 9)")
    repeats = parser.parse_args().repeats
    model = load_tendon_sheath(command.CONFIG / "actuator.toml")
    prediction(model, repeats)
    each_effect(model, max(3, repeats // 3))
    growth(model, max(3, repeats // 3))
    distributed_plant()
    return 0


def distributed_plant() -> None:
    """The distributed plant off the bus against real time (processor time), by elements and by axes."""
    print("\ndistributed plant off the bus, sub-step 0.1 ms: times faster than real time")
    for elements in (10, 20, 40, 80, 160):
        cost = run(make_axis(NOMINAL, "distributed", elements), PLANT_SECONDS).cost
        print(f"  1 axis, N = {elements:3d}   {1.0 / cost:6.1f}")
    for axes in (2, 4):
        cost = sum(run(make_axis(NOMINAL, "distributed"), PLANT_SECONDS).cost for _ in range(axes))
        print(f"  {axes} axes, N =  40  {1.0 / cost:6.1f}")
