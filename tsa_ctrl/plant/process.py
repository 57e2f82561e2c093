"""Run the process `tsa plant`: open the bus, take real-time scheduling if permitted, and run until a signal."""

from __future__ import annotations

import contextlib
import errno
import gc
import json
import os
import signal
import socket
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from types import FrameType

from tsa_ctrl.bus.wire.bus import Bus
from tsa_ctrl.bus.wire.datagram import DatagramBus
from tsa_ctrl.bus.wire.python_can import PythonCan
from tsa_ctrl.bus.wire.socketcan import SocketCan
from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.plant.axis import Recorder
from tsa_ctrl.plant.dictionary import eds, file_names
from tsa_ctrl.plant.faults import CHANGES, FAULTS, parse_fault
from tsa_ctrl.plant.machine import AxisNodes, Machine, build_axes
from tsa_ctrl.plant.mechanism import build_mechanism
from tsa_ctrl.plant.node import Node
from tsa_ctrl.plant.settings import BusSettings, PlantSettings, load_plant

_LINE = 4096  # bytes; the rest of a longer line is cut off


class ControlSocket:
    """Serve the run-time control of a simulated machine on a local datagram socket.

    Each datagram holds one line and gets one reply. The socket is bound to `path`, for this user only.
    """

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        before = os.umask(0o177)
        try:
            if self._path.is_socket() and _is_left_over(path):
                self._path.unlink()
            self._socket.bind(str(path))
        except OSError as error:
            self._socket.close()
            raise UsageError(
                f"{path}: no socket can be made here ({error.strerror}); stop the plant that uses it, or choose "
                "another place"
            ) from None
        finally:
            os.umask(before)

    def poll(self, answer: Callable[[str], str]) -> None:
        """Reply to each line that has arrived, without waiting; a client that has disconnected is ignored."""
        while True:
            try:
                data, sender = self._socket.recvfrom(_LINE)
            except BlockingIOError:
                return
            reply = answer(data.decode("utf-8", "replace").strip())
            if sender:
                with contextlib.suppress(OSError):
                    self._socket.sendto(reply.encode(), sender)

    def close(self) -> None:
        self._socket.close()
        self._path.unlink(missing_ok=True)


def _is_left_over(path: str | Path) -> bool:
    """Return True if no process has the socket open any more, because its plant was killed."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as probe:
        return probe.connect_ex(str(path)) == errno.ECONNREFUSED


def ask(path: str | Path, line: str, timeout: float = 2.0) -> str:
    """Send one line to a running machine and return its reply; raises BusError if none arrives in `timeout` s."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as client:
        client.settimeout(timeout)
        client.bind("")  # Linux assigns an abstract address
        try:
            client.sendto(line.encode(), str(path))
            return client.recv(1 << 16).decode()
        except OSError as error:
            reason = error.strerror or "no answer in time"
            raise BusError(f"{path}: no simulated machine answers ({reason}); start tsa plant with --control") from None


KINDS = {**FAULTS, **CHANGES}
HELP = "NAME [axis=AXIS] [node=drive|encoder|torque_sensor] [value=NUMBER] [duration=SECONDS] [at=SECONDS]"


class Console:
    """Run the commands of the control socket: start and end faults, list them, and report the state.

    The reply is `ok CLOCK` (CLOCK_MONOTONIC in s, when the command was run), `error: ...`, or the requested text.
    """

    def __init__(self, machine: Machine, channel: ControlSocket) -> None:
        self._machine = machine
        self._channel = channel
        self._now = 0.0

    def poll(self, now: float) -> None:
        self._now = now
        self._channel.poll(self.answer)

    def answer(self, line: str) -> str:
        """Run one command and return the reply: a fault, `clear` (end all faults), `state` (JSON), `list` or `help`."""
        if line in ("", "help"):
            return f"{HELP}; or clear, state, list"
        if line == "list":
            return "\n".join(f"{name}: {kind.doc}{_value(name)}" for name, kind in KINDS.items())
        if line == "state":
            return self._state()
        if line == "clear":
            return f"ok {self._now:.6f} {self._machine.faults.clear(self._now)} ended"
        try:
            axis, fault = parse_fault(line)
            self._machine.begin_fault(axis, fault, self._now)
        except UsageError as error:
            return f"error: {error}"
        return f"ok {self._now:.6f}"

    def _state(self) -> str:
        axes = [
            {
                "name": unit.axis.name,
                "power": unit.drive.machine.state.name.lower(),
                "nmt": {kind: node.state.name.lower() for kind, node in unit.by_kind.items()},
                **unit.axis.values(),
            }
            for unit in self._machine.axes
        ]
        return json.dumps({"clock": self._now, "faults": self._machine.faults.active, "axes": axes})

    def close(self) -> None:
        self._channel.close()


def _value(name: str) -> str:
    kind = KINDS[name]
    return f" (value: {kind.unit}, default {kind.value:g})" if kind.unit else ""


SDO_REQUEST, SDO_ANSWER = 0x600, 0x580  # of the default SDO server channel, CiA 301
DEVICE_TYPE = bytes((0x40, 0x00, 0x10, 0, 0, 0, 0, 0))  # initiate upload of 0x1000:0
ANSWER_TIME = 0.1  # s; a simulated node answers within milliseconds, a real device within tens of milliseconds


def check(path: str | Path) -> PlantSettings:
    """Return the settings after checks of everything that a run would read; raises UsageError."""
    plant = load_plant(path)
    units = _units(plant, str(path))
    build_mechanism(plant, [unit.axis for unit in units], str(path))
    for unit in units:
        for fault in unit.axis.settings.fault:
            unit.kind_of(fault, f"{path}: ")
    return plant


def eds_files(configuration: str | Path, path: Path) -> list[tuple[Path, str]]:
    """Return the path and the text of the EDS of each node of a plant file; raises UsageError."""
    nodes = nodes_of(check(configuration))
    places = file_names(path, [node.node_id for node in nodes])
    return [(places[node.node_id], eds(node.dictionary, places[node.node_id].name)) for node in nodes]


def nodes_of(plant: PlantSettings) -> list[Node]:
    """Return every node of the plant once, without a bus."""
    return list({id(node): node for unit in _units(plant) for node in unit.nodes}.values())


def nodes_by_bus(plant: PlantSettings) -> list[set[int]]:
    """Return the node ids on each bus, in the order of the buses."""
    ids: list[set[int]] = [set() for _ in plant.buses]
    for unit in _units(plant):
        ids[plant.bus_number(unit.axis.settings)] |= {node.node_id for node in unit.nodes}
    return ids


def _units(plant: PlantSettings, where: str = "plant") -> list[AxisNodes]:
    """Return the axes with their nodes, without a bus; `where` begins the text of an error."""
    return build_axes(plant, [lambda can_id, data: True] * len(plant.buses), lambda: 0.0, where)


def open_bus(settings: BusSettings) -> Bus:
    """Open the configured bus; raises BusError."""
    if settings.interface == "socketcan":
        return SocketCan(settings.channel, send_queue=128)
    if settings.interface == "datagram":
        return DatagramBus(settings.channel, send_queue=128)
    return PythonCan(settings.interface, settings.channel, settings.bitrate, settings.options)


def refuse_doubles(bus: Bus, nodes: Iterable[int], wait: float = ANSWER_TIME) -> None:
    """Check that no other node uses these node ids, by reading the device type (0x1000) of each.

    Raises BusError if a node answers within `wait` s. Two nodes with one id would both answer the master.
    """
    asked = {SDO_ANSWER + node: node for node in nodes}
    bus.flush()
    for node in asked.values():
        bus.send(SDO_REQUEST + node, DEVICE_TYPE)
    end = bus.clock() + wait
    while (left := end - bus.clock()) > 0.0:
        frame = bus.recv(left)
        if frame is not None and frame[0] in asked:
            raise BusError(
                f"node {asked[frame[0]]} answers on {bus.name} already: another plant or a device; "
                "stop it, or give these nodes other ids"
            )


def run(path: str | Path, record: str | None = None, control: str | None = None) -> None:
    """Simulate until SIGTERM or SIGINT; prints `ready` on stdout after every node has booted.

    Args:
        path: plant file.
        record: CSV file for the true state.
        control: path of the local socket that accepts commands.

    Raises:
        UsageError: invalid settings or paths.
        BusError: a bus failed, or another node has one of the node ids.
    """
    plant = check(path)
    with contextlib.ExitStack() as stack:
        buses = []
        for settings, nodes in zip(plant.buses, nodes_by_bus(plant), strict=True):
            buses.append(open_bus(settings))
            stack.callback(buses[-1].close)
            refuse_doubles(buses[-1], nodes)
        machine = Machine(plant, buses[0], others=buses[1:])
        if record is not None:
            machine.recorder = Recorder(record, plant.physics.record_period)
            stack.callback(machine.recorder.close)
        if control is not None:
            console = Console(machine, ControlSocket(control))
            machine.housekeeping = console.poll
            stack.callback(console.close)
        _run(machine)


def _run(machine: Machine) -> None:
    stopping = False

    def stop(_signal: int, _frame: FrameType | None) -> None:
        nonlocal stopping
        stopping = True

    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)
    policy = _real_time(machine.plant.physics.priority)
    gc.collect()
    gc.freeze()
    gc.disable()
    machine.start()
    for unit in machine.axes:
        nodes = ", ".join(f"{node.dictionary.texts[0x1008, 0]} {node.node_id}" for node in unit.nodes)
        bus = machine.buses[machine.plant.bus_number(unit.axis.settings)]
        print(f"plant: axis {unit.axis.name} on {bus.name}: {nodes}", flush=True)
    print(f"plant: ready ({policy})", flush=True)
    try:
        machine.run(lambda: stopping)
    finally:
        counts = machine.counts
        dropped = sum(bus.counters.dropped for bus in machine.buses)
        skipped = f", {counts.skipped:.3f} s not followed" if counts.skipped else ""
        print(f"plant: {counts.syncs} SYNC, {counts.frames} frames in, {dropped} dropped{skipped}", file=sys.stderr)


def _real_time(priority: int) -> str:
    """Request first-in-first-out scheduling, and return the scheduling in force as text."""
    if priority > 0:
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    in_force = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
    return f"SCHED_FIFO {priority}" if in_force == os.SCHED_FIFO else "no real-time scheduling"
