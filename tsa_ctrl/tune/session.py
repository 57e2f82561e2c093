"""Run one call of `tsa tune`: check the inputs, provide a working folder, and write or undo the results."""

from __future__ import annotations

import contextlib
import difflib
import functools
import itertools
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tsa_ctrl import settings
from tsa_ctrl.config import AxisSettings, load_configuration
from tsa_ctrl.daemon.joint_files import admitted
from tsa_ctrl.display import TIME, axis_label
from tsa_ctrl.doctor import can_interface
from tsa_ctrl.doctor.can_interface import Result
from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.identify.calibrate import errors_of
from tsa_ctrl.identify.dataset import Dataset, load_logs
from tsa_ctrl.identify.diagnosis.report.words import told_torque
from tsa_ctrl.model.feedforward import Feedforward
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.predict import predict
from tsa_ctrl.outputs import backups, untaken
from tsa_ctrl.system.process_supervisor import daemon, postponed
from tsa_ctrl.tune.by_stretch import unsupported_by
from tsa_ctrl.tune.excitation import (
    FREQUENCIES,
    OTHER_FREQUENCIES,
    PROBE_SECONDS,
    SHAKE_SECONDS,
    Bounds,
    from_file,
    most_torque,
)
from tsa_ctrl.tune.mechanics import differ_in_law_alone, law_tuning, moved, with_law
from tsa_ctrl.tune.procedure import (
    Ask,
    Outcome,
    Procedure,
    Progress,
    Settings,
    Verification,
    from_logs,
    routing_runs,
)
from tsa_ctrl.tune.report import write_page
from tsa_ctrl.tune.run import Play, RigRunner, longest

# Pictures of a tuning, as PNG files: the fit and its residual, and the torque errors of the verification.

FloatArray = NDArray[np.float64]

SHOWN = 8.0  # s of a run that a picture shows
TRIED = 0.95  # share of the friction term in the verification if the file has 0, as during commissioning
DPI = 120
REPEATED = ("routing-", "excitation-")  # first letters of the names of the runs that one fit uses with the excitation


def draw(outcome: Outcome, folder: Path) -> list[tuple[str, Path]]:
    """Write all pictures, and return the caption and the file of each."""
    log = longest(outcome.logs)
    pictures = [
        ("Measured joint torque and the predictions of both files", _fit(log, outcome, folder / "fit.png")),
        ("Residual of both files", _residual(log, outcome, folder / "residual.png")),
    ]
    if outcome.verification is not None:
        file = _verification(outcome.verification, folder / "verification.png")
        pictures.append(("Verification on another motion", file))
    return pictures


def _models(outcome: Outcome) -> tuple[tuple[str, TendonSheath, str], ...]:
    return (
        ("given file", outcome.nominal, "tab:red"),
        ("new file", outcome.estimate.model, "tab:blue"),
    )


def _fit(log: Dataset, outcome: Outcome, file: Path) -> Path:
    figure = Figure(figsize=(9.0, 6.5), layout="constrained")
    course, loop = figure.subplots(2, 1, height_ratios=[2, 3])
    part = log["t"] - log["t"][0] <= SHOWN
    t = (log["t"] - log["t"][0])[part]
    course.plot(t, log["tau_j"][part], "k", lw=1.6, label="measured")
    loop.plot(log["tau_m"][part], log["tau_j"][part], "k.", ms=1.0, label="measured")
    for name, model, colour in _models(outcome):
        predicted = predict(model, log.signals())[part]
        course.plot(t, predicted, colour, lw=0.9, label=name)
        loop.plot(log["tau_m"][part], predicted, ".", color=colour, ms=0.8, label=name)
    course.set(xlabel=TIME, ylabel=axis_label("tau_j"))
    loop.set(xlabel=axis_label("tau_m"), ylabel=axis_label("tau_j"))
    figure.suptitle(_conclusion(outcome))
    return _saved(figure, file)


def _conclusion(outcome: Outcome) -> str:
    """Return the title with the errors of both files while sliding, over all logs."""
    given, new = errors_of(outcome.logs, outcome.nominal).sliding, outcome.errors.sliding
    return f"Error while sliding: {told_torque(given)} with the given file, {told_torque(new)} with the new file"


def _residual(log: Dataset, outcome: Outcome, file: Path) -> Path:
    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    axes = figure.subplots(2, 2)
    for name, model, colour in _models(outcome):
        residual = 1e3 * (log["tau_j"] - predict(model, log.signals()))
        for place, column in zip(axes.flat[:3], ("t", "omega_j", "tau_m"), strict=True):
            shown = log["t"] - log["t"][0] if column == "t" else log[column]
            place.plot(shown, residual, ".", ms=0.8, color=colour, label=name)
            place.set_xlabel(axis_label(column))
        axes.flat[3].hist(residual, bins=80, color=colour, alpha=0.6, label=name)
    for place in axes.flat[:3]:
        place.set_ylabel("residual (mN·m)")
    axes.flat[3].set(xlabel="residual (mN·m)", ylabel="number of samples")
    figure.suptitle(_conclusion(outcome))
    return _saved(figure, file)


def _verification(verification: Verification, file: Path) -> Path:
    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    torque, error = figure.subplots(2, 1, sharex=True, height_ratios=[3, 2])
    runs = (
        ("without compensation", verification.without, "tab:grey"),
        ("given file", verification.before, "tab:red"),
        ("new file", verification.after, "tab:blue"),
    )
    part = verification.after.t <= verification.after.t[0] + SHOWN
    torque.plot(verification.after.t[part], verification.after.wanted[part], "k", lw=2.0, label="desired")
    for name, run, colour in runs:
        if run is None:
            continue
        part = run.t <= run.t[0] + SHOWN
        torque.plot(run.t[part], run.delivered[part], colour, lw=0.9, label=name)
        shown = f"{name}: RMS {1e3 * run.rms:.1f} mN·m"
        error.plot(run.t[part], 1e3 * (run.delivered - run.wanted)[part], colour, lw=0.9, label=shown)
    torque.set_ylabel(axis_label("tau_j"))
    error.set(xlabel="time since the enable (s)", ylabel="torque error (mN·m)")
    without, new = 1e3 * verification.without.rms, 1e3 * verification.after.rms
    figure.suptitle(f"RMS torque error: {without:.1f} mN·m without compensation, {new:.1f} mN·m with the new file")
    return _saved(figure, file)


def _saved(figure: Figure, file: Path) -> Path:
    for axes in figure.axes:
        axes.grid(alpha=0.3)
        if axes.get_legend_handles_labels()[0]:
            above = (1.0, 1.0)  # so that the legend hides no data
            axes.legend(loc="lower right", bbox_to_anchor=above, ncols=4, frameon=False, fontsize=8, markerscale=6.0)
    figure.savefig(file, dpi=DPI)
    return file


def diff(path: Path, text: str) -> str:
    """Return the unified diff from the file to `text`."""
    before = path.read_text(encoding="utf-8").splitlines(keepends=True)
    return "".join(difflib.unified_diff(before, text.splitlines(keepends=True), path.name, f"{path.name} (new)"))


@postponed()
def replace(texts: Mapping[Path, str], beside: Sequence[Path] = ()) -> dict[Path, Path]:
    """Write each text to its path by renaming, and return the backup file of each path.

    All backups of one call have names `NAME.~N~` with the same N, one above the highest N of `texts` and `beside`. If
    one file cannot be written, none is changed. SIGINT and SIGTERM are postponed until all files are written.
    """
    number = 1 + max((n for path in (*texts, *beside) for n in backups(path)), default=0)
    kept = {path: path.with_name(f"{path.name}.~{number}~") for path in texts}
    before = {path: path.read_text(encoding="utf-8") for path in texts}
    written = []
    try:
        for path, text in texts.items():
            settings.write_text(kept[path], before[path])
            settings.write_text(path, text)
            written.append(path)
    except BaseException:
        for path in written:
            settings.write_text(path, before[path])
        for other in kept.values():
            other.unlink(missing_ok=True)
        raise
    return kept


def last(path: Path, *others: Path) -> dict[Path, Path]:
    """Return the newest backup of `path` and the backups of `others` from the same tuning.

    Raises:
        UsageError: `path` has no backup, or one of `others` has been replaced again since.
    """
    old = backups(path)
    if not old:
        raise UsageError(f"{path}: nothing to undo; there is no backup {path.name}.~N~ next to it")
    number = max(old)
    found = {path: old[number]}
    for other in others:
        kept = backups(other)
        if number in kept and max(kept) > number:
            raise UsageError(f"{other}: was replaced again later, see {kept[max(kept)].name}; undo that first")
        if number in kept:
            found[other] = kept[number]
    return found


@postponed()
def undo(kept: Mapping[Path, Path]) -> None:
    """Move the backups (values) back to their paths (keys)."""
    for path, old in kept.items():
        settings.write_text(path, old.read_text(encoding="utf-8"))
    for old in kept.values():
        old.unlink()


@dataclass(frozen=True)
class Plan:
    """The options of `tsa tune`. The controller file applies for a limit that is None."""

    torque: float | None = None  # N*m at the joint
    speed: float | None = None  # rad/s of the joint
    travel: tuple[float, float] | None = None  # rad of the joint
    seconds: float = 20.0  # s, duration of the excitation
    verification_seconds: float = 10.0  # s, duration of one verification run
    certified_gain: bool = False
    forms: bool = True
    extended: bool = False
    setpoint: Path | None = None  # file to play as the excitation, in the format that a diagnosis writes
    joints: tuple[str, ...] = ()  # names of other axes whose joints also move, because they may bend the sheaths
    plant: Path | None = None  # simulated plant to use in virtual time; default: the rig's bus
    allow_simulated: bool = False  # start on hardware from a model file with simulated numbers


class Session:
    """Check one call of `tsa tune`, run it and write its files. `path` is the model file that may be written."""

    def __init__(self, controller: Path, axis: str | None, plan: Plan) -> None:
        """Read and check the configuration. Raise UsageError if it is not valid."""
        self._configuration = load_configuration(controller)
        self.axis = self._chosen(controller, axis)
        index = self._configuration.file.axes.index(self.axis)
        self._model = self._configuration.models[index]
        self.path = self._configuration.folder / self.axis.model
        self.bounds = self._bounds(controller, plan)
        played = None if plan.setpoint is None else from_file(plan.setpoint)
        self._settings = Settings(
            seconds=plan.seconds if played is None else played.seconds,
            verification_seconds=plan.verification_seconds,
            compensation=self.axis.law.compensation or TRIED,
            period=self._configuration.period,
            certified_gain=plan.certified_gain,
            forms=plan.forms,
            extended=plan.extended,
            by_stretch=not self.axis.has_torque_sensor,
            excitation=played,
            others=self._others(controller, plan.joints),
        )
        self._plant = plan.plant
        self._allow_simulated = plan.allow_simulated
        self._folder = Path()
        self._final: Path | None = None
        self.page: Path | None = None

    def _chosen(self, controller: Path, name: str | None) -> AxisSettings:
        axes = {axis.name: axis for axis in self._configuration.file.axes}
        if name is None and len(axes) == 1:
            return next(iter(axes.values()))
        if name not in axes:
            found = "no --axis" if name is None else f"--axis {name}"
            raise UsageError(f"{controller}: {found}; give one of {', '.join(axes)}")
        return axes[name]

    def _others(self, controller: Path, names: Sequence[str]) -> dict[str, Bounds]:
        """Return the limits of the other joints that move. Raise UsageError for a name that no other axis has."""
        file = self._configuration.file
        known = {axis.name: place for place, axis in enumerate(file.axes) if axis.name != self.axis.name}
        found = {}
        for name in names:
            if name not in known:
                axes = ", ".join(known) or "none"
                raise UsageError(
                    f"{controller}: --joint {name} is not the name of another axis; the other axes are {axes}"
                )
            axis, model = file.axes[known[name]], self._configuration.models[known[name]]
            limits = axis.limits
            found[name] = Bounds(most_torque(model, limits.torque), limits.joint_speed, limits.travel)
        return found

    def _bounds(self, controller: Path, plan: Plan) -> Bounds:
        limits = self.axis.limits
        most = most_torque(self._model, limits.torque)
        if plan.torque is not None and plan.torque > most:
            raise UsageError(
                f"{controller}: --torque {plan.torque:g} N*m is more than limits.torque and the pretension allow, "
                f"{most:.3g} N*m at the joint; give less"
            )
        speed = limits.joint_speed if plan.speed is None else plan.speed
        if speed > limits.joint_speed:
            raise UsageError(
                f"{controller}: --speed {speed:g} rad/s is above limits.joint_speed {limits.joint_speed:g} rad/s; "
                "give less"
            )
        travel = limits.travel if plan.travel is None else plan.travel
        if plan.travel is not None:
            low, high = plan.travel
            margin = 2.0 * limits.travel_margin
            allowed = limits.travel or (-float("inf"), float("inf"))
            if not (allowed[0] <= low and high <= allowed[1] and high - low > margin):
                raise UsageError(
                    f"{controller}: --travel {low:g} {high:g} rad must lie within limits.travel and be wider than two "
                    f"travel margins ({margin:g} rad)"
                )
        return Bounds(most if plan.torque is None else plan.torque, speed, travel)

    def undo(self) -> dict[Path, Path]:
        """Restore the files that the last tuning replaced, and return their backups.

        Raises:
            UsageError: No backup exists, or the controller file was edited after the tuning.
        """
        controller = self._configuration.path
        kept = last(self.path, controller)
        if controller in kept:
            before = kept[controller].read_text(encoding="utf-8")
            if not differ_in_law_alone(before, self._configuration.text, self.axis.name):
                raise UsageError(
                    f"{controller}: was edited since the tuning, so it is not put back; set [axis.law] to the "
                    f"values of {kept[controller].name}, remove that file, and undo again"
                )
        undo(kept)
        return kept

    def next_step(self, outcome: Outcome) -> str:
        """Return the user's next step once a tuning on the rig is written, or an empty string."""
        if self.axis.law.compensation > 0.0 or outcome.verification is None:
            return ""
        return (
            f"[axis.law] compensation is still 0; the verification used {self._settings.compensation:g}. While tsa run "
            "runs, raise it in steps: tsa set compensation 0.5"
        )

    def plan_dict(self) -> dict[str, Any]:
        """Return the planned run in JSON types."""
        settings = self._settings
        return {
            "schema": 1,
            "axis": self.axis.name,
            "model": str(self.path),
            "bounds": {
                "torque": self.bounds.torque,
                "speed": self.bounds.speed,
                "travel": None if self.bounds.travel is None else list(self.bounds.travel),
            },
            "seconds": {
                "probe": PROBE_SECONDS,
                "excitation": settings.seconds,
                "shake": SHAKE_SECONDS,
                **({"routing": sum(seconds for _, seconds in routing_runs(settings))} if settings.others else {}),
                "verification": 3.0 * settings.verification_seconds,
            },
            "compensation": settings.compensation,
        }

    def plan_text(self) -> str:
        """Return the planned run as text."""
        bounds, settings = self.bounds, self._settings
        wave = (
            f"at {', '.join(f'{f:g}' for f in FREQUENCIES)} Hz" if settings.excitation is None else "of the given file"
        )
        travel = "any" if bounds.travel is None else f"{bounds.travel[0]:g} to {bounds.travel[1]:g} rad"
        moved = [f"   {seconds:g} s while {what} moves" for what, seconds in routing_runs(settings)]
        return "\n".join(
            (
                f"axis {self.axis.name}, model file {self.path}",
                f"limits: {bounds.torque:.3g} N*m at the joint, {bounds.speed:g} rad/s, travel {travel}",
                f"1. probe, {PROBE_SECONDS:g} s with a fifth of the torque: determine whether the joint moves, and "
                "what moves it",
                f"2. shake the motor slightly, {SHAKE_SECONDS:g} s: delay, motor inertia, stiffness of the tendons",
                f"3. excitation, {settings.seconds:.4g} s {wave}, without compensation, and estimate: friction angle, "
                "pretension, where the sheath bends; turn, lead and damping with a gain margin of 2",
                *moved,
                f"4. verification, 3 x {settings.verification_seconds:g} s at "
                f"{', '.join(f'{f:g}' for f in OTHER_FREQUENCIES)} Hz: without compensation, with the given and with "
                f"the new file at {settings.compensation:g} of the friction term",
                "5. show the changes of the model file and of the controller file, and ask before writing",
                "dry run: nothing was moved or written",
            )
        )

    @contextlib.contextmanager
    def workspace(self, out: Path | None, keep: bool) -> Iterator[None]:
        """Provide a temporary folder for all files of the run, and remove it unless `finish` moves it into place."""
        final = out if out is not None else untaken(self._configuration.log_folder, "tune")
        if final.exists() and (not final.is_dir() or any(final.iterdir())):
            raise UsageError(f"{final}: exists already and is not empty; choose another --out")
        parent = next(folder for folder in final.resolve().parents if folder.is_dir())
        try:
            temporary = Path(tempfile.mkdtemp(prefix=".tune-", dir=parent))
        except OSError as error:
            raise UsageError(f"{parent}: cannot be written ({error.strerror}); choose another --out") from None
        self._folder, self._final = temporary, final if keep else None
        try:
            yield
        finally:
            shutil.rmtree(temporary, ignore_errors=True)

    def run(self, say: Progress, ask: Ask | None = None) -> Outcome:
        """Run the whole procedure on the rig.

        Args:
            say: function that receives the progress.
            ask: function that asks the user to move the joint; None if no user is present.

        Raises:
            UsageError: The rig or its motion does not permit an estimate.
            BusError: The bus or a run failed.
        """
        self.check_ready()
        runner = self.runner(self._folder, all_axes=bool(self._settings.others))
        law_of = functools.partial(law_tuning, self._configuration, self.axis)
        folder = self._folder
        return Procedure(runner, self.path, self._model, self.bounds, self._settings, law_of, folder, say, ask).run()

    def runner(self, folder: Path, all_axes: bool = False) -> RigRunner:
        """Return a runner that plays waveforms on the axis and writes to `folder`. See `RigRunner` for `all_axes`."""
        by_stretch = self._settings.by_stretch
        return RigRunner(self._configuration, self.axis, self.bounds, folder, self._play(), by_stretch, all_axes)

    @property
    def model(self) -> TendonSheath:
        """Return the parameters in the axis' model file."""
        return self._model

    @property
    def by_stretch(self) -> bool:
        """Return True if no sensor measures the joint torque."""
        return self._settings.by_stretch

    def _play(self) -> Play:
        if self._plant is None:
            return daemon
        from tsa_ctrl.virtual.simulation import play  # the loop and the plant in this process

        numbers = itertools.count(1)

        def played(folder: Path, name: str, seconds: float, tick: Callable[[float], None]) -> dict[str, Any]:
            # One fit uses the logs of the excitation and of these runs. Equal noise would count as more data.
            repetition = next(numbers) if name.startswith(REPEATED) else 0
            return play(folder, name, seconds, tick, self._plant, must_succeed=False, repetition=repetition)

        return played

    def check_ready(self) -> None:
        """Check that the joint torque is measured or can be estimated from the tendon elongation, and check the bus.

        Raises:
            UsageError: The joint torque can be neither measured nor estimated.
            BusError: The bus failed a check.
        """
        if not self.axis.has_torque_sensor and (reason := unsupported_by(self._model, self.axis.encoder is not None)):
            raise UsageError(
                f"{self._configuration.path}: axis '{self.axis.name}' has no joint torque sensor, and {reason}; or "
                "give [axis.torque_sensor] or an [[axis.serial]] of tau_j"
            )
        if self._plant is not None:
            return
        admitted(self._configuration, self._allow_simulated)
        file = self._configuration.file
        profiles = self._configuration.profiles
        for check in can_interface.checks(file.bus_of(self.axis), (self.axis,), file.controller.rate, profiles):
            if check.result is Result.FAIL:
                raise BusError(f"{check.name}: found {check.found}, required {check.wanted}; {check.fix}")

    def from_logs(self, logs: Sequence[str], cutoff: float | None = None) -> Outcome:
        """Return the estimate from existing logs. See `load_log` for `cutoff`. Raise UsageError for unsuitable logs."""
        return from_logs(self.path, self._model, load_logs(logs, cutoff=cutoff), self._settings)

    def changes(self, outcome: Outcome) -> dict[Path, str]:
        """Return the files to be written and their new texts.

        These are the model file and, if keys of [axis.law] were derived, the controller file.
        """
        texts = {self.path: outcome.text}
        if outcome.law is not None:
            configuration = self._configuration
            texts[configuration.path] = with_law(configuration.text, self.axis.name, outcome.law.keys)
        return texts

    def difference(self, outcome: Outcome) -> str:
        """Return the unified diffs of all files to be written."""
        return "".join(diff(path, text) for path, text in self.changes(outcome).items())

    def worth_writing(self, outcome: Outcome) -> bool:
        """Return True if the new file has the smaller error. Raise UsageError if the loop cannot use the file."""
        # The constructor raises UsageError for effects that it cannot invert.
        Feedforward(outcome.estimate.model, self._configuration.period)
        return outcome.better

    def finish(self, outcome: Outcome) -> None:
        """Draw the pictures, write the report, and move the working folder into place if it is kept."""
        pictures = draw(outcome, self._folder)
        write_page(outcome, self.axis.name, self.path, self.difference(outcome), pictures, self._folder / "report.html")
        if self._final is None:
            return
        (self._folder / "drives").unlink(missing_ok=True)
        self._final.parent.mkdir(parents=True, exist_ok=True)
        if self._final.is_dir():
            self._final.rmdir()
        self._folder.chmod(0o755)
        self._folder.rename(self._final)
        self.page = self._final / "report.html"

    def targets(self, outcome: Outcome) -> list[Path]:
        """Return the paths that `write` writes: the rig's files, or new files next to the page of a simulated plant."""
        return list(self.changes(outcome)) if self._plant is None else list(self._simulated(outcome))

    def write(self, outcome: Outcome) -> dict[Path, Path | None]:
        """Write the files, and return the backup of each file, or None for a new file."""
        if self._plant is None:
            return dict(replace(self.changes(outcome), beside=(self._configuration.path,)))
        texts = self._simulated(outcome)
        for path, text in texts.items():
            settings.write_text(path, text)
        return dict.fromkeys(texts)

    def _simulated(self, outcome: Outcome) -> dict[Path, str]:
        """Return the files with the results of a simulated plant. They are next to the page, never the rig's files."""
        assert self._final is not None
        configuration, name = self._configuration, self.path.name
        text = self.changes(outcome).get(configuration.path, configuration.text)
        controller = moved(text, self.axis.name, name, configuration.folder)
        return {self._final / name: outcome.text, self._final / configuration.path.name: controller}
