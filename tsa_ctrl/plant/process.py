"""The process `tsa plant`: open the bus, real-time rights if there are any, run until a signal."""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import sys
from collections.abc import Iterable
from pathlib import Path
from types import FrameType

from tsa_ctrl.bus.wire.python_can import PythonCan
from tsa_ctrl.bus.wire.seam import Bus
from tsa_ctrl.bus.wire.socketcan import SocketCan
from tsa_ctrl.errors import BusError
from tsa_ctrl.plant.axis import Axis
from tsa_ctrl.plant.channel import ControlSocket
from tsa_ctrl.plant.console import Console
from tsa_ctrl.plant.eds import eds, file_names
from tsa_ctrl.plant.faults import check_fault
from tsa_ctrl.plant.machine import Machine, build_axes
from tsa_ctrl.plant.node import Node
from tsa_ctrl.plant.record import Recorder
from tsa_ctrl.plant.settings import BusSettings, PlantSettings, load_plant

SDO_REQUEST, SDO_ANSWER = 0x600, 0x580  # of the default server channel, CiA 301
DEVICE_TYPE = bytes((0x40, 0x00, 0x10, 0, 0, 0, 0, 0))  # initiate upload of 0x1000:0
ANSWER_TIME = 0.1  # s; a node of ours answers within ms, a device of others within tens of them


def check(path: str | Path) -> PlantSettings:
    """Read everything that a run would read, move nothing; raises UsageError."""
    plant = load_plant(path)
    for settings in plant.axis:
        Axis(settings, plant.physics)
        for fault in settings.fault:
            check_fault(fault, f"{path}: axis '{settings.name}'")
    return plant


def eds_files(configuration: str | Path, path: Path) -> list[tuple[Path, str]]:
    """The EDS of each node of a plant file, and where it goes; raises UsageError."""
    nodes = nodes_of(check(configuration))
    places = file_names(path, [node.node_id for node in nodes])
    return [(places[node.node_id], eds(node.dictionary, places[node.node_id].name)) for node in nodes]


def nodes_of(plant: PlantSettings) -> list[Node]:
    """Every node once, on no bus."""
    units = build_axes(plant, lambda can_id, data: True, lambda: 0.0)
    return list({id(node): node for unit in units for node in unit.nodes}.values())


def open_bus(settings: BusSettings) -> Bus:
    """The bus of the configuration; raises BusError."""
    if settings.interface == "socketcan":
        return SocketCan(settings.channel, send_queue=128)
    return PythonCan(settings.interface, settings.channel, settings.bitrate, settings.options)


def refuse_doubles(bus: Bus, nodes: Iterable[int], wait: float = ANSWER_TIME) -> None:
    """Ask every node id for its device type (0x1000) before a node of ours has it.

    Raises BusError when somebody answers within `wait` s: two nodes of one id would answer the master at once.
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
    """Simulate until SIGTERM or SIGINT; says `ready` on stdout when every node has booted.

    record: file for the truth as CSV; control: place of the local socket that takes commands. Raises UsageError,
    BusError.
    """
    plant = check(path)
    with contextlib.ExitStack() as stack:
        bus = open_bus(plant.bus)
        stack.callback(bus.close)
        refuse_doubles(bus, [node.node_id for node in nodes_of(plant)])
        machine = Machine(plant, bus)
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
        print(f"plant: axis {unit.axis.name} on {machine.bus.name}: {nodes}", flush=True)
    print(f"plant: ready ({policy})", flush=True)
    try:
        machine.run(lambda: stopping)
    finally:
        counts = machine.counts
        dropped = machine.bus.counters.dropped
        skipped = f", {counts.skipped:.3f} s not followed" if counts.skipped else ""
        print(f"plant: {counts.syncs} SYNC, {counts.frames} frames in, {dropped} dropped{skipped}", file=sys.stderr)


def _real_time(priority: int) -> str:
    """First-in-first-out scheduling where this user may; what is in force, in words."""
    if priority > 0:
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    in_force = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
    return f"SCHED_FIFO {priority}" if in_force == os.SCHED_FIFO else "no real-time scheduling"
