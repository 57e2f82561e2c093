"""Nodes with an SDO server on python-can's in-process bus (canopen's LocalNode), for tests of the bring-up.

Their object dictionaries are literal numbers and use no code of the package.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import contextmanager

import canopen
from canopen.objectdictionary import ODRecord, ODVariable

from tsa_ctrl.bus.wire.python_can import PythonCan

U8, U16, U32, I8, I16, I32 = 0x05, 0x06, 0x07, 0x02, 0x03, 0x04
_channels = itertools.count()

Dictionary = dict[tuple[int, int], tuple[int, int]]  # (index, subindex) -> (data type, value)


def _pdo(index: int, cob_id: int, entries: int = 8) -> Dictionary:
    """Return the communication and mapping parameters of one PDO."""
    mapping = index + 0x200
    return {
        (index, 0): (U8, 5),
        (index, 1): (U32, cob_id),
        (index, 2): (U8, 254),
        (index, 3): (U16, 0),
        (index, 5): (U16, 0),
        (mapping, 0): (U8, 0),
        **{(mapping, number): (U32, 0) for number in range(1, entries + 1)},
    }


def _base(node_id: int, device_type: int, product: int) -> Dictionary:
    return {
        (0x1000, 0): (U32, device_type),
        (0x1001, 0): (U8, 0),
        (0x1003, 0): (U8, 0),
        (0x1003, 1): (U32, 0),
        (0x1005, 0): (U32, 0x80),
        (0x1016, 0): (U8, 1),
        (0x1016, 1): (U32, 0),
        (0x1017, 0): (U16, 0),
        (0x1018, 0): (U8, 4),
        (0x1018, 1): (U32, 0x0F0F),
        (0x1018, 2): (U32, product),
        (0x1018, 3): (U32, 1),
        (0x1018, 4): (U32, 7),
        (0x1029, 0): (U8, 1),
        (0x1029, 1): (U8, 1),
    }


def drive(node_id: int = 1) -> Dictionary:
    """Return a CiA 402 drive in "switch on disabled" with a rated torque of 1 N*m, in units of mN*m."""
    return {
        **_base(node_id, 0x00020192, 0x0402),
        **_pdo(0x1400, 0x200 + node_id),
        **_pdo(0x1401, 0x300 + node_id),
        **_pdo(0x1800, 0x40000180 + node_id),
        **_pdo(0x1801, 0x40000280 + node_id),
        **_pdo(0x1802, 0x40000380 + node_id),
        (0x6007, 0): (I16, 0),
        (0x603F, 0): (U16, 0),
        (0x6040, 0): (U16, 0),
        (0x6041, 0): (U16, 0x0240),
        (0x605A, 0): (I16, 2),
        (0x605B, 0): (I16, 1),
        (0x605C, 0): (I16, 1),
        (0x605E, 0): (I16, 2),
        (0x6060, 0): (I8, 0),
        (0x6061, 0): (I8, 0),
        (0x6071, 0): (I16, 0),
        (0x6072, 0): (U16, 3000),
        (0x6076, 0): (U32, 1000),
        (0x6080, 0): (U32, 10000),
        (0x60A9, 0): (U32, 0x00B44700),
        (0x60B2, 0): (I16, 120),  # per mille of the rated torque, previously written by another tool
        (0x60E0, 0): (U16, 400),
        (0x60C2, 0): (U8, 2),
        (0x60C2, 1): (U8, 2),
        (0x60C2, 2): (I8, -3),
        (0x6502, 0): (U32, 0x3ED),
    }


def encoder(node_id: int = 32) -> Dictionary:
    """Return a CiA 406 encoder with 2^20 counts per revolution."""
    return {
        **_base(node_id, 0x00020196, 0x0406),
        **_pdo(0x1800, 0x40000180 + node_id),
        **_pdo(0x1801, 0x40000280 + node_id),
        (0x6001, 0): (U32, 1 << 20),
    }


def torque_sensor(node_id: int = 64) -> Dictionary:
    """Return a CiA 404 torque sensor."""
    return {**_base(node_id, 0x00020194, 0x0404), **_pdo(0x1800, 0x40000180 + node_id)}


class Bench:
    """Nodes on a separate bus, and the master's end of that bus.

    `written` lists all SDO writes and `commands` all received NMT commands.
    """

    def __init__(self, dictionaries: dict[int, Dictionary]) -> None:
        channel = f"bench-{next(_channels)}"
        self.bus = PythonCan("virtual", channel, 1_000_000)
        self.network = canopen.Network()
        self.network.NOTIFIER_CYCLE = 0.02
        self.network.connect(interface="virtual", channel=channel)
        self.written: list[tuple[int, int, int, bytes]] = []  # (node, index, subindex, data) in order of arrival
        self.commands: list[bytes] = []
        self.nodes = {node_id: self._add(node_id, entries) for node_id, entries in dictionaries.items()}
        self.network.subscribe(0, self._on_nmt)

    def _add(self, node_id: int, entries: Dictionary) -> canopen.LocalNode:
        dictionary = canopen.ObjectDictionary()
        for index in sorted({key[0] for key in entries}):
            members = {key[1]: value for key, value in entries.items() if key[0] == index}
            variables = []
            for subindex, (data_type, value) in members.items():
                variable = ODVariable(f"{index:04X}.{subindex}", index, subindex)
                variable.data_type = data_type
                variable.default = value
                variable.access_type = "rw"
                variables.append(variable)
            if list(members) == [0]:
                dictionary.add_object(variables[0])
                continue
            record = ODRecord(f"{index:04X}", index)
            for variable in variables:
                record.add_member(variable)
            dictionary.add_object(record)
        node = self.network.create_node(node_id, dictionary)
        node.add_write_callback(lambda index, subindex, od, data: self._on_write(node_id, index, subindex, data))
        return node

    def get(self, node_id: int, index: int, subindex: int = 0) -> int:
        """Return the raw unsigned value of an object in a node."""
        return int.from_bytes(self.nodes[node_id].get_data(index, subindex), "little")

    def _on_write(self, node_id: int, index: int, subindex: int, data: bytes) -> None:
        self.written.append((node_id, index, subindex, bytes(data)))
        if index == 0x6060 and (0x6061 in self.nodes[node_id].object_dictionary):
            self.nodes[node_id].data_store.setdefault(0x6061, {})[0] = bytes(data)

    def _on_nmt(self, can_id: int, data: bytearray, timestamp: float) -> None:
        command, target = bytes(data)
        self.commands.append(bytes(data))
        node = self.nodes.get(target)
        if node is None:
            return
        if command == 0x82:
            self.network.send_message(0x700 + target, b"\x00")
        elif command == 0x01:
            self.network.send_message(0x700 + target, b"\x05")

    def close(self) -> None:
        assert self.network.notifier is not None
        self.network.notifier.stop()  # no heartbeat is started after this
        for node in self.nodes.values():
            task = node.nmt._send_task
            node.nmt.stop_heartbeat()
            if task is not None:
                task._task.thread.join()  # the thread may still have a heartbeat to send
        self.network.disconnect()
        self.bus.close()


@contextmanager
def bench(**changes: Dictionary) -> Iterator[Bench]:
    """Yield drive 1, encoder 32 and torque sensor 64.

    The arguments `drive`, `encoder` and `torque_sensor` change or add objects.
    """
    nodes = {1: drive(), 32: encoder(), 64: torque_sensor()}
    for node_id, name in ((1, "drive"), (32, "encoder"), (64, "torque_sensor")):
        nodes[node_id].update(changes.get(name, {}))
    made = Bench(nodes)
    try:
        yield made
    finally:
        made.close()
