"""The settings of a sensor on a serial line: port, how a line is read, and when its value is too old or cannot be."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from tsa_ctrl.errors import UsageError

NUMBER = r"^\s*(?P<value>[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?)\s*$"


class SerialSensorSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """One sensor: a line of text that matches `pattern` gives value * scale + offset in SI units."""

    port: str  # device, or a URL of pyserial
    # N*m at the joint; N of tendon a, b at the motor; rad and degC of the sheath
    quantity: Literal["tau_j", "t1", "t3", "theta", "temperature"]
    baud_rate: Annotated[int, Meta(ge=50, le=12_000_000)] = 115_200
    pattern: str = NUMBER  # regular expression with a group "value" (and optionally "unit")
    unit: str = ""  # if given, the pattern's group "unit" must match it
    scale: float = 1.0  # SI per unit of the line; negative turns the sign
    offset: float = 0.0  # SI, added
    low: float = -1e4  # SI: a value outside is a fault of the line, dropped and counted
    high: float = 1e4
    request: str = ""  # sent for each value, for sensors that are asked
    rate: Annotated[float, Meta(gt=0.0, le=10_000.0)] = 100.0  # rate of requests and of expected answers, Hz
    timeout: Annotated[float, Meta(gt=0.0, le=10.0)] = 0.1  # s; an older value counts as not there


def check(settings: SerialSensorSettings, where: str) -> None:
    """Raise UsageError when a setting contradicts another or the pattern cannot give a value."""
    try:
        groups = re.compile(settings.pattern).groupindex
    except re.error as error:
        raise UsageError(
            f"{where}: pattern '{settings.pattern}' is not a regular expression ({error}); correct it"
        ) from None
    if "value" not in groups:
        raise UsageError(
            f"{where}: pattern '{settings.pattern}' has no group 'value'; write (?P<value>...) around the number"
        )
    if settings.unit and "unit" not in groups:
        raise UsageError(f"{where}: unit '{settings.unit}' is asked for, but the pattern has no group 'unit'; add one")
    if settings.scale == 0.0:
        raise UsageError(f"{where}: scale is 0; give SI units per unit of the line")
    if settings.low >= settings.high:
        raise UsageError(f"{where}: low {settings.low:g} is not below high {settings.high:g}; correct one")
    if settings.timeout < 1.0 / settings.rate:
        raise UsageError(
            f"{where}: timeout {settings.timeout:g} s is shorter than the time between two values at "
            f"{settings.rate:g} Hz; raise it, or correct rate"
        )


def check_all(sensors: Sequence[SerialSensorSettings], where: str, measured: set[str]) -> None:
    """Check each sensor, and that no quantity has two sources; `measured`: those that another sensor measures.

    Raises:
        UsageError: a sensor is wrong, or two of them share a quantity or a port.
    """
    seen, ports = set(measured), set[str]()
    for sensor in sensors:
        here = f"{where}: serial {sensor.quantity}"
        check(sensor, here)
        if sensor.quantity in seen:
            raise UsageError(f"{here}: {sensor.quantity} already has a sensor; keep one of them")
        if sensor.port in ports:
            raise UsageError(f"{here}: port {sensor.port} is already read by another sensor; give each its own")
        seen.add(sensor.quantity)
        ports.add(sensor.port)
