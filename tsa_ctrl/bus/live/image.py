"""Process image of one axis: the latest values of its nodes in SI units. Only the rig writes it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from tsa_ctrl.bus.canopen.cia301 import Emcy, NmtState
from tsa_ctrl.bus.settings import Role
from tsa_ctrl.bus.wire.bus import BusFault
from tsa_ctrl.system.realtime import Overruns


@dataclass(slots=True, eq=False)
class NodeHealth:
    """Health of one node: its heartbeat, boot-ups and emergencies, and the arrival of its PDOs."""

    role: Role
    node_id: int
    timeout: float  # s without a heartbeat
    heard: float = 0.0  # s, monotonic time of the last heartbeat
    nmt_state: int = NmtState.OPERATIONAL
    boot_ups: int = 0
    emcys: int = 0  # emergencies other than "error reset"
    emcy: Emcy | None = None  # the last of them
    told: frozenset[int] = frozenset()  # codes of emergencies that are reported without a stop
    warnings: int = 0  # number of these emergencies
    warning: Emcy | None = None  # the last of these emergencies
    untoggled: int = 0  # answers to node guarding with a repeated toggle bit
    misses: int = 0  # cycles in a row without all its PDOs
    missed: int = 0  # cycles without all its PDOs
    late: int = 0  # PDOs that arrived after their cycle's deadline
    repeated: int = 0  # PDOs that arrived twice in a cycle
    malformed: int = 0  # PDOs, heartbeats and emergencies of a wrong length

    def __str__(self) -> str:
        return f"{self.role.value} node {self.node_id}"


@dataclass(slots=True, eq=False)
class Image:
    """Latest values of one axis in SI units. A value is nan until it has been received once."""

    nodes: tuple[NodeHealth, ...]  # the drive first
    statusword: int = 0  # 0x6041
    mode: int = 0  # 0x6061
    error_code: int = 0  # 0x603F
    tau_m: float = math.nan  # N*m, reported by the drive, at the motor pulley
    q_m: float = math.nan  # rad, motor pulley
    omega_m: float = math.nan  # rad/s, motor pulley
    q_j: float = math.nan  # rad, joint
    omega_j: float = math.nan  # rad/s, joint; filtered, see EncoderSettings.velocity_cutoff
    tau_j: float = math.nan  # N*m, torque sensor
    now: float = 0.0  # s, monotonic time of the last SYNC
    fresh: bool = False  # all PDOs of drive and encoder that answer this cycle's SYNC have arrived
    joint_fresh: bool = False  # the encoder's PDO has arrived
    misses: int = 0  # cycles in a row in which `fresh` was False
    missed: int = 0  # such cycles since startup
    pdo_age: float = math.inf  # s, age of the values at the last SYNC; 0 if fresh
    drops: int = 0  # commands in a row that could not be sent
    dropped: int = 0  # such commands since startup
    skipped: int = 0  # periods since startup without a cycle, because the loop was late
    overruns: Overruns = field(default_factory=Overruns)  # of the loop, the same for all axes
    events: int = 0  # counts emergencies, boot-ups and changes of NMT state of all nodes
    silent: NodeHealth | None = None  # a node whose heartbeat is overdue
    intruder: int | None = None  # identifier of a frame that only a second master would send
    altered: str | None = None  # objects of a node that no longer have the written value
    pressed: str | None = None  # the emergency stop at the drive: pressed, or its state is unknown
    bus_fault: BusFault | None = None

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
