"""A fleet of logs: one rig with one wrong model file, and in each log another hidden effect, or none."""

from __future__ import annotations

from collections.abc import Iterator

from .bench import Recipe, draw_bench
from .cases import Case, generator, none_case, single_case
from .rig import model_file

# What shows on any rig; others need a rig of their own kind, or a bending that varies.
HIDDEN = (
    "viscous_friction",
    "stribeck_friction",
    "torque_offset",
    "torque_ripple",
    "gravity_load",
    "direction_asymmetric_friction",
    "transport_delay",
    "presliding_hysteresis",
    "thermal_friction_drift",
)
WITHOUT = 3  # of ten logs have no effect


def fleet(count: int, seed: int) -> tuple[str, Iterator[Case]]:
    """The text of the model file that all have, and `count` cases of its rig."""
    first = draw_bench(generator("fleet", "rig", seed), Recipe(short=True, x=(0.25, 0.6)))

    def cases() -> Iterator[Case]:
        for number in range(count):
            if number % 10 < WITHOUT:
                yield none_case("rich", 1000 * seed + number, True, first)
            else:
                yield single_case(HIDDEN[number % len(HIDDEN)], 1000 * seed + number, True, first)

    return model_file(first.nominal, state_uncertainty=False), cases()
