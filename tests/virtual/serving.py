"""Run the daemon with its socket server in virtual time, with real sockets and the clock of the run.

Virtual time stops while a client is served, so the same clients give the same run.
"""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

from tsa_ctrl.config import load_configuration
from tsa_ctrl.daemon.build import describe
from tsa_ctrl.ipc.connection import listen
from tsa_ctrl.ipc.mailbox import Command
from tsa_ctrl.ipc.server import Server
from tsa_ctrl.plant.process import check
from tsa_ctrl.virtual.result import Simulation
from tsa_ctrl.virtual.simulation import Run

PATIENCE = 60.0  # s of real time for which a program sleeps at most
Action = Callable[[float], None]
Script = Sequence[tuple[Action, float]]


class ServedRun(Run):
    """A run with planned actions of clients. `at` plans an action, and `simulate` runs it."""

    def __init__(self, controller: Path, plant: Path, seconds: float, out: Path | None = None) -> None:
        configuration = load_configuration(controller)
        super().__init__(configuration, check(plant), seconds, out)
        description = describe(configuration, self._tuners)
        self.path = description.path
        self._server = Server(listen(self.path, None), self._mailbox, description, self._wire.plant.clock)
        self._planned: list[tuple[Action, float]] = []
        self._connections: list[socket.socket] = []
        self._awake, self._asleep = threading.Event(), threading.Event()
        self._raised: BaseException | None = None

    def at(self, time: float, action: Action) -> None:
        """Plan `action(now)` at a time of the log, s. `now` is the clock of the run, s."""
        self._planned.append((action, time))

    def connected(self, sent: bytes, ends: bool = False) -> Action:
        """Return an action that connects another client and sends this. With `ends` the client then disconnects."""

        def action(now: float) -> None:
            connection = self.send(sent)
            if ends:
                connection.close()
                self.serve()

        return action

    def send(self, sent: bytes) -> socket.socket:
        connection = socket.socket(socket.AF_UNIX)
        connection.connect(self.path)
        self._connections.append(connection)
        connection.sendall(sent)
        self.serve()
        return connection

    def again(self, sent: bytes) -> None:
        """Let the last client send another request."""
        self._connections[-1].sendall(sent)
        self.serve()

    def control(self, at: float, controller: Callable[[], None]) -> None:
        """Plan a client program from `at` s of the log on. Virtual time passes only while the program calls `sleep`."""

        def work() -> None:
            try:
                controller()
            except BaseException as error:
                self._raised = error
            finally:
                self._asleep.set()

        self.at(at, lambda now: self._resume(threading.Thread(target=work, daemon=True).start))

    def clock(self) -> float:
        """Return the time of the run for a client program, s."""
        return self._wire.now

    def sleep(self, seconds: float) -> None:
        """Let a client program sleep in virtual time."""
        self._wire.at(self._wire.now + seconds, lambda now: self._resume(self._awake.set))
        self._asleep.set()
        if not self._awake.wait(PATIENCE):
            raise SystemExit  # the run is over
        self._awake.clear()

    def _resume(self, begin: Callable[[], None]) -> None:
        """Continue the client program until it sleeps again, and serve its requests meanwhile."""
        self._asleep.clear()
        begin()
        while not self._asleep.is_set():
            self._server.step(0.001)
        self.serve()
        if self._raised is not None:
            raise self._raised

    def serve(self) -> None:
        """Let the server handle all waiting requests."""
        for _ in range(8):
            self._server.step(0.0)

    def simulate(self) -> Simulation:
        """Run to the end, and return the result."""
        self._every(1e-3, lambda now: self.serve())
        return self.play((), (), lambda share: None)

    def _schedule(self, script: Script, settings: Sequence[tuple[Command, float]]) -> None:
        super()._schedule([*script, *self._planned], settings)

    def close(self) -> None:
        for connection in self._connections:
            connection.close()
        self._server.close()
        super().close()
