"""Run the daemon's loop on a simulated bus in this process, with the same parts as `tsa run`."""

from __future__ import annotations

from tsa_ctrl.bus.live.rig import Rig
from tsa_ctrl.config import Configuration
from tsa_ctrl.daemon.build import control_axes, tuners_of
from tsa_ctrl.daemon.lifecycle import Lifecycle, Say
from tsa_ctrl.daemon.loop import Loop
from tsa_ctrl.daemon.notices import Events
from tsa_ctrl.daemon.telemetry import Telemetry
from tsa_ctrl.ipc.mailbox import RECOVER, Command, Mailbox
from tsa_ctrl.virtual.lockstep import Wire


class Daemon:
    """Axes, mailbox, events, loop and lifecycle of one run on a wire."""

    def __init__(self, configuration: Configuration, wire: Wire, say: Say = lambda text: None) -> None:
        file = configuration.file
        rig = Rig(wire.host, file.bus, file.axes, configuration.profiles)
        self.axes = control_axes(configuration, rig)
        self.tuners = tuners_of(self.axes, configuration.period)
        self.mailbox = Mailbox(len(self.axes), len(self.tuners[0].parameters))
        self.events = Events()
        self.telemetry = Telemetry(rig, self.axes, self.tuners, self.mailbox, None, None, self.events)
        self.loop = Loop(
            rig, self.axes, self.tuners, self.mailbox, self.telemetry, self.events, file.controller,
            file.bus.supervision, lambda: round(wire.now * 1e9),
        )  # fmt: skip
        self.lifecycle = Lifecycle(configuration, rig, self.axes, self.loop, say)

    def recover(self) -> None:
        """Request a recovery, as `tsa set recover 1`."""
        self.mailbox.put(Command(0, RECOVER, 1.0))
