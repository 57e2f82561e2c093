"""The guided run: probe, excite, estimate, verify. What it returns is shown to the user, who decides."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.provenance import provenance
from tsa_ctrl.model.parameters import TendonSheath, dump_model
from tsa_ctrl.tune.estimate import Estimate, estimate, extended
from tsa_ctrl.tune.excitation import MOVING, PROBE_SHARES, Bounds, Design, Waveform, design, playing, probe, response
from tsa_ctrl.tune.lag import EFFECT
from tsa_ctrl.tune.ringing import Turn, ringing, slew_without_ringing, turn_of
from tsa_ctrl.tune.run import RigRunner, Run, longest

PROBE_SECONDS = 6.0
SAME_SLEW = 0.02  # relative; nearer to the one that is there is not worth a change
Progress = Callable[[str, float], None]  # what is being done, share of the whole that is done


@dataclass(frozen=True)
class Settings:
    """What the user decides; s and N*m."""

    seconds: float  # of the excitation
    verification_seconds: float
    compensation: float  # share of the friction term in the verification, as the loop would use it
    slew: float  # N*m/s of the friction term at the motor, as the controller's file has it
    most_slew: float  # N*m/s, what the limiter lets through
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
    """Everything that was found; `text` is the new model file, `turn` another slew for the controller's."""

    nominal: TendonSheath
    estimate: Estimate
    logs: tuple[Dataset, ...]
    design: Design | None  # None when the logs were given
    verification: Verification | None
    text: str
    turn: Turn | None = None

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
        found, turn = self._turn(designed.reversals, found, new)
        slew = None if turn is None else turn.slew
        factor, motion = self._settings.compensation, designed.verification
        verification = Verification(
            without=self._play("without", self._path, 0.0, motion),
            before=self._play("before", self._path, factor, motion),
            after=self._play("after", new, factor, motion, slew),
        )
        return Outcome(self._model, found, excited.pieces, designed, verification, text, turn)

    def _turn(self, motion: Waveform, found: Estimate, new: Path) -> tuple[Estimate, Turn | None]:
        """Where friction turns at once: another slew, if the motor rings and that one does better; and a note."""
        settings = self._settings
        if EFFECT not in found.model.effects or settings.compensation == 0.0:
            return found, None
        self._total += 2.0 * motion.seconds
        turn = turn_of(found.model, settings.compensation)
        first = self._play("turn-1", new, settings.compensation, motion)
        rings = ringing(first.pieces, found.model, turn / settings.slew)
        slew = settings.slew if rings is None else slew_without_ringing(turn, rings.value, settings.most_slew)
        if rings is None or abs(slew - settings.slew) < SAME_SLEW * settings.slew:
            self._total -= motion.seconds
            return found, None
        second = self._play("turn-2", new, settings.compensation, motion, slew)
        tried = Turn(settings.slew, slew, rings, first.rms, second.rms)
        noted = dataclasses.replace(found, notes=(*found.notes, tried.note))
        return noted, tried if tried.better else None

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

    def _play(self, name: str, model: Path, compensation: float, waveform: Waveform, slew: float | None = None) -> Run:
        seconds, begin = waveform.seconds, self._done

        def tick(share: float) -> None:
            self._say(name, min(1.0, (begin + share * seconds) / self._total))

        tick(0.0)
        played = self._runner.play(name, model, compensation, waveform, tick, slew)
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
