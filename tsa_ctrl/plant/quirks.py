"""What drives do otherwise than CiA 301 and 402 have it: keys of `[axis.drive]`, each met on a real stack.

The default of each is what the standard says; `absent`, `objects` and `read_only` imitate the rest.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

NonNegative = Annotated[float, Meta(ge=0.0)]
Code = Annotated[int, Meta(ge=0, le=0xFFFF)]
ObjectName = Annotated[str, Meta(pattern=r"^0x[0-9A-Fa-f]{4}(:[0-9]{1,3})?$")]
ModeName = Literal["pp", "pv", "tq", "csp", "csv", "cst"]


class Quirks(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Of one drive."""

    # its dictionary
    objects: dict[str, int] = {}  # other power-on values, "0x6072:0" = 500
    absent: list[int | ObjectName] = []  # objects that this drive does not have, 0x60A9 or "0x1400:5"
    read_only: list[ObjectName] = []  # objects that cannot be written, "0x6007"
    fixed_mapping: bool = False  # what its PDOs carry cannot be written; it is what this controller wants
    heartbeat_consumers: Annotated[int, Meta(ge=1, le=8)] = 4  # entries of 0x1016
    modes: tuple[ModeName, ...] = ("cst",)  # 0x6502, and what 0x6060 takes

    # its start
    boot_time: NonNegative = 0.0  # s from reset or power-on to the boot-up message
    starts_itself: bool = False  # operational at once after the boot-up
    emcy_at_boot: Code = 0  # error code of an EMCY right after the boot-up; 0: none
    answer_time: NonNegative = 0.0  # s until a request by SDO is answered
    node_id_unset: bool = False  # it has no node id until LSS gives it one
    sync_producer: bool = False  # 0x1005 has bit 30 at power-on: it sends SYNC itself, every 10 ms

    # its watchdogs
    watchdogs: bool = True  # false: it takes its time-outs, reports them, and does nothing else
    watches_always: bool = False  # 0x6007 = 1 taken literally: a lost heartbeat is a fault, enabled or not
    rpdo_timer_on_sync: bool = False  # the RPDO event timer is looked at only when a SYNC comes
    node_guarding: bool = False  # no heartbeat, made or heard: 0x100C, 0x100D and remote frames instead
    guarding_toggles: bool = True  # false: all answers to node guarding have one toggle bit

    # its commands
    delay_periods: Annotated[int, Meta(ge=0, le=8)] = 0  # SYNCs by which they act later than their RPDO's type says

    # its state machine
    mode_shows: Literal["written", "operational", "enabled"] = "written"  # when 0x6061 says what 0x6060 is; else 0
    step_time: NonNegative = 0.0  # s, of each step on the way to operation enabled
    statusword_bits: Code = 0  # of the maker's, always set: bits 8, 14, 15
    reports_following: bool = True  # false: bit 12 is always low
    safe_torque_off: bool = False  # the drive stays in switch on disabled, and says so by bit 4
    warns_when_enabled: Code = 0  # error code of an EMCY at every enable, without a fault; 0: none
