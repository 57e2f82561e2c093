"""The controller of one axis for the user's own loop: law, estimator, limits and checks, without bus and daemon.

The caller reads the drive, calls `Controller.step` once per period, and sends the returned torque. The controller runs
the daemon's cycle (`control.cycle`), so that the same measurements result in the same torque.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from msgspec.structs import replace

from tsa_ctrl.arguments import flag_of, listing_arguments, number_of, whole_of
from tsa_ctrl.bus.canopen.cia402 import (
    FOLLOWS_COMMAND_BIT,
    REMOTE,
    STATUSWORD_PATTERNS,
    VOLTAGE_ENABLED,
    Controlword,
    Mode,
    PowerState,
)
from tsa_ctrl.bus.live.rig import Rig
from tsa_ctrl.bus.wire.bus import BusFault, Counters, Frame
from tsa_ctrl.config import Configuration, load_configuration
from tsa_ctrl.control.cycle import command
from tsa_ctrl.control.settings import SetPointSettings
from tsa_ctrl.daemon.build import control_axes, ranges_of, tuners_of
from tsa_ctrl.errors import UsageError
from tsa_ctrl.ipc.parameters import parameter_number
from tsa_ctrl.safety.supervisor import Phase, Request

_WORDS = {state: value | FOLLOWS_COMMAND_BIT | VOLTAGE_ENABLED | REMOTE for _, value, state in STATUSWORD_PATTERNS}
_ANSWERS = {  # CiA 402: the state that a drive takes after a controlword
    Controlword.SHUTDOWN: PowerState.READY_TO_SWITCH_ON,
    Controlword.SWITCH_ON: PowerState.SWITCHED_ON,
    Controlword.ENABLE_OPERATION: PowerState.OPERATION_ENABLED,
}


_LARGEST = 1e9  # rad, rad/s, N*m: a larger measurement is an error of a driver
_OMITTED = float("nan")  # another object than the nan of a caller whose encoder did not answer


class Command(NamedTuple):
    """The result of one step.

    Attributes:
        torque: motor torque to send, N*m at the motor pulley; always finite and within [axis.limits].
        permitted: False if the torque must be 0; the caller then disables the drive.
        reason: active limit of the torque, "none" without one.
        sigma: direction of the friction, -1 to 1.
        friction_term: compensated friction, N*m at the motor pulley.
        fault: the first latched fault with its remedy, or None.
    """

    torque: float
    permitted: bool
    reason: str
    sigma: float
    friction_term: float
    fault: str | None


class Controller:
    """Compute the motor torque of one axis in a loop that the caller runs at [controller] rate.

    Example:
        controller = Controller("rig/controller.toml")
        controller.enable()
        while running:  # once per period
            command = controller.step(0.3, tau_m=tau_m, q_m=q_m, omega_m=omega_m, q_j=q_j)
            drive.send(command.torque)

    A measurement that is not finite, or beyond 1e9, counts as a missing answer of the drive. The torque is then held
    for as many periods as [bus.supervision] tolerates, and afterwards a fault latches. The caller's watchdogs must act
    if `step` is not called.
    """

    @listing_arguments
    def __init__(self, configuration: str | Path | Configuration, *, play: bool = False) -> None:
        """Prepare the axis of a controller file.

        Args:
            configuration: path of a controller file with one axis, or the result of `load_configuration`. Node ids,
                [bus] and [socket] are not used.
            play: True plays the [axis.setpoint] of the file; False takes the set-point from each call of `step`.

        Raises:
            UsageError: the file is wrong, has several axes, or is of class "worn", whose checks need the daemon.
        """
        play = flag_of(play, "Controller: play")
        found = configuration if isinstance(configuration, Configuration) else load_configuration(configuration)
        file = found.file
        if len(file.axes) != 1:
            raise UsageError(
                f"{found.path}: a Controller drives one axis, the file has {len(file.axes)}; "
                "give each its own file, or use tsa run"
            )
        if file.safety.worn:
            raise UsageError(
                f'{found.path}: [safety] class "worn" requires checks of nodes and drive that only tsa run makes; '
                'use tsa run, or class "bench"'
            )
        (settings,) = file.axes
        if play and settings.setpoint.kind == "socket":
            raise UsageError(
                f'{found.path}: [axis.setpoint] kind "socket" cannot be played; give another, or play=False'
            )
        if not play:
            given = settings.setpoint
            received = SetPointSettings(kind="socket", rate=given.rate, timeout=given.timeout)
            settings = replace(settings, setpoint=received)
            found = dataclasses.replace(found, file=replace(file, axes=(settings,)))
        self.period = found.period
        self._play = play
        self._bus = _NoBus()
        rig = Rig(self._bus, file.bus, file.axes, found.profiles)
        (self._axis,) = control_axes(found, rig)
        (self._tuner,) = tuners_of((self._axis,), self.period)
        self._axis.connect(self._newest)
        self._encoder = settings.encoder
        self._state = PowerState.SWITCH_ON_DISABLED
        self._set_point: tuple[float, float] | None = None
        self._asked = False  # torque was requested since the last step
        self._gap = math.inf  # s since the last measurement

    def enable(self) -> None:
        """Request torque after the next step; the torque fades in. A latched fault must be reset first."""
        self._asked = True

    def disable(self) -> None:
        """Ramp the torque to 0 within [controller] stop_time."""
        self._asked = False
        self._axis.stop()

    def reset(self) -> None:
        """Reset a latched fault; the torque stays 0 until the next `enable`."""
        axis = self._axis
        if axis.supervisor.phase is Phase.FAULT:
            axis.supervisor.configured(axis.image)
            axis.limiter.reset()
            axis.request = Request.RESET
            self._asked = False

    @listing_arguments
    def set(self, name: str, value: float) -> None:
        """Change a live parameter, as `tsa set` does.

        Raises:
            UsageError: the name is unknown, or the value is outside its bounds.
        """
        value = number_of(value, name)
        number = parameter_number(ranges_of(self._tuner), name, value)
        parameter = self._tuner.parameters[number]
        if parameter.restores and value > parameter.value:  # repeated releases would disable the guard
            raise UsageError(
                f"{name} {value:g} is above {parameter.value:g}; a disable and a new enable release the guard"
            )
        self._tuner.set(number, value)

    @listing_arguments
    def step(
        self,
        tau_j_des: float | None = None,
        *,
        tau_m: float,
        q_m: float,
        omega_m: float,
        q_j: float = _OMITTED,
        tau_j: float = math.nan,
        operational: bool = True,
        skipped: int = 0,
    ) -> Command:
        """Return the command of this period.

        Args:
            tau_j_des: desired joint torque, N*m; after [axis.setpoint] timeout without a finite value it goes to 0.
            tau_m: motor torque that the drive reports, N*m at the motor pulley.
            q_m: motor angle, rad at the motor pulley.
            omega_m: motor velocity, rad/s at the motor pulley.
            q_j: joint angle, rad; required if the file has [axis.encoder].
            tau_j: joint torque of the sensor, N*m; required if the file has [axis.torque_sensor].
            operational: False if the drive reports no torque (disabled, fault, safe torque off).
            skipped: periods without a call since the last step.

        Raises:
            UsageError: `tau_j_des` is given to a Controller that plays the file's set-point, or missing in another. An
                argument is not a number. `q_j` is omitted, and the file has [axis.encoder].
        """
        axis, image = self._axis, self._axis.image
        if (tau_j_des is None) is not self._play:
            raise UsageError("step: give tau_j_des in every step, or none of them with Controller(..., play=True)")
        if q_j is _OMITTED and self._encoder is not None:
            raise UsageError("step: q_j is missing, and the file has [axis.encoder]; give nan if it did not answer")
        operational = flag_of(operational, "step: operational")
        given = {"tau_m": tau_m, "q_m": q_m, "omega_m": omega_m, "q_j": q_j, "tau_j": tau_j}
        tau_m, q_m, omega_m, q_j, tau_j = (number_of(value, f"step: {name}") for name, value in given.items())
        tau_j_des = None if tau_j_des is None else number_of(tau_j_des, "step: tau_j_des")
        if whole_of(skipped, "step: skipped") > 0:
            axis.skip_cycles(skipped)
            self._bus.now += skipped * self.period
            self._gap += skipped * self.period
        now = self._bus.now = self._bus.now + self.period
        required = (tau_m, q_m, omega_m) if self._encoder is None else (tau_m, q_m, omega_m, q_j)
        self._measure(now, required, tau_j)
        image.statusword = _WORDS[self._state if operational else PowerState.SWITCH_ON_DISABLED]
        image.mode = int(Mode.CYCLIC_SYNC_TORQUE)
        if tau_j_des is not None:
            self._set_point = (tau_j_des, now)
        controlword, torque = command(axis, now)
        self._state = _ANSWERS.get(controlword, PowerState.SWITCH_ON_DISABLED)
        axis.after_command(now)
        self._tuner.update()
        if self._asked:  # the supervisor has processed a cycle without a request
            self._asked = False
            axis.enable()
        fault = axis.supervisor.fault
        text = None if fault is None else f"{fault}; {fault.cause.remedy}"
        terms = axis.terms
        return Command(torque, terms.permitted, axis.reason.name.lower(), terms.sigma, axis.law.friction_term, text)

    def _measure(self, now: float, required: Sequence[float], tau_j: float) -> None:
        """Store the measurements of this period, or count a missing answer."""
        image, gap = self._axis.image, self._gap
        image.now = now
        image.fresh = image.joint_fresh = all(abs(value) <= _LARGEST for value in required)
        if not image.fresh:
            image.misses += 1
            image.missed += 1
            image.pdo_age = gap
            self._gap += self.period
            return
        image.tau_m, image.q_m, image.omega_m = required[:3]
        image.tau_j = tau_j if abs(tau_j) <= _LARGEST else math.nan
        if self._encoder is not None:
            before, image.q_j = image.q_j, required[3]
            rate = (image.q_j - before) / gap if math.isfinite(before) else 0.0
            last = image.omega_j if math.isfinite(image.omega_j) else 0.0
            image.omega_j = last + (1.0 - math.exp(-2.0 * math.pi * self._encoder.velocity_cutoff * gap)) * (
                rate - last
            )
        image.misses, image.pdo_age, self._gap = 0, 0.0, self.period

    def _newest(self) -> tuple[float, float] | None:
        """Return the caller's set-point and its time once."""
        newest, self._set_point = self._set_point, None
        return newest


class _NoBus:
    """A bus without nodes, on the caller's clock: it sends nothing and receives nothing."""

    name = "none"
    fault: BusFault | None = None

    def __init__(self) -> None:
        self.counters = Counters()
        self.now = 0.0  # s

    def clock(self) -> float:
        return self.now

    def send(self, can_id: int, data: bytes) -> bool:
        return True

    def recv(self, timeout: float) -> Frame | None:
        return None

    def gather(self, until: float, most: int) -> Sequence[Frame]:
        return ()

    def listen_for(self, can_id: int) -> None: ...

    def answers(self, timeout: float, most: int) -> Sequence[Frame]:
        return ()

    def expect(self, until: float) -> None: ...

    def accept(self, can_ids: Iterable[int] | None) -> None: ...

    def flush(self) -> int:
        return 0

    def clear_fault(self) -> None: ...

    def fileno(self) -> int:
        return -1

    def close(self) -> None: ...
