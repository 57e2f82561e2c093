"""The guided run: probe, excite, estimate, verify. What it returns is shown to the user, who decides."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.provenance import provenance
from tsa_ctrl.model.parameters import TendonSheath, dump_model
from tsa_ctrl.tune.estimate import Estimate, estimate, extended
from tsa_ctrl.tune.excitation import MOVING, PROBE_SHARES, Bounds, Design, Waveform, design, playing, probe, response
from tsa_ctrl.tune.run import RigRunner, Run, longest

PROBE_SECONDS = 6.0
Progress = Callable[[str, float], None]  # what is being done, share of the whole that is done


@dataclass(frozen=True)
class Settings:
    """What the user decides; s and N*m."""

    seconds: float  # of the excitation
    verification_seconds: float
    compensation: float  # share of the friction term in the verification, as the loop would use it
    certified_gain: bool
    forms: bool
    extended: bool
    excitation: Waveform | None = None  # to play in place of a designed one; then `seconds` are its own


@dataclass(frozen=True)
class Verification:
    """The same motion without compensation, with the given file and with the new one."""

    without: Run
    before: Run
    after: Run

    def reduction(self, run: Run) -> float:
        """Per cent by which compensation reduces the RMS joint torque error."""
        return 100.0 * (1.0 - run.rms / self.without.rms)


@dataclass(frozen=True)
class Outcome:
    """Everything that was found; `text` is the new model file."""

    nominal: TendonSheath
    estimate: Estimate
    logs: tuple[Dataset, ...]
    design: Design | None  # None when the logs were given
    verification: Verification | None
    text: str

    @property
    def better(self) -> bool:
        """Whether the new file does better on data that it was not made from."""
        if self.verification is not None:
            return self.verification.after.rms < self.verification.before.rms
        return self.estimate.calibration.rms_after < self.estimate.calibration.rms_before


class Procedure:
    """The stages on one rig, in order; each run's share of the time is told."""

    def __init__(
        self,
        runner: RigRunner,
        path: Path,
        model: TendonSheath,
        bounds: Bounds,
        settings: Settings,
        folder: Path,
        say: Progress,
    ) -> None:
        """`path` is the axis' model file and `model` what it says; the new one is tried from `folder`."""
        self._runner = runner
        self._path = path
        self._model = model
        self._bounds = bounds
        self._settings = settings
        self._folder = folder
        self._say = say
        self._total = 2.0 * PROBE_SECONDS + settings.seconds + 3.0 * settings.verification_seconds
        self._done = 0.0

    def run(self) -> Outcome:
        """Probe, excite, estimate and verify.

        Raises UsageError when the rig cannot show what is wanted, BusError when a run fails.
        """
        designed = self._design()
        excited = self._play("excitation", self._path, 0.0, designed.excitation)
        self._say("estimate", self._done / self._total)
        found = learn(excited.learnable(), self._model, self._settings)
        text = new_file(self._path, found, excited.pieces, "tune")
        new = self._folder / f"new-{self._path.name}"
        new.write_text(text, encoding="utf-8")
        factor, motion = self._settings.compensation, designed.verification
        verification = Verification(
            without=self._play("without", self._path, 0.0, motion),
            before=self._play("before", self._path, factor, motion),
            after=self._play("after", new, factor, motion),
        )
        return Outcome(self._model, found, excited.pieces, designed, verification, text)

    def _design(self) -> Design:
        """Little torque first, more until the joint moves."""
        for number, share in enumerate(PROBE_SHARES):
            wave = probe(self._bounds, share, PROBE_SECONDS)
            found = response(longest(self._play(f"probe-{number + 1}", self._path, 0.0, wave).learnable()))
            if found.rms_speed >= MOVING:
                break
        settings = self._settings
        designed = design(found, wave.peak, self._bounds, settings.seconds, settings.verification_seconds)
        return designed if settings.excitation is None else playing(designed, settings.excitation)

    def _play(self, name: str, model: Path, compensation: float, waveform: Waveform) -> Run:
        seconds, begin = waveform.seconds, self._done

        def tick(share: float) -> None:
            self._say(name, min(1.0, (begin + share * seconds) / self._total))

        tick(0.0)
        played = self._runner.play(name, model, compensation, waveform, tick)
        self._done += seconds
        return played


def from_logs(path: Path, model: TendonSheath, logs: Sequence[Dataset], settings: Settings) -> Outcome:
    """The estimate alone, from logs that exist; nothing moves."""
    found = learn(logs, model, settings)
    return Outcome(model, found, tuple(logs), None, None, new_file(path, found, logs, "tune --from-log"))


def learn(logs: Sequence[Dataset], model: TendonSheath, settings: Settings) -> Estimate:
    """The new model from logs; raises UsageError when they do not show enough."""
    found = estimate(logs, model, settings.certified_gain, settings.forms)
    return extended(logs, model, found) if settings.extended else found


def new_file(path: Path, found: Estimate, logs: Sequence[Dataset], command: str) -> str:
    """Text of the new model file: the old one's comments and layout, the new numbers, and where they came from."""
    result = found.calibration
    how = {"split": result.split, "form": found.form.value, "effects": list(found.effects)}
    source = provenance(command, logs, path, {**result.quantities, **found.parameters}, **how)
    return dump_model(found.model, template=path, provenance=source)
