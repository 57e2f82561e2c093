"""Run the daemon on the rig with a set-point file, using a copy of the user's configuration."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from numpy.typing import NDArray

from tsa_ctrl.config import AxisSettings, Configuration
from tsa_ctrl.control.bending import routing_of
from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.identify.dataset import Dataset, stretches
from tsa_ctrl.log.table import STRETCH, load_run, read_table, sha256_of
from tsa_ctrl.model.provenance import Origin, nodes_from, with_origin
from tsa_ctrl.settings import write_text
from tsa_ctrl.signals import INPUTS, is_input
from tsa_ctrl.system.process_supervisor import daemon
from tsa_ctrl.tune.excitation import Bounds, Waveform

FloatArray = NDArray[np.float64]
Play = Callable[[Path, str, float, Callable[[float], None]], dict[str, Any]]  # (folder, name, seconds, tick) -> summary

SHORTEST_PIECE = 1.5  # s, least duration of a piece without missing cycles that a fit can use


class TrippedError(BusError):
    """Report that a fault of the loop ended a run. `cause` is that fault."""

    def __init__(self, name: str, cause: str) -> None:
        super().__init__(f"the run '{name}' failed: {cause}")
        self.cause = cause


@dataclass(frozen=True)
class Run:
    """The log of one run between fade-in and stop.

    Attributes:
        name: name of the run.
        log: log file.
        t: time since the enable, s, (n,).
        wanted: desired joint torque, N*m, (n,).
        delivered: delivered joint torque, N*m, (n,).
        pieces: parts of the log without missing cycles, for the fits. On a busy machine there may be none.
        by_elongation: joint torque from the tendon elongation, N*m, (n,); None if it is not estimated.
    """

    name: str
    log: Path
    t: FloatArray
    wanted: FloatArray
    delivered: FloatArray
    pieces: tuple[Dataset, ...]
    by_elongation: FloatArray | None = None

    @property
    def rms(self) -> float:
        """Return the RMS error of the joint torque over the whole motion, N*m."""
        return float(np.sqrt(np.mean(np.square(self.delivered - self.wanted))))

    def disagreement(self) -> float:
        """Return the RMS difference of sensor and elongation in the second half of the run, N*m at the joint.

        The result is infinite without an estimate from the elongation, or if a value is not finite.
        """
        if self.by_elongation is None:
            return float("inf")
        late = slice(self.t.size // 2, None)
        found = float(np.sqrt(np.mean(np.square(self.by_elongation[late] - self.delivered[late]))))
        return found if np.isfinite(found) else float("inf")

    def learnable(self) -> tuple[Dataset, ...]:
        """Return the pieces of the log without missing cycles. Raise BusError if all pieces are too short."""
        if not self.pieces:
            raise BusError(
                f"the run '{self.name}' has no interval of {SHORTEST_PIECE:g} s without missing cycles; "
                "the machine is too busy: stop other work, or lower [controller] rate"
            )
        return self.pieces


class RigRunner:
    """Play waveforms on one axis of a rig, and write all files to one folder.

    Attributes:
        origin: nodes that the last run found, and whether they were simulated. It is empty before the first run.
    """

    def __init__(
        self,
        configuration: Configuration,
        axis: AxisSettings,
        bounds: Bounds,
        folder: Path,
        run: Play = daemon,
        by_stretch: bool = False,
        all_axes: bool = False,
    ) -> None:
        """Prepare the runs of one axis.

        Args:
            configuration: the user's configuration.
            axis: axis to play on.
            bounds: permitted torque, speed and travel of the joint.
            folder: folder for all files.
            run: function that plays `controller-NAME.toml` of a folder, on the rig or in a simulation.
            by_stretch: True to estimate the joint torque from the tendon elongation, on a rig without a torque sensor.
            all_axes: True to record the angles of all joints of the rig, not only of those in the model's routing.
        """
        self.origin = Origin()
        self._run = run
        self._by_stretch = by_stretch
        self._all_axes = all_axes
        self._configuration = configuration
        self._axis = axis
        self._bounds = bounds
        self._folder = folder
        drives = configuration.folder / "drives"
        if drives.is_dir():
            (folder / "drives").symlink_to(drives.resolve(), target_is_directory=True)

    def play(
        self,
        name: str,
        model: Path,
        compensation: float,
        waveform: Waveform,
        tick: Callable[[float], None],
        law: Mapping[str, float | None] | None = None,
        rate: float | None = None,
        others: Mapping[str, Waveform] | None = None,
    ) -> Run:
        """Play the waveform once and read the log.

        The model is played as a file of this rig, even if it was tuned on another joint. This is safe because a
        friction term is tried only after the excitation has measured the rig's friction.

        Args:
            name: name of the run.
            model: model file.
            compensation: share of the friction term, 1.
            waveform: joint torque to play.
            tick: function called repeatedly with the elapsed share of the run, 0 to 1.
            law: keys that replace keys of the file's [axis.law], None to remove a key.
            rate: set-point rate that replaces the default, N*m/s.
            others: waveforms of other axes by name. These axes have no compensation, and unnamed axes stay at 0.

        Raises:
            TrippedError: A fault ended the run.
            BusError: The run left no log.
        """
        table = np.column_stack([waveform.t, waveform.tau_j_des])
        setpoint = self._folder / f"{name}.csv"
        np.savetxt(setpoint, table, delimiter=",", header="t,tau_j_des", comments="", fmt="%.9g")
        copy = self._folder / f"model-{name}.toml"
        copy.write_text(with_origin(model.read_text(encoding="utf-8"), self.origin), encoding="utf-8")
        played = {}
        for other, wave in (others or {}).items():
            played[other] = f"{name}-{other}.csv"
            rows = np.column_stack([wave.t, wave.tau_j_des])
            np.savetxt(self._folder / played[other], rows, delimiter=",", header="t,tau_j_des", comments="", fmt="%.9g")
        text = self._controller(name, copy, compensation, setpoint, law or {}, rate, played)
        (self._folder / f"controller-{name}.toml").write_text(text, encoding="utf-8")
        summary = self._run(self._folder, name, waveform.seconds, tick)
        if summary["log"] is None:
            raise BusError(f"the run '{name}' failed: {summary['cause']}")
        if summary["failed"]:
            raise TrippedError(name, str(summary["cause"]))
        nodes = nodes_from(summary["joints"].get(self._axis.name, {}))
        self.origin = Origin("simulated" if summary["simulated"] else "measured", nodes)
        log = _renamed(self._folder / str(summary["log"]), self._folder / f"{name}.mcap")
        return read_run(name, log, self._axis.name, self._axis.law.fade_in, waveform.seconds, self._by_stretch)

    def motion_of(self, name: str, axis: str) -> Dataset:
        """Return torque and motion of another axis during a completed run."""
        columns = read_table(f"{self._folder / name}.mcap:{axis}", ("t", "tau_m", "omega_j", "q_j")).columns
        known = np.all([np.isfinite(values) for values in columns.values()], axis=0)
        return Dataset.from_arrays({key: values[known] for key, values in columns.items()}, f"{name} of {axis}")

    def _controller(
        self,
        name: str,
        model: Path,
        compensation: float,
        setpoint: Path,
        law: Mapping[str, float | None],
        rate: float | None,
        played: Mapping[str, str],
    ) -> str:
        """Return the text of the user's file with the changes for this run.

        It has only the required axes, this model and set-point, and limits no wider than the given bounds.
        """
        data = tomllib.loads(self._configuration.text)
        keep = self._needed()
        data["axis"] = [axis for axis in data["axis"] if axis["name"] in keep]
        data["log"] = {"folder": "."}
        data["controller"] = {**data.get("controller", {}), "name": f"tune-{name}"[:32], "after_fault": "exit"}
        if "safety" in data:  # no person wears a joint during tuning; the limits of [safety] stay
            data["safety"].pop("class", None)
        for axis in data["axis"]:
            self._confine(axis)
            if axis["name"] == self._axis.name:
                axis["model"] = model.name  # a relative path stays valid after the folder is renamed
                axis["setpoint"] = {"kind": "file", "file": setpoint.name}
                if rate is not None:
                    axis["setpoint"]["rate"] = rate
                if "routing" in tomllib.loads(model.read_text(encoding="utf-8")):  # a routing implies the kind "map"
                    axis["estimator"] = {key: value for key, value in axis["estimator"].items() if key != "kind"}
                keys = {**axis.get("law", {}), "compensation": compensation, **law}
                axis["law"] = {key: value for key, value in keys.items() if value is not None}
            else:
                axis["model"] = str((self._configuration.folder / axis["model"]).resolve())
                other = played.get(axis["name"])
                axis["setpoint"] = {"kind": "constant"} if other is None else {"kind": "file", "file": other}
                axis["law"] = {**axis.get("law", {}), "compensation": 0.0}
        text: str = tomlkit.dumps(data)
        return text

    def _needed(self) -> set[str]:
        """Return the names of the tuned axis and of all axes whose joints bend its sheaths directly or indirectly.

        With `all_axes`, return the names of all axes of the file.
        """
        file = self._configuration.file
        crossed = {
            axis.name: () if (routing := routing_of(axis.bending, model.routing)) is None else routing.joints
            for axis, model in zip(file.axes, self._configuration.models, strict=True)
        }
        needed, open_names = set[str](), [*crossed] if self._all_axes else [self._axis.name]
        while open_names:
            name = open_names.pop()
            if name in crossed and name not in needed:
                needed.add(name)
                open_names += crossed[name]
        return needed

    def _confine(self, axis: dict[str, Any]) -> None:
        folder, drive = self._configuration.folder, axis["drive"]
        if str(drive.get("profile", "")).endswith(".toml"):
            drive["profile"] = str((folder / drive["profile"]).resolve())
        estimator = axis.get("estimator", {})
        if estimator.get("kind") != "map":  # the verification uses the file's values
            axis["estimator"] = {**estimator, "use": False}
        if axis["name"] != self._axis.name:
            return
        limits = axis["limits"]
        speed = min(self._bounds.speed, self._axis.limits.joint_speed)
        limits["joint_speed"] = speed
        limits["over_speed"] = max(min(self._axis.limits.over_speed, 2.0 * speed), 1.01 * speed)
        if self._bounds.travel is not None:
            limits["travel"] = list(self._bounds.travel)


def _renamed(written: Path, log: Path) -> Path:
    """Rename a log and its summary, and return the log; the summary names the log without its folder."""
    written.rename(log)
    summary = written.with_suffix(".json")
    if summary.is_file():
        values = json.loads(summary.read_text(encoding="utf-8")) | {"log": log.name}
        write_text(log.with_suffix(".json"), json.dumps(values, indent=1) + "\n")
        summary.unlink()
    if written.parent != log.parent:
        with contextlib.suppress(OSError):  # the run wrote other files too
            written.parent.rmdir()
    return log


def read_run(name: str, log: Path, axis: str, fade_in: float, seconds: float, by_stretch: bool = False) -> Run:
    """Return a run from its log. Raise BusError if the log is too short.

    Args:
        name: name of the run.
        log: log file.
        axis: name of the axis.
        fade_in: duration of the fade-in, s.
        seconds: time with torque, s.
        by_stretch: True to use the joint torque from the tendon elongation.
    """
    part = load_run(f"{log}:{axis}", (*INPUTS, STRETCH), fade_in, seconds, by_stretch=by_stretch)
    other = None if by_stretch else part.pop(STRETCH, None)
    pieces = _pieces(part, name, sha256_of(log))
    return Run(name, log, part["t"], part["tau_j_des"], part["tau_j"], pieces, other)


def _pieces(columns: dict[str, FloatArray], name: str, sha256: str) -> tuple[Dataset, ...]:
    """Return a dataset for each part between two gaps that are too long for interpolation."""
    t = columns["t"]
    present = {key: value for key, value in columns.items() if is_input(key) and bool(np.isfinite(value).all())}
    pieces = []
    for first, end in stretches(t):
        if t[end - 1] - t[first] >= SHORTEST_PIECE:
            arrays = {key: value[first:end] for key, value in present.items()}
            with contextlib.suppress(UsageError):  # too many missing cycles for a uniform grid
                pieces.append(Dataset.from_arrays(arrays, name, recorded=True))
    if len(pieces) == 1:
        return (dataclasses.replace(pieces[0], sha256=sha256),)
    return tuple(
        dataclasses.replace(piece, name=f"{name}-{n + 1}", sha256=f"{sha256}#{n + 1}") for n, piece in enumerate(pieces)
    )


def longest(pieces: Sequence[Dataset]) -> Dataset:
    """Return the piece with the longest duration."""
    return max(pieces, key=lambda piece: piece.seconds)
