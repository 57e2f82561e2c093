"""Provide the workers that diagnose the logs: processes of this machine, or those of a running Dask scheduler."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import dataclass
from typing import Any

from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.system.process_supervisor import begin_worker, worker_context

CONNECT = 10.0  # s to reach a scheduler


@dataclass(frozen=True)
class Workers:
    """A concurrent.futures executor, the number of its parallel jobs, and whether it can read the local files."""

    executor: Executor
    count: int
    same_disk: bool = False


@contextlib.contextmanager
def local(jobs: int | None = None, preload: str = "tsa_ctrl.identify.fleet.sweep") -> Iterator[Workers]:
    """Provide processes of this machine, each of which first imports the module `preload`.

    `jobs`: number of processes; the default is one per core that this process may use.
    """
    count = jobs or len(os.sched_getaffinity(0))
    pool = ProcessPoolExecutor(count, mp_context=worker_context(preload), initializer=begin_worker)
    try:
        yield Workers(pool, count, same_disk=True)
    except BaseException:
        processes = list((pool._processes or {}).values())  # its public shutdown waits for the running jobs
        pool.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.terminate()
        raise
    pool.shutdown()


@contextlib.contextmanager
def dask(scheduler: str) -> Iterator[Workers]:
    """Provide the workers of a running Dask scheduler ("tcp://host:8786"); they need this package, but no files.

    Raises:
        UsageError: the package distributed is not installed.
        BusError: no scheduler answers, or it has no workers.
    """
    try:
        from distributed import Client
    except ImportError:
        raise UsageError("--scheduler: the package distributed is not installed; pip install '.[fleet]'") from None
    try:
        client: Any = Client(scheduler, timeout=CONNECT)
    except (OSError, ValueError) as error:
        found = " ".join(str(error).split())
        raise BusError(
            f"--scheduler {scheduler}: no Dask scheduler answers ({found}); start one or name another"
        ) from None
    with client:
        count = sum(client.ncores().values())
        if count == 0:
            raise BusError(f"--scheduler {scheduler}: it has no workers; start some (dask worker {scheduler})")
        yield Workers(client.get_executor(pure=False), count)
