"""Test the process `tsa plant`: its checks before it reports that it is ready."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from tsa_ctrl.bus.wire.python_can import PythonCan
from tsa_ctrl.errors import BusError
from tsa_ctrl.plant.process import refuse_doubles


@pytest.fixture
def buses() -> Iterator[tuple[PythonCan, PythonCan]]:
    pair = tuple(PythonCan("virtual", "test-doubles", 1_000_000, {}) for _ in range(2))
    yield pair[0], pair[1]
    for bus in pair:
        bus.close()


def answer(bus: PythonCan, node: int, done: threading.Event) -> None:
    """Answer the upload of 0x1000:0 as a node does."""
    while not done.is_set():
        frame = bus.recv(0.02)
        if frame == (0x600 + node, bytes((0x40, 0x00, 0x10, 0, 0, 0, 0, 0))):
            bus.send(0x580 + node, bytes((0x43, 0x00, 0x10, 0, 0x92, 0x01, 0x02, 0)))


@pytest.mark.parametrize(("node", "refused"), [(5, True), (6, False)])
def test_a_node_id_that_answers_already_is_refused(
    buses: tuple[PythonCan, PythonCan], node: int, refused: bool
) -> None:
    ours, other = buses
    done = threading.Event()
    thread = threading.Thread(target=answer, args=(other, node, done))
    thread.start()
    try:
        if refused:
            with pytest.raises(BusError, match=r"node 5 already answers on .*: another plant or a device; stop it"):
                refuse_doubles(ours, [1, 5], wait=20.0)
        else:
            refuse_doubles(ours, [1, 5])
    finally:
        done.set()
        thread.join()
