"""The faults of the campaign, as data: what is done, what must follow, and how it is undone."""

from __future__ import annotations

from dataclasses import dataclass

from tools.campaign.fault.verdict import Expected

LIE = 2.0  # s: a lie shows when what it hides moves; the joint swings once in 1.6 s
SWING = "shows with motion"


@dataclass(frozen=True)
class Fault:
    """`plant`: line for the plant's control socket; `act`: one of ACTS instead.

    `negative`: with a set-point of the other sign; `alone`: its daemon is not used again; `bare`: on a drive without
    an RPDO event timer; `watch`: s to look on; `unheard`: nobody answers afterwards, the torque says that it runs.
    """

    name: str
    expected: Expected
    plant: str = ""
    act: str = ""
    negative: bool = False
    alone: bool = False
    bare: bool = False
    watch: float = 0.5
    unheard: bool = False


def _stops(cause: str, within: float | None = None, why: str = "") -> Expected:
    return Expected(cause=cause, within=within, why=why)


def _goes_on(why: str, said: str = "") -> Expected:
    return Expected(harmless=why, said=said)


_LOST = "stale PDO|heartbeat lost|node booted"
_WATCHDOG = "skipped periods|0x8250|0x8130|drive fault|drive left operation enabled"

FAULTS: tuple[Fault, ...] = (
    Fault("power cycle of all nodes", _stops(_LOST), "power_cycle duration=0.3", watch=0.7),
    Fault("drive fault", _stops("drive fault|emergency"), "fault"),
    Fault("EMCY without a fault", _stops("emergency.*0x2310"), "emcy"),
    Fault("EMCY of the encoder", _stops("emergency.*joint encoder"), "emcy node=encoder"),
    Fault("TPDOs stuck", _stops("frozen|moved apart", LIE, SWING), "stuck_tpdo", watch=LIE),
    Fault("encoder's TPDOs stuck", _stops("moved apart", LIE, SWING), "stuck_tpdo node=encoder", watch=LIE),
    Fault("TPDOs 50 ms late", _stops("stale PDO"), "late_tpdo value=0.05"),
    Fault("TPDOs lost", _stops("stale PDO"), "missing_tpdo"),
    Fault("encoder's TPDOs lost", _stops("stale PDO.*joint encoder"), "missing_tpdo node=encoder"),
    Fault(
        "two of three TPDOs lost", _stops("stale PDO.*within a second", 0.5, "a fifth of a second's"),
        "sparse_tpdo value=2", watch=0.8,
    ),
    Fault("TPDOs of a wrong length", _stops("stale PDO.*wrong length"), "wrong_length"),
    Fault("another mode", _stops("wrong mode"), "wrong_mode"),
    Fault("command ignored, bit 12 low", _stops("ignores the command"), "ignored_command"),
    Fault("heartbeat of the drive lost", _stops("heartbeat lost.*drive"), "heartbeat_lost"),
    Fault("heartbeat of the encoder lost", _stops("heartbeat lost.*encoder"), "heartbeat_lost node=encoder"),
    Fault("commands (RPDOs) lost", _stops("0x8250|drive fault"), "rpdo_lost"),
    Fault("error frame: bus-off", _stops("bus fault"), "error_frame value=64"),
    Fault("interface down, up, stale frames", _stops("bus fault"), "interface_down duration=0.2", watch=0.7),
    Fault("second master sends SYNC", _stops("second master"), act="second_master"),
    Fault("second master sends commands", _stops("second master"), act="second_commander"),
    Fault("second master writes by SDO", _stops("second master"), "foreign_sdo"),
    Fault("torque offset of another tool", _stops("configuration changed.*0x60B2", 0.4, "read back"), "torque_offset"),
    Fault("a node is reset by somebody", _stops("second master|node booted"), act="reset_node"),
    Fault("joint encoder jumps", _stops("over-speed|moved apart"), "encoder_jump"),
    Fault(
        "motor turns the wrong way", _stops("wrong way round|joint torque sensor|moved apart", LIE, SWING),
        "reversed_sign", watch=LIE,
    ),
    Fault("motor gives twice its torque", _stops("joint torque sensor", LIE, SWING), "torque_gain", watch=LIE),
    Fault("tendon that pulls tears", _stops("over-speed|moved apart"), "torn_tendon value=1", watch=0.8),
    Fault(  # the loop tells such counts once a second
        "error frame: error passive", _goes_on("the bus still carries frames", "error frame"),
        "error_frame value=4", watch=1.2,
    ),
    Fault(
        "TPDOs 3 ms late", Expected("stale PDO", LIE, "if at all", "as old as after a tolerated loss"),
        "late_tpdo value=0.003 duration=0.4", watch=LIE,
    ),
    Fault("TPDOs sent twice", _stops("repeated PDOs"), "repeated_tpdo duration=0.4"),
    Fault(  # 0.1 s of frames at once: a bus that is full of them for three cycles carries no answers
        "stale TPDOs replayed",
        Expected("stale PDO", None, "if at all", "never taken for fresh", "(repeated|late) PDOs"),
        "replay value=0.1",
    ),
    Fault("flood of other identifiers", _goes_on("the kernel filters them"), "flood value=3000 duration=0.5"),
    Fault("torque sensor stuck", _goes_on("not used for control"), "torque_sensor_stuck"),
    Fault("slack: a tenth of the pretension", _goes_on("within the limits"), "slack duration=0.5"),
    Fault("drive's clock drifts by 1 %", _goes_on("a value is a period old"), "clock_drift duration=0.5"),
    Fault("socket flooded by 4 clients", _goes_on("another process serves them"), act="flood_socket"),
    Fault("client that hangs", _goes_on("another process serves them"), act="hanging_client"),
    Fault("hang: SIGSTOP for 0.5 s", _stops(_WATCHDOG), act="hang", watch=0.8),
    Fault(
        "terminal closed: SIGHUP", _stops("ended: SIGHUP", 0.55, "ramp of 0.3 s"),
        act="hang_up", alone=True, watch=2.5,
    ),
    Fault("the other tendon tears, pulling", _stops("over-speed|moved apart"), "torn_tendon value=0", negative=True),
    Fault(
        "disk full", _goes_on("the loss is counted", "No space left|File too large"),
        act="fill_disk", negative=True, watch=2.5,
    ),
    Fault("loop killed: SIGKILL", _stops("without a word"), act="kill", negative=True, alone=True, watch=0.8),
    Fault("no RPDO timer: SIGKILL", _stops("without a word"), act="kill", bare=True, alone=True, watch=0.8),
    Fault("no RPDO timer: SIGSTOP for 0.5 s", _stops(_WATCHDOG), act="hang", bare=True, watch=0.8),
    Fault(
        "no RPDO timer: commands lost", _stops("frozen|the drive reports|moved apart", LIE, SWING),
        "rpdo_lost", bare=True, watch=LIE,
    ),
    Fault(
        "log process killed", _goes_on("the loss is counted", "log: its process is gone"),
        act="kill_log", bare=True, watch=1.5,
    ),
    Fault(
        "socket process killed", _goes_on("a signal still ends it", "socket: its process is gone"),
        act="kill_server", bare=True, watch=1.5, unheard=True,
    ),
)  # fmt: skip
