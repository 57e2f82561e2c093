"""Every variation of a drive completes the whole sequence in virtual time, or is rejected with its remedy."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from tests.drives.matrix import run_trial
from tests.drives.variations import VARIATIONS, Variation
from tsa_ctrl.plant.settings import Quirks

LONG = (  # variations that take long
    "answers SDO after 0.4 s",  # the variation with 0.7 s always runs
    "steps of 1.5 s, more patience",  # "steps of 1.5 s" requires that this remedy is reported
    "boots after 3.5 s, and the profile says so",
)


@pytest.mark.slow
@pytest.mark.parametrize(
    "variation",
    [pytest.param(each, marks=[pytest.mark.soak] if each.name in LONG else [], id=each.name) for each in VARIATIONS],
)
def test_variation(tmp_path: Path, variation: Variation) -> None:
    outcome = run_trial(variation, tmp_path)
    assert outcome.good, f"{'runs' if outcome.started else 'refused'}: {outcome.message} {list(outcome.wrong)}"
    assert "\n" not in outcome.message


def test_every_quirk_is_in_the_matrix() -> None:
    used = {key for variation in VARIATIONS for key in variation.quirks}
    assert {field.name for field in msgspec.structs.fields(Quirks)} <= used


def test_a_refusal_that_a_line_mends_has_a_twin_that_runs() -> None:
    """Each of these keys, which error messages propose as a remedy, is set in at least one variation."""
    keys = {key for variation in VARIATIONS for key in (*variation.profile, *variation.drive, *variation.supervision)}
    assert {
        "mode_shows", "produces_sync", "boot_timeout", "enable_timeout", "reports_following", "warnings", "supervision",
        "require_watchdog", "velocity_source", "absent",
    } <= keys  # fmt: skip
