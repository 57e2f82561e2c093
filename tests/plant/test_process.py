"""Test the process `tsa plant`: its checks before it reports that it is ready."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.plant.bench import plant_file
from tsa_ctrl.bus.wire.python_can import PythonCan
from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.plant.process import ControlSocket, check, nodes_by_bus, refuse_doubles


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
            with pytest.raises(BusError, match=r"node 5 answers on .* already: another plant or a device; stop it"):
                refuse_doubles(ours, [1, 5], wait=20.0)
        else:
            refuse_doubles(ours, [1, 5])
    finally:
        done.set()
        thread.join()


def test_each_bus_is_checked_for_its_own_node_ids(tmp_path: Path) -> None:
    """A node of the same id on another bus is not in conflict."""
    text = "".join(f"[[bus]]\nname = '{name}'\n" for name in "ab")
    text += "".join(f"[[axis]]\nname = '{name}'\nbus = '{name}'\n" for name in "ba")
    assert nodes_by_bus(check(plant_file(tmp_path, text))) == [{2, 33, 65}, {1, 32, 64}]


def test_a_second_plant_does_not_take_the_socket_of_the_first(tmp_path: Path) -> None:
    path = tmp_path / "plant.sock"
    first = ControlSocket(path)
    with pytest.raises(UsageError, match=r"plant.sock: no socket can be made here .*; stop the plant that uses it"):
        ControlSocket(path)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as client:
        client.sendto(b"state", str(path))
    received: list[str] = []
    first.poll(lambda line: received.append(line) or "")
    assert received == ["state"]
    first.close()


def test_the_socket_of_a_killed_plant_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "plant.sock"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as killed:
        killed.bind(str(path))
    assert path.is_socket()
    ControlSocket(path).close()
    (tmp_path / "file").write_text("kept")
    with pytest.raises(UsageError, match="no socket can be made here"):
        ControlSocket(tmp_path / "file")
    assert (tmp_path / "file").read_text() == "kept"
