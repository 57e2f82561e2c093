"""Plant and daemon of the campaign as processes: told, asked, and ended whatever happens."""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tools.campaign.fault.verdict import Record
from tsa_ctrl.errors import TsaError
from tsa_ctrl.ipc.client import Client
from tsa_ctrl.ipc.protocol import Recover, Status
from tsa_ctrl.plant.channel import ask
from tsa_ctrl.system.processes import tsa

PATIENCE = 30.0  # s
PLANT = """
[bus]
channel = "{channel}"
[[axis]]
name = "knee"
actuator = "actuator.toml"
[axis.perturbation]
friction_coefficient = 1.08
pretension = 0.95
"""
BARE = """[axis.drive]
absent = ["0x1400:5"]
"""


class LostError(TsaError):
    """A process that did not come or did not go; the campaign itself has failed."""


def until(condition: Callable[[], Any], patience: float, what: str) -> Any:
    end = time.monotonic() + patience
    while not (found := condition()):
        if time.monotonic() > end:
            raise LostError(f"{what} did not happen within {patience:g} s")
        time.sleep(0.01)
    return found


class Plant:
    """The plant as a process, with its record and its control socket."""

    def __init__(self, folder: Path, channel: str, bare: bool) -> None:
        text = PLANT.format(channel=channel) + (BARE if bare else "")
        (folder / "plant.toml").write_text(text, encoding="utf-8")
        self.control = folder / "plant.sock"
        self.record = Record(folder / "truth.csv")
        verb = tsa("plant", "plant.toml", "--record", "truth.csv", "--control", str(self.control))
        self.process = subprocess.Popen(verb, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if "ready" in line:
                return
        raise LostError(f"the plant: {self.process.communicate()[1]}")

    def tell(self, line: str) -> float:
        """One line to it; CLOCK_MONOTONIC of when it was done."""
        answer = ask(self.control, line)
        if not answer.startswith("ok"):
            raise LostError(answer)
        return float(answer.split()[1])

    def torque(self) -> float:
        state = json.loads(ask(self.control, "state"))
        return float(state["axes"][0]["torque_loop"])

    def end(self) -> None:
        self.process.terminate()
        try:
            self.process.communicate(timeout=PATIENCE)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.communicate()


class Daemon:
    """`tsa run` as a process."""

    def __init__(self, folder: Path, name: str) -> None:
        self.socket = str(folder / "tsa.sock")
        self.process = subprocess.Popen(
            tsa("run", name, "--json", "--reset-faults"),
            cwd=folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.start = 0.0  # CLOCK_MONOTONIC of t = 0 in its log

    def status(self) -> dict[str, Any] | None:
        try:
            with Client(self.socket, timeout=1.0) as client:
                status = client.ask(Status())
        except TsaError:
            return None
        self.start = time.monotonic() - status["age"] - (status["uptime"] or 0.0)
        return status

    @property
    def phase(self) -> str:
        if self.process.poll() is not None:
            return "dead" if self.process.returncode < 0 else "ended"
        status = self.status()
        return "silent" if status is None else str(status["phase"])

    def counts(self) -> dict[str, int]:
        """What it counted of its PDOs since its start; nothing where nobody answers."""
        status = self.status() if self.process.poll() is None else None
        axis = status["axes"][0] if status else {}
        return {name: axis.get(name) or 0 for name in ("late", "repeated", "malformed")}

    def faults(self, since: float) -> tuple[str, ...]:
        """What its status tells since then (CLOCK_MONOTONIC in s); nothing where nobody answers."""
        status = self.status() if self.process.poll() is None else None
        told = [event for event in (*status["events"], *status["faults"]) if event["fault"]] if status else []
        return tuple(fault["text"] for fault in told if fault["t"] >= since - self.start - 0.02)

    def recover(self) -> None:
        with contextlib.suppress(TsaError), Client(self.socket) as client:
            client.ask(Recover())

    def children(self, word: str) -> list[int]:
        """Processes of it whose command line has `word`: the one that keeps another, then that one."""
        found, looked = [], [self.process.pid]
        for pid in looked:
            listed = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split()
            found += [int(child) for child in listed if word in Path(f"/proc/{child}/cmdline").read_text("utf-8")]
            looked += map(int, listed)
        return found

    def end(self) -> dict[str, Any]:
        """Its summary; nothing when it was killed."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGCONT)
            self.process.terminate()
        try:
            out, error = self.process.communicate(timeout=PATIENCE)
        except subprocess.TimeoutExpired:
            self.process.kill()
            out, error = self.process.communicate()
        self.said = error
        return dict(json.loads(out)) if out.strip() else {}
