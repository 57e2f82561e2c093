"""Joint torque as it arrives, for the guard: from its sensor, else from the tendons' stretch, else none."""

from __future__ import annotations

import math
from typing import Protocol

from tsa_ctrl.control.instruments import Instruments
from tsa_ctrl.observer.stretch import StretchObserver, StretchState


class Delivered(Protocol):
    """What the cycle asks of any kind: `torque` in N*m at the joint, nan while it is not known."""

    @property
    def known(self) -> bool: ...

    @property
    def torque(self) -> float: ...


class Sensed:
    """By the joint torque sensor; a value that is missing is passed over."""

    known = True

    def __init__(self, instruments: Instruments) -> None:
        self._instruments = instruments

    @property
    def torque(self) -> float:
        return self._instruments.tau_j


class Stretched:
    """By the angles of motor and joint and the motor torque, once the tendons have slid all along."""

    def __init__(self, observer: StretchObserver) -> None:
        self._observer = observer

    @property
    def known(self) -> bool:
        return self._observer.state is StretchState.TOLD

    @property
    def torque(self) -> float:
        return self._observer.torque if self.known else math.nan


class Unknown:
    """There is nothing that could say it."""

    known = False
    torque = math.nan


def delivered_of(instruments: Instruments, stretch: StretchObserver | None, has_sensor: bool) -> Delivered:
    """The best that an axis has."""
    if has_sensor:
        return Sensed(instruments)
    return Unknown() if stretch is None else Stretched(stretch)
