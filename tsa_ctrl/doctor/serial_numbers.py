"""The serial numbers of a configuration's drives, asked by SDO alone, and written into its file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import tomlkit

from tsa_ctrl.bus.canopen import objects
from tsa_ctrl.bus.drive.session import Session
from tsa_ctrl.bus.settings import AxisNodes, BusSettings
from tsa_ctrl.bus.wire.seam import Bus


def ask(bus: Bus, settings: BusSettings, axes: Sequence[AxisNodes]) -> dict[str, int | None]:
    """0x1018:4 of the drive of each axis, None where it has none; raises BusError when one does not answer."""
    found = {}
    with Session(bus, settings) as session:
        session.alone()
        for axis in axes:
            node_id = axis.drive.node_id
            session.read(node_id, objects.DEVICE_TYPE)
            found[axis.name] = session.read_if_there(node_id, objects.SERIAL_NUMBER)
    return found


def written(text: str, numbers: dict[str, int | None]) -> str:
    """A controller file's text with these serial numbers in its [axis.drive] tables; all else stays as it is."""
    document = tomlkit.parse(text)
    axes: Any = document["axis"]
    for axis in axes:
        number = numbers.get(axis["name"])
        if number is not None:
            axis["drive"]["serial_number"] = number
    return str(tomlkit.dumps(document))
