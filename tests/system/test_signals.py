from __future__ import annotations

import multiprocessing
import signal
from multiprocessing.connection import Connection

from tsa_ctrl.system.process_supervisor import unheard_by_children


def tell_mask(pipe: Connection) -> None:
    pipe.send(signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, []))


def test_ctrl_c_never_reaches_a_child_and_its_parent_hears_it_again() -> None:
    """The child ignores the signals from its first instruction on. Its imports take a second."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=tell_mask, args=(theirs,), daemon=True)
    with unheard_by_children():
        process.start()
    theirs.close()
    assert ours.recv()
    process.join()
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])
