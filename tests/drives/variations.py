"""Variations of drives as data: keys of the plant's [axis.drive], the remedy, and the required result."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

Keys = dict[str, Any]


@dataclass(frozen=True)
class Variation:
    """A drive, its configuration and the required result.

    `quirks`: keys of the plant's [axis.drive].
    `profile`: keys of the profile.
    `drive`, `supervision`: keys of the controller's [axis.drive] and [bus.supervision].
    `refused`: required part of the error if the start is rejected.
    `told`: required part of an event if the drive runs.
    """

    name: str
    quirks: Keys = field(default_factory=dict)
    profile: Keys = field(default_factory=dict)
    drive: Keys = field(default_factory=dict)
    supervision: Keys = field(default_factory=dict)
    refused: str = ""
    told: str = ""
    kind: str = ""  # name of a shipped profile that replaces `profile`
    rate: float = 250.0  # Hz


def _objects(**values: int) -> Keys:
    """Return keys that change power-on values: `_objects(x1019_0=10)` changes 0x1019:0."""
    return {"objects": {f"0x{key[1:].replace('_', ':')}": value for key, value in values.items()}}


_EPOS4, _ELMO = {"kind": "epos4"}, {"kind": "elmo_gold"}
_LATE = 'mode_shows = "operational" or "enabled"'
_CANNOT = "cannot be written; its"

VARIATIONS: tuple[Variation, ...] = (
    Variation("CiA 402 to the letter"),
    Variation("EPOS4", _EPOS4, kind="epos4"),
    Variation("EPOS4 at 100 Hz: 0x60C2 in whole milliseconds", _EPOS4, kind="epos4", rate=100.0),
    Variation("Elmo Gold", _ELMO, kind="elmo_gold"),
    Variation("Technosoft iPOS", {"kind": "technosoft_ipos"}, drive={"max_torque": 2.0}, kind="technosoft_ipos"),
    Variation("Kinco", {"kind": "kinco"}, kind="kinco"),
    Variation("Nanotec", {"kind": "nanotec"}, kind="nanotec"),
    Variation("Copley", {"kind": "copley"}, kind="copley"),
    Variation("Ingenia Summit 1.8.1", {"kind": "ingenia"}, kind="ingenia", refused="lack cyclic synchronous torque"),
    Variation("EPOS4 under no profile", _EPOS4, refused="a factor of 1000"),
    Variation("Elmo Gold under no profile", _ELMO, refused='absent = ["SI unit velocity"]'),
    # missing objects
    Variation("no 0x6502", {"absent": [0x6502]}, told="does not report its supported modes"),
    Variation(
        "no optional object",
        {"absent": [0x1006, 0x1007, 0x1014, 0x1019, 0x1029, 0x605A, 0x605B, 0x605C, 0x605D, 0x605E, 0x60B0, 0x60B1,
                    0x60B2, 0x60C2]},
    ),
    Variation("no 0x603F", {"absent": [0x603F]}, refused='absent = ["error code"]'),
    Variation("no 0x603F, and the profile says so", {"absent": [0x603F]}, {"absent": ["error code"]}),
    Variation("no RPDO event timer", {"absent": ["0x1400:5"]}),
    Variation("no heartbeat consumer", {"absent": [0x1016]}),
    Variation("no watchdog at all", {"absent": [0x1016, "0x1400:5"]}, refused="require_watchdog = false"),
    Variation(
        "no watchdog at all, accepted", {"absent": [0x1016, "0x1400:5"]}, drive={"require_watchdog": False},
        told="would keep running if this computer fails",
    ),
    Variation("no 0x6007", {"absent": [0x6007]}, refused="require_watchdog = false"),
    Variation("no 0x6072", {"absent": [0x6072]}, refused="[torque_clamp]"),
    Variation("no 0x6080", {"absent": [0x6080]}, refused='absent = ["max motor speed"]'),
    Variation("no 0x60A9", {"absent": [0x60A9]}, refused='absent = ["SI unit velocity"]'),
    Variation("no 0x60A9, speed from position", {"absent": [0x60A9]}, drive={"velocity_source": "position"}),
    Variation("two PDOs each way", {"absent": [0x1402, 0x1403, 0x1802, 0x1803]}),
    # read-only objects
    Variation("reactions read-only, ending without torque", {"read_only": ["0x605A", "0x605E"]}, told=_CANNOT),
    Variation("0x60C2 read-only", {"read_only": ["0x60C2"]}, refused="a rate in [controller]"),
    Variation(
        "fault reaction read-only, the maker's own", {"read_only": ["0x605E"], **_objects(x605E_0=-1)},
        refused='fault = "keep"',
    ),
    Variation("0x6007 read-only: nothing", {"read_only": ["0x6007"], **_objects(x6007_0=0)}, refused="absent ="),
    Variation("0x6007 read-only: quick stop", {"read_only": ["0x6007"], **_objects(x6007_0=3)}, told=_CANNOT),
    Variation("0x1016 read-only", {"read_only": ["0x1016"]}, refused='absent = ["heartbeat consumer"]'),
    Variation("0x1400:5 read-only", {"read_only": ["0x1400:5"]}, refused='absent = ["RPDO event timer"]'),
    Variation("0x1014 read-only, another identifier", {"read_only": ["0x1014"], **_objects(x1014_0=0x91)},
              refused='absent = ["EMCY COB-ID"]'),
    Variation("mapping fixed, as wanted", {"fixed_mapping": True}),
    Variation("mapping fixed, another", {"read_only": ["0x1600", "0x1A00"]}, refused="with the maker's tool"),
    # values left by another tool; tests/drives/test_torque_path.py has those that act on the torque
    Variation(
        "SYNC, heartbeat consumer, EMCY and mode left",
        _objects(x1019_0=10, x1006_0=5000, x1007_0=100, x1014_0=0x91, x1015_0=5000, x1016_1=0x0503E8, x6060_0=10,
                 x60B2_0=120),
    ),
    Variation("heartbeat consumer of ours in entry 2, EMCYs off", _objects(x1016_2=0x7F0064, x1014_0=0x80000081)),
    Variation("one entry of 0x1016", {"heartbeat_consumers": 1}),
    Variation("makes SYNC itself", {"sync_producer": True}, refused="produces_sync = true"),
    Variation("makes SYNC itself, and the profile says so", {"sync_producer": True}, {"produces_sync": True}),
    # startup
    Variation("boots after 2.5 s", {"boot_time": 2.5}),
    Variation("boots after 3.5 s", {"boot_time": 3.5}, refused="increase boot_timeout"),
    Variation("boots after 3.5 s, and the profile says so", {"boot_time": 3.5}, {"boot_timeout": 5.0}),
    Variation("answers SDO after 0.4 s", {"answer_time": 0.4}),
    Variation("answers SDO after 0.7 s", {"answer_time": 0.7}, refused="answer_timeout"),
    Variation("EMCY at boot", {"emcy_at_boot": 0x8100}, told="reported during the bring-up: EMCY 0x8100"),
    Variation("starts itself", {"starts_itself": True}),
    Variation("several axes, device type 0xFFFF0192", _objects(x1000_0=0xFFFF0192)),
    Variation("several axes, device type 0x0000FFFF", _objects(x1000_0=0x0000FFFF)),
    Variation("another kind of device", _objects(x1000_0=0x00020191), refused="correct node_id"),
    Variation("another vendor", {"vendor": 0x9A}, drive={"vendor_id": 0x0F0F}, refused="correct node_id, vendor_id"),
    Variation("another serial number", {"serial_number": 5}, drive={"serial_number": 6}, refused="serial_number"),
    Variation("no node id", {"node_id_unset": True}, refused="node_id"),
    Variation("rated torque in uN*m", {"rated_torque_unit": 1e-6}, refused="[units] rated_torque"),
    Variation("position and velocity modes only", {"modes": ["csp", "csv"]}, refused="commands torque"),
    # state machine
    Variation("mode shows once operational", {"mode_shows": "operational"}, refused=_LATE),
    Variation(
        "mode shows once operational, and the profile says so", {"mode_shows": "operational"},
        {"mode_shows": "operational"},
    ),
    Variation("mode shows once enabled", {"mode_shows": "enabled"}, refused=_LATE),
    Variation(
        "mode shows once enabled, and the profile says so", {"mode_shows": "enabled"}, {"mode_shows": "enabled"}
    ),
    Variation("steps of 0.4 s", {"step_time": 0.4}),
    Variation("steps of 1.5 s", {"step_time": 1.5}, refused="raise enable_timeout"),
    Variation("steps of 1.5 s, more patience", {"step_time": 1.5}, supervision={"enable_timeout": 6.0}),
    Variation("bits of the maker in the statusword", {"statusword_bits": 0xC100}),
    Variation("no bit 12", {"reports_following": False}, refused="reports_following = false"),
    Variation(
        "no bit 12, and the profile says so", {"reports_following": False}, {"reports_following": False}
    ),
    Variation("safe torque off", {"safe_torque_off": True}, refused="safe torque off"),
    Variation("warns by EMCY at each enable", {"warns_when_enabled": 0x2310}, refused="warnings = [0x2310]"),
    Variation(
        "warns by EMCY at each enable, and the profile says so", {"warns_when_enabled": 0x2310}, {"warnings": [0x2310]},
        told="warning of drive node 1",
    ),
    Variation("commands act two periods later", {"delay_periods": 2}),
    # watchdogs
    Variation("0x6007 = 1 to the letter", {"watches_always": True}),
    Variation("RPDO timer looked at on SYNC", {"rpdo_timer_on_sync": True}),
    Variation("watchdogs that only report", {"watchdogs": False}),
    Variation("node guarding, no heartbeat", {"node_guarding": True}, refused='supervision = "guarding"'),
    Variation("node guarding, and the profile says so", {"node_guarding": True}, {"supervision": "guarding"}),
    Variation(
        "node guarding without a toggle bit", {"node_guarding": True, "guarding_toggles": False},
        {"supervision": "guarding"}, refused="repeated their toggle bit",
    ),
    Variation(
        "node guarding to the letter", {"node_guarding": True, "watches_always": True}, {"supervision": "guarding"}
    ),
)  # fmt: skip
