"""The loop under trial, a separate process: `python -m tsa_ctrl.drills.loop CONTROLLER.toml TORQUE`.

It uses the configuration with a constant set-point (TORQUE, N*m at the motor), no friction compensation, no log, no
monitor, and a private socket. SIGUSR1 makes it withhold its heartbeat; everything else continues.
"""

from __future__ import annotations

import dataclasses
import signal
import sys
import tempfile
from types import FrameType

import msgspec

from tsa_ctrl.bus.live.rig import Rig
from tsa_ctrl.config import AxisSettings, Configuration, load_configuration
from tsa_ctrl.control.settings import SetPointSettings
from tsa_ctrl.errors import TsaError
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.safety.use_class import on_bench
from tsa_ctrl.system.process_supervisor import follow
from tsa_ctrl.system.torque_off import MonitorSettings

FADE_IN = 0.2  # s


def under_trial(configuration: Configuration, torque: float, socket: str) -> Configuration:
    """Return the configuration with a constant motor torque in N*m, without the monitor: the drives are tested."""
    replace = msgspec.structs.replace
    file = configuration.file
    axes = tuple(_pulling(axis, model, torque) for axis, model in zip(file.axes, configuration.models, strict=True))
    changed = replace(
        file,
        axes=axes,
        controller=replace(file.controller, after_fault="wait"),
        log=replace(file.log, enabled=False),
        socket=replace(file.socket, path=socket, group=None),
        safety=on_bench(file.safety),
        monitor=MonitorSettings(enabled=False),
    )
    return dataclasses.replace(configuration, file=changed)


def _pulling(axis: AxisSettings, model: TendonSheath, torque: float) -> AxisSettings:
    replace = msgspec.structs.replace
    at_joint = torque * model.joint_pulley_radius / model.motor_pulley_radius
    return replace(
        axis,
        setpoint=SetPointSettings(kind="constant", offset=at_joint),
        law=replace(axis.law, compensation=0.0, fade_in=FADE_IN),
    )


def main(argv: list[str]) -> int:
    """Run until SIGTERM, until the parent has ended, or until this process is killed, which is its purpose."""
    follow()
    from tsa_ctrl.daemon.run import run

    def watch(rig: Rig) -> None:
        def withhold(number: int, frame: FrameType | None) -> None:
            rig.withholds_heartbeat = True

        signal.signal(signal.SIGUSR1, withhold)

    try:
        with tempfile.TemporaryDirectory(prefix="tsa-safety-") as folder:
            configuration = under_trial(load_configuration(argv[0]), float(argv[1]), f"{folder}/tsa.sock")
            summary = run(configuration, reset_faults=True, watch=watch)
        fault = next((event for event in summary.events if event.fault), None)
        if fault is not None:  # the last line: the caller reports it as the reason for lost torque
            print(fault, file=sys.stderr)
    except TsaError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    return 1 if summary.unconfirmed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
