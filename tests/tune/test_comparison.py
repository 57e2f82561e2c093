"""Comparison of two parameter sets: order of the blocks, interval, verdict."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest

from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.ipc import protocol
from tsa_ctrl.ipc.client import Client
from tsa_ctrl.tune.comparison import LiveBlocks, alternate, compare, order


def blocks(a: float, b: float, noise: float, pairs: int, seed: int) -> list[tuple[str, float]]:
    rng = np.random.default_rng(seed)
    level = {"a": a, "b": b}
    return [(name, level[name] + noise * float(rng.normal())) for name in order(2 * pairs)]


@pytest.mark.parametrize(("a", "b", "better"), [(0.05, 0.08, "a"), (0.08, 0.05, "b"), (0.05, 0.05, None)])
def test_the_better_set_is_named_only_when_the_interval_says_so(a: float, b: float, better: str | None) -> None:
    found = compare(blocks(a, b, 0.005, 6, 1)).to_dict()
    assert found["better"] == better
    assert found["difference"]["low"] < found["difference"]["value"] < found["difference"]["high"]


def test_the_interval_covers_the_true_difference() -> None:
    """With a coverage of 95 %, fewer than 360 hits of 400 have a probability below 1 in 10,000."""
    hits = 0
    for seed in range(400):
        found = compare(blocks(0.05, 0.06, 0.01, 6, seed)).difference
        hits += found.low <= 0.01 <= found.high
    assert 360 <= hits <= 396


def test_a_linear_drift_is_no_difference() -> None:
    assert order(8) == ("a", "b", "b", "a", "a", "b", "b", "a")
    errors = [(name, 0.05 + 0.01 * n) for n, name in enumerate(order(16))]
    found = compare(errors)
    assert found.difference.value == pytest.approx(0.0, abs=1e-12)
    assert "no difference found" in found.verdict


@pytest.mark.parametrize("count", [1, 6])
def test_every_block_is_applied_measured_and_told(count: int) -> None:
    """Too few blocks become three pairs."""
    done: list[str] = []
    values = iter(0.05 + 0.001 * n for n in range(100))
    found = alternate(
        count, done.append, lambda: next(values), lambda number, name, error: done.append(f"{number}{name}")
    )
    assert done == ["a", "0a", "b", "1b", "b", "2b", "a", "3a", "a", "4a", "b", "5b"]
    assert found.pairs == 3


class Daemon:
    """A daemon that rejects each value of `rejected`."""

    def __init__(self, **values: float) -> None:
        self.values = values
        self.rejected: set[float] = set()

    def ask(self, request: Any) -> dict[str, Any]:
        if isinstance(request, protocol.Status):
            return {"axes": [{"name": "knee", "parameters": {n: {"value": v} for n, v in self.values.items()}}]}
        if request.value in self.rejected:
            raise UsageError("it can only be lowered")
        before, self.values[request.name] = self.values[request.name], request.value
        return {"axis": "knee", "before": before}


def test_a_value_that_cannot_be_restored_leaves_no_other_one_changed() -> None:
    daemon = Daemon(first=1.0, second=2.0, third=3.0)
    blocks = LiveBlocks(cast(Client, daemon), {"a": {"first": 5.0, "second": 6.0, "third": 7.0}, "b": {}}, 1.0)
    blocks.apply("a")
    daemon.rejected = {2.0}
    with pytest.raises(BusError, match=r"repeat `tsa set second 2` \(it can only be lowered\)$"):
        blocks.restore()
    assert daemon.values == {"first": 1.0, "second": 6.0, "third": 3.0}
