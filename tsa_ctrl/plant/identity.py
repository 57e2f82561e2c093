"""What a node says of itself, and its objects of communication (CiA 301, 0x1000 to 0x1029) but for the PDOs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from tsa_ctrl.plant import emergency, storage, sync
from tsa_ctrl.plant.dictionary import Access, Entry, Type
from tsa_ctrl.plant.quirks import Quirks
from tsa_ctrl.plant.watch import Consumers, Guarding


@dataclass(frozen=True, slots=True)
class Identity:
    """0x1000, 0x1008 and 0x1018 of a node."""

    device_type: int
    name: str
    vendor: int = 0x00000F0F
    product: int = 0
    revision: int = 0x00010000
    serial: int = 1

    @property
    def numbers(self) -> tuple[int, int, int, int]:
        """0x1018:1 to :4."""
        return self.vendor, self.product, self.revision, self.serial


def communication_objects(identity: Identity, quirks: Quirks) -> Iterator[Entry]:
    """0x1000 to 0x1029 of a node, by what is particular to it."""
    yield Entry(0x1000, 0, Type.U32, Access.CONST, identity.device_type)
    yield from emergency.entries()
    yield from sync.entries(quirks.sync_producer)
    yield Entry(0x1008, 0, Type.TEXT, Access.CONST, identity.name)
    yield Entry(0x1009, 0, Type.TEXT, Access.CONST, "simulated")
    yield Entry(0x100A, 0, Type.TEXT, Access.CONST, "1")
    yield from storage.entries()
    if quirks.node_guarding:
        yield from Guarding.objects()
    else:
        yield from Consumers.objects(quirks.heartbeat_consumers)
        yield Entry(0x1017, 0, Type.U16)
    yield Entry(0x1018, 0, Type.U8, Access.CONST, 4)
    for sub, value in enumerate(identity.numbers, 1):
        yield Entry(0x1018, sub, Type.U32, Access.CONST, value)
    yield Entry(0x1029, 0, Type.U8, Access.CONST, 1)
    yield Entry(0x1029, 1, Type.U8, default=0, high=2)
