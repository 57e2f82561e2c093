"""Check the CAN interface as the kernel reports it, the traffic and load of the bus, and its response time."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from tsa_ctrl.bus.drive import budget
from tsa_ctrl.bus.drive.network import frames_of_drives, layout_of
from tsa_ctrl.bus.drive.profile import DriveProfile
from tsa_ctrl.bus.drive.session import master_frames
from tsa_ctrl.bus.settings import AxisNodes, BusSettings
from tsa_ctrl.bus.wire.bus import Bus
from tsa_ctrl.bus.wire.link import CanState, open_bus, read
from tsa_ctrl.errors import TsaError


class Result(Enum):
    """Possible results of a check."""

    PASS = "pass"
    WARN = "warn"
    FAIL = "fail"


@dataclass(frozen=True)
class Check:
    """Result of one check, with the actual and the required state.

    `fix` is the remedy: a command or one sentence, empty for a pass.
    """

    name: str
    result: Result
    found: str
    wanted: str
    fix: str = ""


def judge(name: str, good: bool, found: str, wanted: str, fix: str, otherwise: Result = Result.WARN) -> Check:
    """Return a pass if `good` is True, else a check with the result `otherwise` and its fix."""
    return Check(name, Result.PASS, found, wanted) if good else Check(name, otherwise, found, wanted, fix)


MOST_QUEUE = 256  # frames; a longer queue sends stale torque late
LISTEN_TIME = 0.5  # s, in which the frames of other nodes are counted
UPLOAD_DEVICE_TYPE = bytes((0x40, 0x00, 0x10, 0x00, 0, 0, 0, 0))  # CiA 301: initiate upload of 0x1000:0
ROUND_TRIPS = 20
ANSWER_TIME = 0.1  # s
MOST_ROUND_TRIP = 5.0  # ms, median over `ROUND_TRIPS`


def checks(
    settings: BusSettings, axes: Sequence[AxisNodes], rate: float, profiles: Sequence[DriveProfile] = ()
) -> Iterator[Check]:
    """Yield the checks of interface state, bit rate, error counters, queue length, traffic, and load at `rate` Hz.

    The queue length is checked for SocketCAN only. A SYNC that one of the `profiles` permits does not
    indicate another master.
    """
    if settings.interface == "socketcan":
        yield from _socketcan(settings)
    yield from _traffic(settings, axes, profiles)
    yield _load(settings, axes, rate)


def _socketcan(settings: BusSettings) -> Iterator[Check]:
    channel = settings.channel
    link = read(channel)
    make = f"ip link set {channel} type can bitrate {settings.bitrate} && ip link set {channel} up"
    if link is None:
        if "vcan" in channel:
            make = f"modprobe vcan; ip link add dev {channel} type vcan; ip link set {channel} up"
        yield Check("CAN interface", Result.FAIL, f"no interface {channel}", "an interface that is up", make)
        return
    if link.kind != "can":  # such as vcan, which has no bit rate
        make = f"ip link set {channel} up"
    kind = link.kind or "no CAN interface"
    yield judge("CAN interface", link.up, f"{channel} ({kind}), {'up' if link.up else 'down'}", "up", make, Result.FAIL)
    if link.kind == "can":
        yield judge(
            "bit rate", link.bitrate == settings.bitrate, f"{link.bitrate or 0} bit/s", f"{settings.bitrate} bit/s",
            f"ip link set {channel} down && {make}", Result.FAIL,
        )  # fmt: skip
        state = "unknown" if link.state is None else link.state.name.replace("_", "-")
        tx, rx = link.errors or ("?", "?")
        yield judge(
            "error counters", link.state is CanState.ERROR_ACTIVE and not any(link.errors or ()),
            f"{state}, tx {tx}, rx {rx}", "ERROR-ACTIVE, 0, 0",
            "check termination (60 ohm between the lines), wiring and bit rate of every node", Result.FAIL,
        )  # fmt: skip
        yield judge(
            "automatic restart", not link.restart_ms, f"restart-ms {link.restart_ms or 0}",
            "0: bus-off stays until the next query",
            f"ip link set {channel} down && ip link set {channel} type can restart-ms 0 && ip link set {channel} up",
        )  # fmt: skip
    queue = link.queue_length or 0
    yield judge(
        "transmit queue", 0 < queue <= MOST_QUEUE, f"{queue} frames", f"1 to {MOST_QUEUE}, about 128",
        f"ip link set {channel} txqueuelen 128",
    )  # fmt: skip
    yield judge(
        "lost frames", link.lost == 0, f"{link.lost} errors and drops since the interface is up", "0",
        "look at the bus load and at the adapter's cable; the count starts again when the interface is set down and up",
    )  # fmt: skip


def _traffic(settings: BusSettings, axes: Sequence[AxisNodes], profiles: Sequence[DriveProfile]) -> Iterator[Check]:
    """Open the bus as the daemon would, listen for other traffic, and measure the response time of each drive."""
    wanted = "opens; no other master is active"
    try:
        bus = open_bus(settings)
    except TsaError as error:
        yield Check("bus", Result.FAIL, str(error), wanted, "fix the lines above, or [bus] interface and channel")
        return
    try:
        yield judged(bus, listen(bus), settings, axes, wanted, profiles)
        for axis in axes:
            yield _round_trip(bus, axis)
    finally:
        bus.close()


def listen(bus: Bus) -> dict[int, int]:
    """Return the number of frames by identifier, received within `LISTEN_TIME` s or until the bus fails."""
    seen: dict[int, int] = {}
    end = time.monotonic() + LISTEN_TIME
    while bus.fault is None and (left := end - time.monotonic()) > 0.0:
        frame = bus.recv(left)
        if frame is not None:
            seen[frame[0]] = seen.get(frame[0], 0) + 1
    return seen


def judged(
    bus: Bus,
    seen: Mapping[int, int],
    settings: BusSettings,
    axes: Sequence[AxisNodes],
    wanted: str,
    profiles: Sequence[DriveProfile] = (),
) -> Check:
    """Return the check of the frames that `listen` counted; it fails for a failed bus or another master.

    A SYNC that one of the `profiles` permits does not indicate another master.
    """
    found = f"{sum(seen.values()) / LISTEN_TIME:.0f} frames/s heard"
    if bus.fault is not None:
        return Check("bus", Result.FAIL, f"{found}; {bus.fault.value}", wanted, "repair the bus wiring or power supply")
    tolerated = frames_of_drives(profiles)
    known = master_frames(settings.host_node_id) | {layout_of(axis.drive).rpdo_id for axis in axes}
    masters = sorted({can_id for can_id in seen if can_id in known or 0x200 <= can_id < 0x280} - tolerated)
    if masters:
        text = f"{found}; another master sends {', '.join(f'0x{can_id:03X}' for can_id in masters)}"
        fix = "stop the other controller (tsa stop) before starting this one"
        if masters == [0x080]:
            fix += "; if a drive sends SYNC, write produces_sync = true in its profile"
        return Check("bus", Result.FAIL, text, wanted, fix)
    return Check("bus", Result.PASS, found, wanted)


def _round_trip(bus: Bus, axis: AxisNodes) -> Check:
    """Check the time from an SDO request for 0x1000 (device type) to its answer, through adapter, wire and drive."""
    node, name = axis.drive.node_id, f"round trip to node {axis.drive.node_id}"
    times = [took for _ in range(ROUND_TRIPS) if (took := answering(bus, node)) is not None]
    if not times:
        fix = "switch the drive on, check its node id and bit rate; or start `tsa plant`"
        return Check(name, Result.FAIL, "no answer", "an answer to SDO 0x1000", fix)
    p50, worst = (1e3 * float(v) for v in np.quantile(times, [0.5, 1.0]))
    found = f"p50 {p50:.2f}, worst {worst:.2f} ms, {len(times)} of {ROUND_TRIPS} answered"
    fix = "check the adapter (latency timer of USB), the bus load and the wiring"
    return judge(name, len(times) == ROUND_TRIPS and p50 < MOST_ROUND_TRIP, found, f"below {MOST_ROUND_TRIP:g} ms", fix)


def answering(bus: Bus, node: int) -> float | None:
    """Return the seconds until a node answered an SDO request, or None if it did not."""
    begin = time.monotonic()
    bus.send(0x600 + node, UPLOAD_DEVICE_TYPE)
    while (left := begin + ANSWER_TIME - time.monotonic()) > 0.0 and bus.fault is None:
        frame = bus.recv(left)
        if frame is not None and frame[0] == 0x580 + node:
            return time.monotonic() - begin
    return None


def _load(settings: BusSettings, axes: Sequence[AxisNodes], rate: float) -> Check:
    load = budget.load(settings, axes, rate)
    return judge(
        "bus load",
        load.worst <= settings.max_load,
        f"{100 * load.least:.0f} to {100 * load.worst:.0f} % of {settings.bitrate} bit/s at {rate:g} Hz",
        f"at most {100 * settings.max_load:.0f} %",
        f"[controller] rate at most {load.highest_rate(settings.max_load):.0f} Hz, or a higher bit rate",
        Result.FAIL,
    )
