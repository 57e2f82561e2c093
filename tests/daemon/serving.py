"""A real socket server process for tests. The test takes the place of the loop at the mailbox."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec

from tsa_ctrl.control.estimator import EstimateState
from tsa_ctrl.daemon.build import LoopPhase
from tsa_ctrl.ipc.mailbox import RECOVER, AxisStatus, Command, General, Mailbox
from tsa_ctrl.ipc.protocol import Description, Opening, Range
from tsa_ctrl.safety.limiter import Reason
from tsa_ctrl.system.process_supervisor import READY

PATIENCE = 20.0  # s


def description(path: Path, axes: list[str]) -> Description:
    return Description(
        path=str(path),
        group=None,
        name="rig",
        period=1e-3,
        axes=axes,
        parameters=[
            [Range("compensation", "1", 0.0, 1.2, "share"), Range("pretension", "N", None, None, "T_p0")] for _ in axes
        ],
        codes={
            "state": ["not_ready", "operation_enabled"],
            "estimate_state": [state.name.lower() for state in EstimateState],
            "limit_reason": [reason.name.lower() for reason in Reason],
        },
        phases=[phase.name.lower() for phase in LoopPhase],
        set_point_limit=[2.0, *(None for _ in axes[1:])],
        figures={"bus": "vcan0"},
        remedies={"stale_pdo": "look at the bus"},
        set_point_timeout=[0.2 for _ in axes],
    )


QUARTERS = AxisStatus(*(0.25 for _ in AxisStatus._fields))._replace(
    state=1.0, estimate_state=0.0, limit_reason=0.0, missed=3.0, drive_age=0.0, joint_age=0.0, sensor_age=0.0
)


class Serving:
    """The process of the server, and the loop's end of the mailbox."""

    _said = ""

    def __init__(self, path: Path, axes: list[str]) -> None:
        self._axes = axes
        self.path = str(path)
        self.mailbox = Mailbox(len(axes), 2)
        self.publish(LoopPhase.RUNNING)
        self.process = subprocess.Popen(
            [sys.executable, "-m", "tsa_ctrl.ipc.server", str(self.mailbox.descriptor)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            pass_fds=[self.mailbox.descriptor],
        )
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        told = description(path, axes)
        opening = Opening(told.path, told.group, told.watch_group, told.name)
        for each in (opening, told):
            self.process.stdin.write(msgspec.json.encode(each) + b"\n")
        self.process.stdin.flush()
        self.greeting = self.process.stdout.readline()
        if self.greeting == READY:  # the socket is open
            self.greeting = self.process.stdout.readline()
        self.ready = self.greeting == READY

    def publish(self, phase: LoopPhase) -> None:
        """Publish a status with this phase."""
        general = General(time=time.monotonic(), phase=float(phase.value), cycles=7.0)
        axis = QUARTERS._replace(tau_j=float("nan"), tau_j_model=float("nan"))
        self.mailbox.publish(general, [(axis, (0.95, 45.0)) for _ in self._axes])

    @property
    def worker(self) -> int:
        """Return the id of the process that answers requests. `process` is its supervisor."""
        children = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children")
        end = time.monotonic() + PATIENCE
        while not (listed := children.read_text("ascii").split()) and time.monotonic() < end:
            time.sleep(0.01)  # a client can connect before this process exists
        (child,) = listed
        return int(child)

    def end(self) -> str:
        """Close the server's stdin, as at the end of the daemon, and return its stderr."""
        if self.process.returncode is None:
            self._said = self.process.communicate(timeout=PATIENCE)[1].decode()
            self.mailbox.close()
        return self._said


def until(condition: Callable[[], bool]) -> bool:
    """Return True once the condition is true, or False after `PATIENCE` seconds."""
    end = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.005)
    return True


@contextlib.contextmanager
def loop_taking(serving: Serving) -> Iterator[list[Command]]:
    """Run a thread that takes commands like the loop, and yield the list of commands."""
    taken: list[Command] = []
    done = threading.Event()

    def take() -> None:
        while not done.wait(0.001):
            command = serving.mailbox.take()
            if command is not None:
                taken.append(command)
                if command.parameter == RECOVER:
                    serving.publish(LoopPhase.RUNNING)

    thread = threading.Thread(target=take)
    thread.start()
    try:
        yield taken
    finally:
        done.set()
        thread.join()
