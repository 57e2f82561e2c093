"""The daemon's end of its socket server, which opens the socket before the daemon imports anything slow."""

from __future__ import annotations

import os

import msgspec

from tsa_ctrl.errors import UsageError
from tsa_ctrl.ipc import pid_file
from tsa_ctrl.ipc.protocol import Description, Opening
from tsa_ctrl.system.process_supervisor import Child

PATIENCE = 2.0  # s for the server to end


class ServerProcess:
    """Run the socket server from the start of the daemon on.

    Until `describe`, it answers a status request with the stage of the start, and ends the daemon at a stop request.

    Attributes:
        path: of the socket.
        descriptor: memory in which the daemon then creates its mailbox.
    """

    def __init__(self, path: str, group: str | None = None, watch_group: str | None = None, name: str = "rig") -> None:
        """Open the socket; raises UsageError if that is not possible, for example because another daemon has it."""
        self.path = path
        self.descriptor = os.memfd_create("tsa", os.MFD_CLOEXEC)
        self._child = Child("tsa_ctrl.ipc.server", self.descriptor, fd=self.descriptor)
        try:
            self._child.send(msgspec.json.encode(Opening(path, group, watch_group, name)))
            self._check()
            pid_file.write(path, os.getpid())
        except BaseException:
            self.end()
            raise

    def stage(self, text: str) -> None:
        """Report a stage of the start, one line."""
        self._child.send(" ".join(text.split()).encode())

    def describe(self, description: Description) -> None:
        """End the stages: the mailbox is in its memory, and the server answers everything from now on."""
        self._child.send(msgspec.json.encode(description))
        self._check()

    @property
    def alive(self) -> bool:
        """Return True while the process runs."""
        return self._child.alive

    def end(self) -> None:
        """End the process, which removes the socket; may be called twice."""
        pid_file.remove(self.path, os.getpid())
        self._child.end(PATIENCE)

    def _check(self) -> None:
        if failure := self._child.failure():
            raise UsageError(failure)
