"""What the campaign does where the plant cannot: each act returns how it is undone, or nothing."""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tools.campaign.fault.processes import Daemon
from tsa_ctrl.bus.wire.socketcan import SocketCan
from tsa_ctrl.errors import TsaError
from tsa_ctrl.ipc.client import Client
from tsa_ctrl.ipc.protocol import Status

HANG = 0.5  # s
CLIENTS = 4

LASTING = frozenset({"kill", "kill_log", "kill_server", "hang_up", "fill_disk"})  # what they end is not there again

Undo = Callable[[], object]


@dataclass(frozen=True)
class Site:
    """Where an act happens: the bus, the folder of the logs, and whether that is a small disk of its own."""

    channel: str
    logs: Path
    small_disk: bool


def second_master(site: Site, daemon: Daemon) -> None:
    _send(site, 0x080, b"")


def second_commander(site: Site, daemon: Daemon) -> None:
    _send(site, 0x201, bytes.fromhex("0f00e803"))  # enabled, at rated torque


def reset_node(site: Site, daemon: Daemon) -> None:
    _send(site, 0x000, bytes((0x82, 32)))


def _send(site: Site, can_id: int, data: bytes) -> None:
    bus = SocketCan(site.channel)
    bus.send(can_id, data)
    bus.close()


def hang(site: Site, daemon: Daemon) -> None:
    daemon.process.send_signal(signal.SIGSTOP)
    time.sleep(HANG)
    daemon.process.send_signal(signal.SIGCONT)


def kill(site: Site, daemon: Daemon) -> None:
    daemon.process.kill()


def hang_up(site: Site, daemon: Daemon) -> None:
    daemon.process.send_signal(signal.SIGHUP)


def kill_log(site: Site, daemon: Daemon) -> None:
    keeper, *_ = daemon.children("log.writer")
    os.kill(keeper, signal.SIGKILL)  # its writer ends with it


def kill_server(site: Site, daemon: Daemon) -> None:
    keeper, *_ = daemon.children("ipc.server")
    os.kill(keeper, signal.SIGKILL)


def fill_disk(site: Site, daemon: Daemon) -> Undo:
    if not site.small_disk:  # a limit on the writer's file stands in
        *_, pid = daemon.children("log.writer")
        size = max(path.stat().st_size for path in site.logs.glob("*.mcap"))
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))
        return lambda: resource.prlimit(pid, resource.RLIMIT_FSIZE, (-1, -1)) and None
    filler = site.logs / "filler"
    with contextlib.suppress(OSError), filler.open("wb", buffering=0) as file:
        while True:
            file.write(bytes(1 << 12))
    return lambda: filler.unlink(missing_ok=True)


def flood_socket(site: Site, daemon: Daemon) -> Undo:
    stop = threading.Event()

    def flood() -> None:
        while not stop.is_set():
            with contextlib.suppress(TsaError, OSError), Client(daemon.socket, timeout=0.2) as client:
                while not stop.is_set():
                    client.ask(Status())

    threads = [threading.Thread(target=flood, daemon=True) for _ in range(CLIENTS)]
    for thread in threads:
        thread.start()

    def end() -> None:
        stop.set()
        for thread in threads:
            thread.join()

    return end


def hanging_client(site: Site, daemon: Daemon) -> Undo:
    clients = [socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) for _ in range(CLIENTS)]
    for client in clients:
        client.connect(daemon.socket)
        client.send(b'{"verb": "sta')

    def end() -> None:
        for client in clients:
            client.close()

    return end


ACTS: dict[str, Callable[[Site, Daemon], Undo | None]] = {
    act.__name__: act
    for act in (
        second_master,
        second_commander,
        reset_node,
        hang,
        hang_up,
        kill,
        kill_log,
        kill_server,
        fill_disk,
        flood_socket,
        hanging_client,
    )
}
