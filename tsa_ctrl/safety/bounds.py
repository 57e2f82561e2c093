"""Find safety bounds that are looser than shipped, by a table of keys and the defaults of their sections."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import msgspec

Shipped = Mapping[tuple[str, str], float]  # by section and key

# Keys by section, each with its unit. A number is looser if it is larger (if its key is in `SMALLER`: smaller). A flag
# (unit "") is looser if it differs.
KEYS: Mapping[str, Mapping[str, str]] = {
    "controller": {"settle_cycles": "cycles", "stop_time": "s"},
    "realtime": {"allow_without": "", "lock_memory": ""},
    "bus": {"max_load": "1", "send_queue": "frames"},
    "bus.supervision": {
        "tolerated_misses": "cycles",
        "tolerated_drops": "cycles",
        "lost_share": "1",
        "enable_timeout": "s",
        "disable_timeout": "s",
        "reset_timeout": "s",
    },
    "safety": {"zero_torque_within": "s"},
    "axis.drive": {
        "host_timeout": "s",
        "rpdo_timeout": "s",
        "heartbeat_timeout": "s",
        "require_watchdog": "",
        "velocity_cutoff": "Hz",
    },
    "axis.encoder": {"heartbeat_timeout": "s", "velocity_cutoff": "Hz"},
    "axis.torque_sensor": {"heartbeat_timeout": "s"},
    "axis.setpoint": {"timeout": "s", "rate": "N*m/s"},
    "axis.direction": {"zone": "rad/s"},
    "axis.law": {"compensation": "1", "fade_in": "s", "settle": "1"},
    "axis.estimator": {
        "bounds": "1",
        "rate": "1/s",
        "least_speed": "rad/s",
        "settle": "s",
        "residual": "N*m",
        "most_acceleration": "rad/s^2",
    },
    "axis.serial": {"timeout": "s"},
    "axis.limits": {
        "torque": "N*m",
        "rate": "N*m/s",
        "joint_speed": "rad/s",
        "over_speed": "rad/s",
        "motor_over_speed": "rad/s",
        "travel": "rad",
        "travel_margin": "rad",
    },
    "axis.plausibility": {"torque": "N*m", "joint_torque": "N*m", "duration": "s", "slip": "rad"},
    "axis.passivity": {"energy": "J", "buzz": "N*m"},
}
# Keys that are looser if they are smaller: a slow filter hides the speed from its limit, torque begins earlier or ends
# more abruptly, more compensation stays at rest, and the estimator admits data of little meaning.
SMALLER = {"velocity_cutoff", "settle_cycles", "fade_in", "travel_margin", "settle", "least_speed"}
WORN_FACTOR = 2.0  # 1: class "worn" rejects a bound above this multiple of the shipped one


class Loose(NamedTuple):
    """A bound that is looser than shipped; `shipped` is NaN if the default follows from other settings."""

    section: str
    key: str
    value: float
    shipped: float
    unit: str

    @property
    def unfit_to_wear(self) -> bool:
        """Return True if class "worn" rejects the value."""
        if self.key in SMALLER:
            return not self.value >= self.shipped / WORN_FACTOR
        return not self.value <= WORN_FACTOR * self.shipped or self.unit == ""

    def __str__(self) -> str:
        if self.unit == "":
            return f"[{self.section}] {self.key} = {str(bool(self.value)).lower()}"
        shipped = f"shipped is {self.shipped:.4g}" if math.isfinite(self.shipped) else "shipped follows from the model"
        unit = "" if self.unit == "1" else f" {self.unit}"
        return f"[{self.section}] {self.key} {self.value:g}{unit} ({shipped})"


def loose_bounds(sections: Mapping[str, msgspec.Struct | None], shipped: Shipped) -> Iterator[Loose]:
    """Yield every bound that is looser than shipped.

    Args:
        sections: settings by table name, None for an absent table.
        shipped: shipped values that differ from the defaults of the settings classes.
    """
    for name, section in sections.items():
        if section is None:
            continue
        defaults = {field.encode_name: field.default for field in msgspec.structs.fields(section)}
        for key, unit in KEYS.get(name, {}).items():
            value = _size(getattr(section, key))
            default = shipped.get((name, key), _size(defaults[key]))
            if value is None:
                continue
            if unit == "" and value != default:
                yield Loose(name, key, value, math.nan, unit)
            elif default is None or _is_looser(key, value, default):
                yield Loose(name, key, value, math.nan if default is None else default, unit)


def _is_looser(key: str, value: float, default: float) -> bool:
    if key in SMALLER:
        return not value >= default * (1.0 - 1e-9)
    return not value <= default * (1.0 + 1e-9)


def _size(value: object) -> float | None:
    """Return a setting as one number. For a range this is the larger magnitude of its ends."""
    if isinstance(value, tuple):
        return max(abs(float(end)) for end in value)
    return float(value) if isinstance(value, int | float) else None
