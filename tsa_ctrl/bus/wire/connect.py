"""Open the bus that the settings name."""

from __future__ import annotations

from tsa_ctrl.bus.settings import BusSettings
from tsa_ctrl.bus.wire import link as interface
from tsa_ctrl.bus.wire.seam import Bus
from tsa_ctrl.bus.wire.socketcan import SocketCan
from tsa_ctrl.errors import UsageError


def open_bus(settings: BusSettings) -> Bus:
    """A raw socket for "socketcan", python-can for everything else; raises BusError when it is not ready."""
    if settings.interface == "socketcan":
        if settings.options:
            raise UsageError(
                f'[bus] options: {", ".join(settings.options)} mean nothing to interface "socketcan"; remove them '
                "(the bit rate of a SocketCAN interface is set with 'ip link')"
            )
        bus = SocketCan(settings.channel, settings.send_queue)
        try:
            interface.check(settings.channel, settings.bitrate)
        except BaseException:
            bus.close()
            raise
        return bus
    from tsa_ctrl.bus.wire.python_can import PythonCan  # python-can is slow to import, and not needed on a raw socket

    return PythonCan(settings.interface, settings.channel, settings.bitrate, settings.options)
