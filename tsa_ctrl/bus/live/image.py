"""Process image of one axis: the latest values of its nodes in SI units. Only the rig writes it."""

from __future__ import annotations

import math

from tsa_ctrl.bus.canopen.cia301 import Emcy, NmtState
from tsa_ctrl.bus.settings import Role
from tsa_ctrl.bus.wire.bus import BusFault
from tsa_ctrl.system.realtime import Overruns


class NodeHealth:
    """Health of one node: its heartbeat, boot-ups and emergencies, and the arrival of its PDOs."""

    __slots__ = (
        "boot_ups",
        "emcy",
        "emcys",
        "heard",
        "late",
        "malformed",
        "missed",
        "misses",
        "nmt_state",
        "node_id",
        "repeated",
        "role",
        "timeout",
        "told",
        "untoggled",
        "warning",
        "warnings",
    )

    def __init__(self, role: Role, node_id: int, timeout: float) -> None:
        self.role = role
        self.node_id = node_id
        self.timeout = timeout  # s without a heartbeat
        self.heard = 0.0  # s, monotonic time of the last heartbeat
        self.nmt_state: int = NmtState.OPERATIONAL
        self.boot_ups = 0
        self.emcys = 0  # emergencies other than "error reset"
        self.emcy: Emcy | None = None  # the last of them
        self.told: frozenset[int] = frozenset()  # codes of emergencies that are reported without a stop
        self.warnings = 0  # number of these emergencies
        self.warning: Emcy | None = None  # the last of these emergencies
        self.untoggled = 0  # answers to node guarding with a repeated toggle bit
        self.misses = 0  # cycles in a row without all its PDOs
        self.missed = 0  # cycles without all its PDOs
        self.late = 0  # PDOs that arrived after their cycle's deadline
        self.repeated = 0  # PDOs that arrived twice in a cycle
        self.malformed = 0  # PDOs, heartbeats and emergencies of a wrong length

    def __str__(self) -> str:
        return f"{self.role.value} node {self.node_id}"


class Image:
    """Latest values of one axis in SI units. A value is nan until it has been received once."""

    __slots__ = (
        "altered",
        "bus_fault",
        "dropped",
        "drops",
        "error_code",
        "events",
        "fresh",
        "intruder",
        "joint_fresh",
        "missed",
        "misses",
        "mode",
        "nodes",
        "now",
        "omega_j",
        "omega_m",
        "overruns",
        "pdo_age",
        "pressed",
        "q_j",
        "q_m",
        "silent",
        "skipped",
        "statusword",
        "tau_j",
        "tau_m",
    )

    def __init__(self, nodes: tuple[NodeHealth, ...]) -> None:
        self.nodes = nodes  # the drive first
        self.statusword = 0  # 0x6041
        self.mode = 0  # 0x6061
        self.error_code = 0  # 0x603F
        self.tau_m = math.nan  # N*m, reported by the drive, at the motor pulley
        self.q_m = math.nan  # rad, motor pulley
        self.omega_m = math.nan  # rad/s, motor pulley
        self.q_j = math.nan  # rad, joint
        self.omega_j = math.nan  # rad/s, joint; filtered, see EncoderSettings.velocity_cutoff
        self.tau_j = math.nan  # N*m, torque sensor
        self.now = 0.0  # s, monotonic time of the last SYNC
        self.fresh = False  # all PDOs of drive and encoder that answer this cycle's SYNC have arrived
        self.joint_fresh = False  # the encoder's PDO has arrived
        self.misses = 0  # cycles in a row in which `fresh` was False
        self.missed = 0  # such cycles since startup
        self.pdo_age = math.inf  # s, age of the values at the last SYNC; 0 if fresh
        self.drops = 0  # commands in a row that could not be sent
        self.dropped = 0  # such commands since startup
        self.skipped = 0  # periods since startup without a cycle, because the loop was late
        self.overruns = Overruns()  # of the loop, the same for all axes
        self.events = 0  # counts emergencies, boot-ups and changes of NMT state of all nodes
        self.silent: NodeHealth | None = None  # a node whose heartbeat is overdue
        self.intruder: int | None = None  # identifier of a frame that only a second master would send
        self.altered: str | None = None  # objects of a node that no longer have the written value
        self.pressed: str | None = None  # the emergency stop at the drive: pressed, or its state is unknown
        self.bus_fault: BusFault | None = None

    @property
    def repeated(self) -> int:
        """Return the number of PDOs of all nodes that arrived twice in a cycle."""
        count = 0
        for node in self.nodes:
            count += node.repeated
        return count

    @property
    def late(self) -> int:
        """Return the number of PDOs of all nodes that arrived after their cycle's deadline."""
        return sum(node.late for node in self.nodes)

    @property
    def malformed(self) -> int:
        """Return the number of frames of all nodes with a wrong length."""
        return sum(node.malformed for node in self.nodes)

    @property
    def emcy(self) -> Emcy | None:
        """Return the last emergency of the first node that sent one; the drive comes first."""
        return next((node.emcy for node in self.nodes if node.emcy is not None), None)
