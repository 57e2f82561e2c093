"""Measured-like logs with hidden effects, built without the package under test.

from hidden import case
c = case("single", "stribeck_friction", seed=3)
c.logs[0].columns["tau_j"], c.model, c.truth.effects
"""

from .cases import Case, Truth
from .bench import HiddenLog
from .families import case, make_cases
from .strength import NAMES

__all__ = ["NAMES", "Case", "HiddenLog", "Truth", "case", "make_cases"]
