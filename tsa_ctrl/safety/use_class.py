"""The class of use: a rig on a bench, or a joint that a person wears."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

UseClass = Literal["bench", "worn"]
FASTEST_WEARER = 20.0  # rad/s; a sprinter's knee reaches about 20, gait 7


class SafetySettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[safety]: the class of use, the wearer, and the requirements of `tsa verify-safety` and the fault campaign."""

    use_class: UseClass = msgspec.field(name="class", default="bench")
    # rad/s of the joint, fastest motion of the wearer; the speed limits follow from it
    wearer_speed: Annotated[float, Meta(gt=0.0, le=FASTEST_WEARER)] | None = None
    travel: tuple[float, float] | None = None  # rad of every joint; [axis.limits] travel narrows it for one axis
    emergency_stop: Annotated[int, Meta(ge=0, le=31)] | None = None  # bit of 0x60FD that is 1 while the stop is pressed
    zero_torque_within: Annotated[float, Meta(ge=0.005, le=20.0)] | None = (
        None  # s; default: longest of what a fault takes + 0.05
    )
    torque: Annotated[float, Meta(gt=0.0, le=1000.0)] | None = None  # N*m at the motor; default: 0.1 of rated torque

    def __post_init__(self) -> None:
        if self.travel is not None and self.travel[0] >= self.travel[1]:
            raise ValueError(f"travel {list(self.travel)} rad is empty; give [lower, upper]")

    @property
    def worn(self) -> bool:
        """Return True if a person wears the joint."""
        return self.use_class == "worn"
