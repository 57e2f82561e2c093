"""The second channel of a run: the inputs of its monitor as plain numbers, and the state of the monitor."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import Protocol

from tsa_ctrl.bus.canopen import objects
from tsa_ctrl.bus.drive.profile import drive_scale, encoder_scale
from tsa_ctrl.config import Configuration
from tsa_ctrl.control.axis import ControlAxis
from tsa_ctrl.daemon.build import give_of
from tsa_ctrl.daemon.monitor_process import Given, MonitorProcess, Report
from tsa_ctrl.monitor.watched import Watched, WatchedAxis
from tsa_ctrl.safety.causes import Finding
from tsa_ctrl.safety.plausibility import DEFAULT_TORQUE

PULLEYS = 0.02  # rad at the motor: pulleys out of round, eccentric encoders, backlash
MORE_MISSES = 3  # periods beyond the misses that the loop tolerates: the loop acts first


def watched_of(configuration: Configuration) -> Watched:
    """Return the inputs of the monitor for a configuration, with limits from [axis.limits]."""
    file, axes = configuration.file, []
    for settings, model, profile in zip(file.axes, configuration.models, configuration.profiles, strict=True):
        drive, encoder, limits = settings.drive, settings.encoder, settings.limits
        give = give_of(settings, model, 0.0)
        scale = drive_scale(drive, profile, f"axis '{settings.name}'")
        slip, torque_error, travel = settings.plausibility.slip, settings.plausibility.torque, limits.travel
        alone = max(0.0, limits.torque - give.domain) / limits.torque  # above it one tendon pulls, twice as compliant
        margin = limits.travel_margin
        axes.append(
            WatchedAxis(
                name=settings.name,
                node_id=drive.node_id,
                slot=drive.slot,
                pdo_node_id=drive.pdo_node_id,
                lean=drive.pdo == "lean",
                has_error_code=profile.has(objects.ERROR_CODE),
                encoder_id=None if encoder is None else encoder.node_id,
                torque_digit=scale.torque,
                position_digit=scale.position,
                velocity_digit=0.0 if drive.differentiates else scale.velocity,
                joint_digit=0.0 if encoder is None else encoder_scale(encoder),
                joint_zero=0 if encoder is None else encoder.zero,
                joint_range=1 << 32 if encoder is None else encoder.counts_range,
                torque=limits.torque,
                torque_rate=limits.rate,
                torque_error=DEFAULT_TORQUE * limits.torque if torque_error is None else torque_error,
                over_speed=limits.over_speed,
                motor_over_speed=limits.motor_over_speed,
                travel=None if travel is None else (travel[0] - margin, travel[1] + margin),
                ratio=model.joint_pulley_radius / model.motor_pulley_radius,
                slack=slip or (1.0 + give.doubt) * (1.0 + give.friction) * give.wound + give.play + PULLEYS,
                compliance=(1.0 + give.doubt + alone) / give.stiffness,
                silence=max(
                    drive.rpdo_timeout, (file.bus.supervision.tolerated_misses + MORE_MISSES) * configuration.period
                ),
            )
        )
    return Watched(
        axes=tuple(axes),
        nodes=tuple(sorted({node.node_id for axis in file.axes for _, node in axis.nodes()})),
        period=configuration.period,
        host_node_id=file.bus.host_node_id,
        host_silence=min(axis.drive.host_timeout for axis in file.axes),
    )


class Watcher(Protocol):
    """A running monitor: a process, or an object in virtual time."""

    report: Report

    def fault(self, now: float) -> Finding | None: ...
    def news(self) -> list[str]: ...
    def close(self) -> None: ...


class MonitorState(IntEnum):
    """States of the second channel; the values are codes of the status."""

    OFF = 0
    WATCHING = 1
    STOPPED = 2  # it removed the torque
    FAILED = 3  # its process ended or hangs


class SecondChannel:
    """The monitor of a run, if there is one. A new bring-up replaces a monitor that stopped or failed."""

    def __init__(self, begin: Callable[[], Watcher] | None = None) -> None:
        """`begin` starts a monitor; it raises UsageError if the monitor cannot watch."""
        self._begin = begin
        self._watcher = None if begin is None else begin()
        self._fault: Finding | None = None

    @property
    def state(self) -> MonitorState:
        """Return the state of the monitor."""
        if self._watcher is None:
            return MonitorState.OFF
        if self._watcher.report.stop is not None:
            return MonitorState.STOPPED
        return MonitorState.WATCHING if self._fault is None else MonitorState.FAILED

    @property
    def failed(self) -> bool:
        """Return True if the monitor stopped or failed; torque then requires a new monitor."""
        return self._fault is not None

    @property
    def confirmed(self) -> bool:
        """Return True if every drive confirmed to the monitor that it delivers no torque."""
        return self._watcher is not None and self._watcher.report.confirmed

    def fault(self, now: float) -> Finding | None:
        """Return the reason why torque is not permitted, once, otherwise None; `now` is monotonic, s."""
        if self._watcher is None or self._fault is not None:
            return None
        self._fault = self._watcher.fault(now)
        return self._fault

    def latch_stop(self, now: float, axes: Sequence[ControlAxis]) -> Finding | None:
        """Latch a stop of the monitor in every supervisor; return a failure of the monitor once."""
        finding = self.fault(now)
        if finding is None or self.state is not MonitorState.STOPPED:
            return finding
        for axis in axes:
            axis.supervisor.trip(finding, now)
        return None

    def acted(self, now: float) -> bool:
        """Return True if the monitor removed the torque, so that a frame of a master may be its own."""
        if self._watcher is None:
            return False
        self._watcher.fault(now)
        return self._watcher.report.stop is not None

    def news(self) -> list[str]:
        """Return notices since the last call."""
        return [] if self._watcher is None else self._watcher.news()

    def renew(self) -> None:
        """Replace a monitor that stopped or failed by a new one."""
        if self._begin is not None and self._fault is not None:
            self.close()
            self._watcher, self._fault = self._begin(), None

    def close(self) -> None:
        """End the monitor; the torque must be 0 before."""
        if self._watcher is not None:
            self._watcher.close()


def monitor_process(configuration: Configuration) -> SecondChannel:
    """Start the monitor as a process, if the configuration enables it. Raises UsageError."""
    file = configuration.file
    if not configuration.monitored:
        return SecondChannel()
    given = Given(
        watched=watched_of(configuration),
        interface=file.bus.interface,
        channel=file.bus.channel,
        bitrate=file.bus.bitrate,
        options=file.bus.options,
        output=file.monitor.output,
        priority=min(99, file.realtime.priority + 1),
    )
    return SecondChannel(lambda: MonitorProcess(given))


def monitor_line(configuration: Configuration) -> str:
    """Return the startup message about the monitor."""
    if not configuration.monitored:
        return "monitor: off; only the drives' own time-outs act when this process fails ([monitor] enabled)"
    output = configuration.file.monitor.output
    acts = "no output for safe torque off ([monitor] output)" if output is None else f"output {output.named}"
    return f"monitor: watches {configuration.file.bus.channel}; it acts by NMT stop, {acts}"
