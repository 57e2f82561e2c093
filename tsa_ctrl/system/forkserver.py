"""The process that workers are forked from, which loads what they need while this one does something else."""

from __future__ import annotations

import multiprocessing
import os
from multiprocessing import forkserver
from multiprocessing.context import BaseContext

from tsa_ctrl.system.signals import unheard_by_children

LEAN = "tsa_ctrl.system.lean"


def loading(module: str) -> BaseContext:
    """What starts workers with `module` imported, from a process that imports it from now on; the first call counts.

    A fork of this process would take its threads' locks along. Linear algebra takes one thread in all of them, which
    would only get in each other's way.
    """
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([LEAN, module])
    with unheard_by_children():
        forkserver.ensure_running()
    return context
