"""All trials of a rig, and the record of them that stays."""

from __future__ import annotations

import datetime
import hashlib
import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

from tsa_ctrl.config import Configuration
from tsa_ctrl.drills.listener import ZERO_SHARE
from tsa_ctrl.drills.trials import Outcome, Trial, check_alone, leave_in_order, listening, run_trial
from tsa_ctrl.errors import TsaError, UsageError
from tsa_ctrl.outputs import untaken
from tsa_ctrl.readiness import Nodes
from tsa_ctrl.settings import write_text
from tsa_ctrl.version import __version__

SCHEMA = 1
DEFAULT_SHARE = 0.1  # of the smallest rated torque
LEAST_SHARE = 0.06  # of the largest: below it torque cannot be distinguished from none


class Verification(msgspec.Struct, frozen=True, kw_only=True):
    """Hold the results and the configuration that was tested."""

    date: str  # ISO 8601, local time with its offset
    version: str
    configuration: str
    sha256: str  # of the configuration's text
    bus: str
    rate: float  # Hz
    limit: float  # s, zero_torque_within
    torque: float  # N*m at the motor
    outcomes: list[Outcome]
    nodes: Nodes  # that were there

    @property
    def safe(self) -> bool:
        return bool(self.outcomes) and all(outcome.safe for outcome in self.outcomes)

    def as_dict(self, samples: bool) -> dict[str, Any]:
        """JSON-ready; `samples`: with every torque that the listener saw."""
        trials = []
        for outcome in self.outcomes:
            data = msgspec.to_builtins(outcome)
            data |= data.pop("timing")
            found = data.pop("watchdog")
            data |= {"watchdog": found["acted"], "watchdog_after": found["after"], "warning": found["warning"] or None}
            data["pull"] |= {"shown": str(outcome.pull)}
            kept = data.pop("samples")
            trials.append({**data, "samples": kept} if samples else data)
        head = {name: getattr(self, name) for name in ("date", "version", "configuration", "sha256", "bus", "rate")}
        return {
            "schema": SCHEMA,
            **head,
            "limit": self.limit,
            "torque": self.torque,
            "safe": self.safe,
            "trials": trials,
        }


def trial_torque(configuration: Configuration, asked: float | None) -> float:
    """N*m at the motor: the requested one, the configured one, or a tenth of the rated torque. Raises UsageError."""
    axes = configuration.file.axes
    rated = [axis.drive.rated_torque * axis.drive.gear_ratio for axis in axes]
    given = configuration.file.safety.torque if asked is None else asked
    torque = DEFAULT_SHARE * min(rated) if given is None else given
    least, most = LEAST_SHARE * max(rated), min(axis.limits.torque for axis in axes)
    if not least <= torque <= most:
        raise UsageError(
            f"{configuration.path}: torque {torque:g} N*m of the trials; allowed are {least:g} N*m (three times what "
            f"counts as none, {ZERO_SHARE * max(rated):g}) to {most:g} N*m (limits.torque)"
        )
    return torque


def verify(configuration: Configuration, torque: float, say: Callable[[str], None]) -> Verification:
    """Do all trials.

    `say` receives a line for each. Raises BusError when the rig does not come up or gives no torque.
    """
    outcomes: list[Outcome] = []
    nodes: Nodes = {}
    wrong = ""
    check_alone(configuration)
    with listening(configuration) as listener:
        try:
            for trial in Trial:
                say(f"{trial.words} ...")
                outcomes += run_trial(configuration, listener, trial, torque)
        except TsaError as error:
            wrong = str(error)
            raise
        finally:
            try:
                nodes = leave_in_order(configuration, say)
            except TsaError as error:  # the failed trial is the one to report
                if str(error) not in wrong:
                    say(f"the drives could not be left in order: {error}")
    return Verification(
        date=datetime.datetime.now().astimezone().isoformat(timespec="seconds"),
        version=__version__,
        configuration=str(configuration.path),
        sha256=hashlib.sha256(configuration.text.encode()).hexdigest(),
        bus=configuration.file.channels,
        rate=configuration.file.controller.rate,
        limit=configuration.zero_torque_within,
        torque=torque,
        outcomes=outcomes,
        nodes=nodes,
    )


def check_folder(folder: Path) -> None:
    """Check before anything moves that a record can be written to the folder; raises UsageError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise UsageError(f"{folder}: no record can be kept there ({error.strerror}); choose another --record") from None


def save(verification: Verification, folder: Path) -> Path:
    """A dated file that is not overwritten; raises UsageError when it cannot be there."""
    path = untaken(folder, "safety", ".json", datetime.datetime.fromisoformat(verification.date))
    write_text(path, json.dumps(verification.as_dict(samples=True), allow_nan=False) + "\n")
    return path
