"""A run in virtual time with the daemon's socket server: real sockets, the clock of the run.

The time stops while a client is served, so the same clients give the same run.
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

PATIENCE = 60.0  # s of real time that a program sleeps at most
Action = Callable[[float], None]
Script = Sequence[tuple[Action, float]]


class ServedRun(Run):
    """`at` plans what clients do; `play` then runs it."""

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
        """`action(now)`: s of the log's time, and of the run's clock."""
        self._planned.append((action, time))

    def connected(self, sent: bytes, ends: bool = False) -> Action:
        """Connect another client that sends this; it disconnects right after if it `ends`."""

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
        """From `at` s of the log on, a client's own program: time passes while it sleeps (`sleep`), and only then."""

        def work() -> None:
            try:
                controller()
            except BaseException as error:
                self._raised = error
            finally:
                self._asleep.set()

        self.at(at, lambda now: self._resume(threading.Thread(target=work, daemon=True).start))

    def clock(self) -> float:
        """s, for the program."""
        return self._wire.now

    def sleep(self, seconds: float) -> None:
        """For the program."""
        self._wire.at(self._wire.now + seconds, lambda now: self._resume(self._awake.set))
        self._asleep.set()
        if not self._awake.wait(PATIENCE):
            raise SystemExit  # the run is over
        self._awake.clear()

    def _resume(self, begin: Callable[[], None]) -> None:
        """The program goes on until it sleeps again, and is served meanwhile."""
        self._asleep.clear()
        begin()
        while not self._asleep.is_set():
            self._server.step(0.001)
        self.serve()
        if self._raised is not None:
            raise self._raised

    def serve(self) -> None:
        """Until the server has nothing to do."""
        for _ in range(8):
            self._server.step(0.0)

    def simulate(self) -> Simulation:
        """Run it to its end."""
        self._every(1e-3, lambda now: self.serve())
        return self.play((), (), lambda share: None)

    def _schedule(self, script: Script, settings: Sequence[tuple[Command, float]]) -> None:
        super()._schedule([*script, *self._planned], settings)

    def close(self) -> None:
        for connection in self._connections:
            connection.close()
        self._server.close()
        super().close()
