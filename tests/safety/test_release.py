"""The budget of releases: for any requests, at most one within 2 s and at most ten within ten minutes."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from tsa_ctrl.safety.release import MOST, REST, WINDOW, ReleaseBudget

STEPS = st.lists(st.sampled_from((0.0, 0.5, REST, 30.0, 100.0, WINDOW)) | st.floats(0.0, 100.0), max_size=60)


@given(steps=STEPS)
def test_the_budget_permits_a_release_whenever_its_limits_do(steps: list[float]) -> None:
    budget, now, taken = ReleaseBudget(), 0.0, list[float]()
    for step in steps:
        now += step
        recent = [time for time in taken if now < time + WINDOW]
        permitted = len(recent) < MOST and all(now >= time + REST for time in taken)
        assert budget.take(now) is permitted
        if permitted:
            taken.append(now)
