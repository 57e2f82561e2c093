"""Run the daemon from start to end: child processes, rights, bring-up, loop, and a single shutdown path."""

from __future__ import annotations

import contextlib
import math
import signal
from collections.abc import Callable, Iterator, Sequence
from types import FrameType

from tsa_ctrl.bus.drive.network import open_buses
from tsa_ctrl.bus.live.rig import Rig
from tsa_ctrl.config import Configuration
from tsa_ctrl.control.live_parameters import Tuner
from tsa_ctrl.daemon.build import control_axes, describe, log_header, tuners_of
from tsa_ctrl.daemon.joint_files import admitted, nodes_simulated
from tsa_ctrl.daemon.lifecycle import Lifecycle, Say
from tsa_ctrl.daemon.loop import Loop
from tsa_ctrl.daemon.monitoring import SecondChannel, monitor_line, monitor_process
from tsa_ctrl.daemon.notices import AxisSensors, Events
from tsa_ctrl.daemon.summary import Summary
from tsa_ctrl.daemon.telemetry import Telemetry
from tsa_ctrl.errors import UsageError
from tsa_ctrl.ipc.mailbox import Mailbox
from tsa_ctrl.ipc.protocol import default_path
from tsa_ctrl.ipc.server_process import ServerProcess
from tsa_ctrl.log.process import LOG_KIND, LOG_SUFFIX, LogLimits, LogProcess
from tsa_ctrl.log.ring import RingWriter
from tsa_ctrl.outputs import make_folder, untaken
from tsa_ctrl.readiness import Nodes, missing, missing_on_bus, require
from tsa_ctrl.system import realtime
from tsa_ctrl.system.compiling import on_compile
from tsa_ctrl.system.process_supervisor import Notifier

MEGA = 1e6  # bytes of a MB


class Children:
    """Own the log writer, the socket server and the serial readers, and the memory that they share with the loop.

    The processes are started before the loop, and the loop never waits for them.
    """

    def __init__(self, configuration: Configuration, tuners: Sequence[Tuner], server: ServerProcess) -> None:
        """Start the processes next to the socket server; raise UsageError if the log cannot be created."""
        file = configuration.file
        self.ring: RingWriter | None = None
        self.log: LogProcess | None = None
        self.sensors = AxisSensors(file.axes)
        self._server = server
        self.mailbox = Mailbox(len(file.axes), len(tuners[0].parameters), self._server.descriptor)
        try:
            if file.log.enabled:
                self.log = self._start_log(configuration)
            self._server.describe(describe(configuration, tuners))
            if self.log is not None:
                self.log.wait_until_up()
        except BaseException:
            self.end()
            raise

    def _start_log(self, configuration: Configuration) -> LogProcess:
        folder = configuration.log_folder
        make_folder(folder, "choose another log folder")
        self.ring = RingWriter(len(configuration.file.axes))
        log = configuration.file.log
        limits = LogLimits(log.file_size * MEGA, log.file_age, log.folder_size and log.folder_size * MEGA)
        return LogProcess(untaken(folder, LOG_KIND, LOG_SUFFIX), self.ring, log_header(configuration), limits)

    def end(self) -> None:
        """Complete the log and end all processes; may be called twice."""
        self.sensors.close()
        if self.log is not None and self.log.alive:
            self.log.end()
        self._server.end()


def server_process(configuration: Configuration) -> ServerProcess:
    """Start the socket server of a configuration; raise UsageError if the socket cannot be opened."""
    socket = configuration.file.socket
    name = configuration.file.controller.name
    return ServerProcess(socket.path or default_path(), socket.group, socket.watch_group, name)


STOPPING = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)


def run(
    configuration: Configuration,
    seconds: float = math.inf,
    say: Say = lambda line: None,
    reset_faults: bool = False,
    watch: Callable[[Rig], None] = lambda rig: None,
    allow_simulated: bool = False,
    server: ServerProcess | None = None,
) -> Summary:
    """Run the controller until it is stopped, or for `seconds` of torque; return its summary, including later faults.

    Args:
        say: receives each line for the user.
        reset_faults: True resets drives found in fault at startup.
        watch: receives the rig before anything is sent.
        allow_simulated: True permits model files with simulated numbers on hardware.
        server: the socket server, if it was started before; this function ends it.

    Raises:
        UsageError: the configuration is wrong.
        BusError: the bus or a node failed before the first cycle.
    """
    configuration = admitted(configuration, allow_simulated)
    return Daemon(configuration, say, reset_faults, watch, server).run(seconds)


class Daemon:
    """Run the controller once; every exit passes through the same ramp to zero torque."""

    def __init__(
        self,
        configuration: Configuration,
        say: Say,
        reset_faults: bool,
        watch: Callable[[Rig], None],
        server: ServerProcess | None,
    ) -> None:
        self._server = server
        self._configuration = configuration
        self._reset_faults = reset_faults
        self._watch = watch
        self._say = say
        self._loop: Loop | None = None
        self._early_stop: str | None = None
        self._notifier = Notifier()

    def run(self, seconds: float) -> Summary:
        configuration = self._configuration
        file = configuration.file
        require(configuration, missing(configuration))
        bus = open_buses(file.buses, file.axes)
        server = None
        try:
            server = self._server or server_process(configuration)
            on_compile(server.stage)
            server.stage("preparing the control loop")
            rig = Rig(bus, file.slowest_bus, file.axes, configuration.profiles, wake_early=file.realtime.wake_early)
            self._watch(rig)
            axes = control_axes(configuration, rig)
            tuners = tuners_of(axes, configuration.period)
            server.stage("opening log and sensors")
            children = Children(configuration, tuners, server)
            channel = SecondChannel()
            for axis in axes:
                axis.instruments.connect(children.sensors.sources(axis.name))
            try:
                channel = monitor_process(configuration)
                self._say(monitor_line(configuration))
                with self._signals():
                    rights = realtime.acquire(file.realtime)
                    for line in rights.missing:
                        self._say(f"going on without: {line}")
                    events = Events()
                    telemetry = Telemetry(
                        rig,
                        axes,
                        tuners,
                        children.mailbox,
                        children.ring,
                        children.log,
                        events,
                        children.sensors,
                        self._notifier,
                    )
                    telemetry.watch_server(server)
                    loop = Loop(
                        rig, axes, tuners, children.mailbox, telemetry, events, file.controller, file.bus.supervision
                    )
                    loop.attach(channel)
                    self._enter(loop)
                    lifecycle = Lifecycle(
                        configuration,
                        rig,
                        axes,
                        loop,
                        self._say,
                        self._notifier.no_loop,
                        lambda stage: children.mailbox.publish_stage(bus.clock(), stage),
                        nodes_simulated(configuration),
                        self._admit,
                    )
                    realtime.freeze_garbage()  # slow, and our heartbeat must not wait between bring-up and loop
                    try:
                        lifecycle.run(seconds, self._reset_faults)
                    finally:
                        realtime.release()
            finally:
                children.end()
                channel.close()
            log = children.log
            summary = lifecycle.summary(
                children.mailbox,
                str(rights),
                None if log is None else str(log.path.resolve()),
                0 if log is None else log.health().written,
            )
            try:
                summary.save()
            except UsageError as error:  # a full disk must not lose the summary
                self._say(str(error))
            return summary
        finally:
            on_compile(None)
            if server is not None:
                server.end()
            bus.close()
            self._notifier.close()

    def _admit(self, nodes: Nodes, has_inputs: bool) -> None:
        """Raise UsageError if the nodes do not meet the requirements of class "worn"."""
        require(self._configuration, missing_on_bus(self._configuration, nodes, has_inputs))

    def _enter(self, loop: Loop) -> None:
        """Pass signals to the loop from now on, including an earlier one; the bring-up checks the loop for a stop."""
        self._loop = loop
        if self._early_stop is not None:
            loop.stop(self._early_stop)

    @contextlib.contextmanager
    def _signals(self) -> Iterator[None]:
        """Let SIGTERM, SIGINT and SIGHUP (closed terminal) request the stop; a second signal has no effect."""

        def handle(number: int, frame: FrameType | None) -> None:
            name = signal.Signals(number).name
            if self._loop is not None:
                self._loop.stop(name)
            else:
                self._early_stop = self._early_stop or name

        wanted = [number for number in STOPPING if signal.getsignal(number) is not signal.SIG_IGN]  # respects nohup
        before = {number: signal.signal(number, handle) for number in wanted}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
