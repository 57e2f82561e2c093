"""Avoid loading unused parts of numpy. Import this module before scipy in an interactive program.

scipy copies all names of numpy, and so loads numpy's generator of Fortran interfaces and its test tools. This takes a
quarter of the loading time of a diagnosis. This module defers both to their first use (importlib.util.LazyLoader).
"""

from __future__ import annotations

import importlib.util
import sys

import numpy

UNASKED = ("f2py", "testing")


def _put_off(name: str) -> None:
    whole = f"{numpy.__name__}.{name}"
    spec = None if whole in sys.modules else importlib.util.find_spec(whole)
    if spec is None or spec.loader is None:  # loaded already, or another numpy
        return
    spec.loader = importlib.util.LazyLoader(spec.loader)
    module = importlib.util.module_from_spec(spec)
    sys.modules[whole] = module
    spec.loader.exec_module(module)
    setattr(numpy, name, module)


for _name in UNASKED:
    _put_off(_name)
