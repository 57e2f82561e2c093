"""Test which parts of numpy a diagnosis loads, and that the others load on first use."""

from __future__ import annotations

import subprocess
import sys

SCRIPT = """
import sys
import tsa_ctrl.system.lazy_imports
import scipy.special
print("numpy.f2py.crackfortran" in sys.modules, "numpy.testing._private.utils" in sys.modules)
import numpy
numpy.testing.assert_allclose(scipy.special.erf(0.0), 0.0)
from numpy.f2py import crackfortran
print("numpy.testing._private.utils" in sys.modules, crackfortran.__name__)
"""


def test_what_nobody_asked_for_is_loaded_when_it_is_used() -> None:
    line = [sys.executable, "-c", SCRIPT]
    told = subprocess.run(line, capture_output=True, text=True, check=True, timeout=120.0).stdout.splitlines()
    assert told == ["False False", "True numpy.f2py.crackfortran"]


def test_a_module_that_is_loaded_stays_as_it_is() -> None:
    import numpy.testing

    before = sys.modules["numpy.testing"]
    import tsa_ctrl.system.lazy_imports  # noqa: F401

    assert sys.modules["numpy.testing"] is before is numpy.testing
