"""The processes beside the loop: log writer, socket server, serial readers. Up before it, and then never waited for."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Sequence

import msgspec

from tsa_ctrl.config import Configuration
from tsa_ctrl.control.live import Tuner
from tsa_ctrl.daemon.assembly import describe, log_header
from tsa_ctrl.daemon.serial_sensors import AxisSensors
from tsa_ctrl.errors import UsageError
from tsa_ctrl.ipc import pid_file
from tsa_ctrl.ipc.mailbox import Mailbox
from tsa_ctrl.ipc.server import READY
from tsa_ctrl.log.process import LogProcess
from tsa_ctrl.log.ring import RingWriter
from tsa_ctrl.outputs import untaken
from tsa_ctrl.system.parent import child

PATIENCE = 2.0  # s for the socket server to end


class Children:
    """The processes and the memory that they share with the loop."""

    def __init__(self, configuration: Configuration, tuners: Sequence[Tuner]) -> None:
        """Start them; raises UsageError when the log or the socket cannot be there."""
        file = configuration.file
        self.ring: RingWriter | None = None
        self.log: LogProcess | None = None
        self.sensors = AxisSensors(file.axes)
        self.mailbox = Mailbox(len(file.axes), len(tuners[0].parameters))
        description = describe(configuration, tuners)
        self._path = description.path
        self._server = child("tsa_ctrl.ipc.server", self.mailbox.descriptor, fd=self.mailbox.descriptor)
        assert self._server.stdin is not None
        assert self._server.stdout is not None
        try:
            self._server.stdin.write(msgspec.json.encode(description) + b"\n")
            self._server.stdin.flush()
            if file.log.enabled:
                self.log = self._start_log(configuration)
            answer = self._server.stdout.readline()
            if answer != READY:
                raise UsageError(answer.decode(errors="replace").strip() or "the socket server ended at once")
            pid_file.write(self._path, os.getpid())
            if self.log is not None:
                self.log.wait_until_up()
        except BaseException:
            self.end()
            raise

    def _start_log(self, configuration: Configuration) -> LogProcess:
        folder = configuration.log_folder
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UsageError(f"{folder}: the log folder cannot be made ({error.strerror}); choose another") from None
        self.ring = RingWriter(len(configuration.file.axes))
        return LogProcess(untaken(folder, "tsa", ".mcap"), self.ring, log_header(configuration))

    @property
    def server_alive(self) -> bool:
        return self._server.poll() is None

    def end(self) -> None:
        """Complete the log and end all; may be called twice."""
        self.sensors.close()
        if self.log is not None and self.log.alive:
            self.log.end()
        pid_file.remove(self._path, os.getpid())
        with contextlib.suppress(OSError, ValueError):
            self._server.communicate(timeout=PATIENCE)
        if self._server.poll() is None:
            self._server.kill()
            self._server.wait()
