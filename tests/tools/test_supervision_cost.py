"""bench/supervision: every part is seen, what is inside another is not counted twice, and nothing stays stamped."""

from __future__ import annotations

import pytest

from tools.bench.supervision import PARTS, Stamps, measured
from tsa_ctrl.daemon import loop


def test_what_a_part_calls_of_another_counts_there_alone() -> None:
    stamps = Stamps()

    def busy(count: int) -> int:
        return sum(range(count))

    inner = stamps.timed("inner", busy)
    outer = stamps.timed("outer", lambda: inner(300_000))
    stamps.cycle(outer)()
    stamps.cycle(lambda: None)()
    (first, second) = stamps.rows
    assert first["inner"] > 50.0 * abs(first["outer"])
    assert "inner" not in second


@pytest.mark.slow
def test_every_part_of_the_loop_is_seen_and_left_as_it_was() -> None:
    before = {(owner, name): getattr(owner, name) for places in PARTS.values() for owner, name in places}
    begun = vars(loop)["run_cycle"]
    found, cycles = measured(0.3, 1000.0, "held")
    assert cycles > 250
    assert set(found) == {*PARTS, "the rest"} - {"bus and plant"}
    assert all(value > 0.0 for value in found.values())
    assert vars(loop)["run_cycle"] is begun
    assert {(owner, name): getattr(owner, name) for owner, name in before} == before
