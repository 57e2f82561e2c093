"""Create realistic logs with hidden effects without using the package under test.

from tests.blind import case
c = case("single", "stribeck_friction", seed=3)
c.logs[0].columns["tau_j"], c.model, c.truth.effects
"""

if __name__ != "tests.blind":  # the cache of compiled functions requires this name
    raise ImportError("import this package as tests.blind, from the project's folder")

from .cases import Case, Truth
from .families import FAMILIES, case, make_cases
from .recording import HiddenLog
from .strength import NAMES

__all__ = ["FAMILIES", "NAMES", "Case", "HiddenLog", "Truth", "case", "make_cases"]
