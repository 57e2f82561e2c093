"""The sheath's bending angle Theta while the loop runs: fixed, commanded, measured, or a linear map of joint angles.

Theta = offset + sum over axes of gain_i q_i        (rad; a sheath that crosses several joints has several gains)
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

Angle = Annotated[float, Meta(ge=0.0, le=100.0)]  # rad; larger is in degrees


class BendingSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[axis.bending]."""

    source: Literal["fixed", "command", "joints", "sensor"] = "fixed"
    offset: Angle | None = None  # rad, Theta with all joints at 0; default: the model file's bending_angle
    gains: dict[str, Annotated[float, Meta(ge=-10.0, le=10.0)]] = {}  # rad/rad by axis name
    range: Annotated[float, Meta(ge=0.0, le=0.9)] = 0.0  # 1, either way, by which the sheath may bend otherwise unseen

    def __post_init__(self) -> None:
        if (self.source == "joints") != bool(self.gains):
            raise ValueError(
                f'source "{self.source}" with {len(self.gains)} gains; '
                'gains (rad/rad by axis name) belong to source "joints", which needs at least one'
            )
        if self.source in ("fixed", "sensor") and self.offset is not None:
            whence = "the model file" if self.source == "fixed" else "its sensor"
            raise ValueError(f'source "{self.source}" takes the angle from {whence}; remove offset, or change source')


class Bending:
    """Theta of one axis' sheaths; `commanded` is what the user says it is (rad)."""

    def __init__(self, settings: BendingSettings, nominal: float) -> None:
        """`nominal` is the model file's bending angle, rad."""
        self.settable = settings.source in ("command", "joints")
        self.fixed = settings.source == "fixed"
        self.commanded = nominal if settings.offset is None else settings.offset
        self._terms: tuple[tuple[float, Callable[[], float]], ...] = ()
        self._measured: Callable[[], float] | None = None

    def connect(self, terms: tuple[tuple[float, Callable[[], float]], ...]) -> None:
        """Give the gains and what reads the joint angle of each (rad)."""
        self._terms = terms

    def measure(self, read: Callable[[], float]) -> None:
        """Take the angle (rad) from a sensor; nan while it says nothing."""
        self._measured = read

    def update(self) -> float:
        """Theta now, rad, never below 0; nan when it is not known: fixed by the model, or a measurement is missing."""
        if self.fixed:
            return math.nan
        theta = self.commanded if self._measured is None else self._measured()
        for gain, angle in self._terms:
            theta += gain * angle()
        return theta if theta >= 0.0 or theta != theta else 0.0
