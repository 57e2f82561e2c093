"""Run the phases of a tuning on a rig: probe, shake, excitation, estimate and verification."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import BusError, TooStillError, UsageError
from tsa_ctrl.identify.calibrate import errors_of, routing_of_logs
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.provenance import provenance
from tsa_ctrl.identify.quantity import BLOCKS, Quantity, jackknife, rounded
from tsa_ctrl.identify.three_errors import ThreeErrors
from tsa_ctrl.model.parameters import TendonSheath, dump_model
from tsa_ctrl.model.provenance import Origin
from tsa_ctrl.model.steady_sliding import sliding, sliding_stiffness, wound_by_friction
from tsa_ctrl.tune.by_stretch import beside_stretch, estimate_by_stretch, moved_by_hand
from tsa_ctrl.tune.estimate import Estimate, beyond_joint, estimate, extended, friction_share
from tsa_ctrl.tune.excitation import (
    MOVED_BY_TORQUE,
    MOVING,
    PROBE_SECONDS,
    PROBE_SHARES,
    RAMP,
    SHAKE_SECONDS,
    Bounds,
    Design,
    Waveform,
    design,
    fading,
    multi_sine,
    playing,
    probe,
    response,
)
from tsa_ctrl.tune.mechanics import FEEDBACK_KEY, MOTOR, LawTuning, Mechanics, bearable, measured, pulling, stiffened
from tsa_ctrl.tune.ripple import with_torque_ripple
from tsa_ctrl.tune.run import RigRunner, Run, TrippedError, longest

# Ratio of the pulley radii r_J/r_M, from the angles of motor and joint over the travel.
#
# While the tendons slide in one direction, the motor angle is linear by (3.37)-(3.41).
#
# q_M = (r_J/r_M) q_J + tau_M / K - sigma g + omega_J late + zero
#
# It contains the elongation by torque and friction, and the delay `late` between the two encoders. A regression over
# both directions separates these terms from the ratio. Each log has its own zero. If the torque follows the angle, as
# with a spring, a wrong ratio cannot be distinguished from a wrong stiffness. The elongation is then computed from the
# file's stiffness and its uncertainty. A file contains the radii of the metal. The effective radii at the tendons are
# larger, by half a tendon diameter and by the windings.

FloatArray = NDArray[np.float64]

NEEDED = frozenset({"q_m", "q_j", "omega_j", "tau_m"})
LEAST_ROWS = 200  # least number of sliding samples, so that the interval is meaningful
UNWOUND = 2.0  # times the joint travel that the file's friction takes up in a reversal; then the tendons must slide
NOISE_MEDIAN = 1.652  # 1, median magnitude of a second difference of noise over its standard deviation
OWN = 5.0  # times its noise, least independent variation of the torque: noise then reduces the slope by 4 %
WANTED = 0.002  # 1, largest half width of the interval over the ratio for which the ratio is corrected
REPORTED = 0.01  # 1, smallest correction that is reported; smaller ones are within the tolerance of a pulley
WRONG = 0.05  # 1, largest correction: beyond it a pulley, the order of the radii or an encoder's counts are wrong


def radius_ratio(logs: Sequence[Dataset], model: TendonSheath) -> Quantity | None:
    """Return r_J/r_M with its 95 % interval, or None if a log lacks a required column or too few samples slide."""
    if not all(set(log.columns) >= NEEDED for log in logs):
        return None
    gear = model.joint_pulley_radius / model.motor_pulley_radius
    parts = [_rows(log, model, gear) for log in logs]
    count = len(parts)
    columns = np.concatenate([_with_zero(rows, index, count) for index, (rows, _) in enumerate(parts)])
    beyond = np.concatenate([given for _, given in parts])
    if beyond.size < LEAST_ROWS or np.linalg.matrix_rank(columns) < columns.shape[1]:
        return None
    follows = _follows(columns)
    doubt = 0.0
    if follows is not None:  # N*m/rad: the torque depends on the angle only
        compliance = 1.0 / sliding_stiffness(model)
        beyond = beyond - compliance * columns[:, 1]
        columns = np.delete(columns, 1, axis=1)
        doubt = 2.0 * model.axial_stiffness_uncertainty * compliance * abs(follows)
    scale = np.abs(columns).max(axis=0)
    pieces = np.array_split(np.arange(beyond.size), BLOCKS)
    scaled = columns / scale
    parts = [(scaled[piece].T @ scaled[piece], scaled[piece].T @ beyond[piece]) for piece in pieces]
    value, half = jackknife(parts, lambda squares, products: _first(squares, products) / scale[0])
    half += doubt
    return Quantity(gear + value, gear + value - half, gear + value + half, "1")


def with_ratio(model: TendonSheath, found: Quantity | None) -> tuple[TendonSheath, tuple[str, ...]]:
    """Return the model with its joint pulley radius corrected to the measured ratio, and notes for the report.

    Raises:
        UsageError: The angles contradict the file by more than `WRONG`.
    """
    if found is None:
        return model, ()
    file = model.joint_pulley_radius / model.motor_pulley_radius
    correction = found.value / file - 1.0
    if abs(correction) > WRONG and not found.low <= file <= found.high:
        exchanged = abs(found.value * file - 1.0) < WRONG
        hint = (
            "the two radii are exchanged"
            if exchanged
            else "correct motor_pulley_radius or joint_pulley_radius, or gear_ratio and counts_per_revolution of drive "
            "and encoder"
        )
        raise UsageError(
            f"{model.source}: [actuator] joint_pulley_radius over motor_pulley_radius is {file:.4g}, but the angles "
            f"of motor and joint give {found}; the allowed difference is {100.0 * WRONG:g} %: {hint}"
        )
    if found.share > WANTED:
        return model, (
            f"r_J/r_M is known only to {100.0 * found.share:.2g} %, so the file's value is kept: more travel of the "
            "joint determines it",
        )
    radius = rounded(found.value * model.motor_pulley_radius, found.share)
    notes = (
        f"r_J/r_M is {found}, {100.0 * correction:+.2g} % from the file's {file:.4g}: joint_pulley_radius is adapted",
    )
    return dataclasses.replace(model, joint_pulley_radius=radius), notes if abs(correction) > REPORTED else ()


def _rows(log: Dataset, model: TendonSheath, gear: float) -> tuple[FloatArray, FloatArray]:
    """Return regressors q_J, tau_M, sigma, omega_J (n, 4) and q_M - gear q_J (n), where the tendons slide.

    The column sigma is scaled by the model's friction torque at the present wrap angle.
    """
    angle, speed = log["q_j"], log["omega_j"]
    direction = np.sign(speed)
    turns = np.concatenate([[True], direction[1:] != direction[:-1]])
    since = np.maximum.accumulate(np.where(turns, np.arange(angle.size), 0))  # the last reversal before each sample
    way = UNWOUND * wound_by_friction(model) / gear
    slides = (direction != 0.0) & (np.abs(angle - angle[since]) > way)
    completed = log.completed_for(model)
    share = friction_share(completed, model)
    columns = np.column_stack((angle, log["tau_m"], direction * share, speed))
    return columns[slides], beyond_joint(completed, model)[slides]


def _follows(columns: FloatArray) -> float | None:
    """Return dtau_M/dq_J (N*m/rad) if the other columns determine the torque except for noise, or None otherwise."""
    torque, others = columns[:, 1], np.delete(columns, 1, axis=1)
    line, *_ = np.linalg.lstsq(others, torque, rcond=None)
    noise = float(np.median(np.abs(np.diff(torque, 2)))) / NOISE_MEDIAN
    own = float(np.sqrt(np.mean(np.square(torque - others @ line))))
    return None if own > OWN * noise else float(line[0])


def _with_zero(rows: FloatArray, index: int, count: int) -> FloatArray:
    """Return the regressors of log number `index` with `count` additional columns, one for the zero of each log."""
    zeros = np.zeros((rows.shape[0], count))
    zeros[:, index] = 1.0
    return np.hstack((rows, zeros))


def _first(squares: FloatArray, products: FloatArray) -> float:
    """Return the first coefficient of a regression from its normal equations."""
    return float(np.linalg.lstsq(squares, products, rcond=None)[0][0])


SHARE = 0.04  # amplitude of the sweeps, as a share of the permitted joint torque
LOWEST = 10.0  # Hz
HIGHEST = 0.27  # as a share of the loop rate: the zero-order hold attenuates higher frequencies
SWEEP = 1.1  # s, duration of one sweep; not a fraction of a step of the slow torque


def shaken(slow: Waveform, peak: float, period: float) -> Waveform:
    """Return the slow waveform with fast sweeps of `peak` N*m added, sampled at the loop's `period` (s).

    The sweeps make delay, inertia and stiffness identifiable, and pass each frequency too quickly to excite a
    resonance. They repeat at different joint positions, and the slow torque keeps a free joint moving.
    """
    t = np.arange(0.0, slow.seconds, period)
    since = np.mod(t, SWEEP)
    highest = HIGHEST / period
    phase = 2.0 * np.pi * (LOWEST + 0.5 * (highest - LOWEST) / SWEEP * since) * since
    return Waveform(t, np.interp(t, slow.t, slow.tau_j_des) + peak * fading(t) * np.sin(phase))


def fastest(peak: float, period: float) -> float:
    """Return the set-point rate (N*m/s) that the highest frequency of a sweep requires."""
    return 2.0 * np.pi * HIGHEST / period * peak * 1.5


STIFFNESS = "axial_stiffness"
BARE: Mapping[str, None] = dict.fromkeys(MOTOR)  # removes the keys that describe and damp the motor from [axis.law]
LawOf = Callable[[Estimate, Mechanics], LawTuning | None]
Progress = Callable[[str, float], None]  # phase, completed share of the whole run
Ask = Callable[[str], None]  # shows an instruction and returns when the user is ready
PHASES = ("probe", "shake", "excitation", "routing", "estimate", "without", "before", "after")
OTHER_JOINTS = (0.37, 0.61, 0.97)  # Hz of the torques of other joints: different from the excitation's frequencies
LEAST_SWING = 0.1  # rad, least standard deviation of another joint's angle that shows how it bends the sheath


@dataclass(frozen=True)
class Settings:
    """The user's settings of a tuning."""

    seconds: float  # s, duration of the excitation
    verification_seconds: float  # s, duration of one verification run
    compensation: float  # 1, share of the friction term in the verification, as the loop would use it
    period: float  # s, period of the loop
    certified_gain: bool  # the gain of the torque channels is certified
    forms: bool  # also estimate where the sheath bends and the lag of the velocity
    extended: bool  # also add the effects that a diagnosis identifies
    by_stretch: bool = False  # estimate the joint torque from the tendon elongation, for a rig without a sensor
    excitation: Waveform | None = None  # played instead of a designed one; `seconds` is then its duration
    others: Mapping[str, Bounds] = dataclasses.field(default_factory=dict)  # other joints that may bend the sheaths


@dataclass(frozen=True)
class Verification:
    """The runs of one motion: without compensation, with the given file, and with the new file.

    If a fault ended the run with the given file, `before` is None and `fault` is its cause.
    """

    without: Run
    before: Run | None
    after: Run
    fault: str = ""

    def reduction(self, run: Run) -> float:
        """Return the reduction of the RMS joint torque error by the compensation, %."""
        return 100.0 * (1.0 - run.rms / self.without.rms)


@dataclass(frozen=True)
class Outcome:
    """The results of a tuning. `text` is the new model file, and `law` has the new keys of the controller file."""

    nominal: TendonSheath
    estimate: Estimate
    logs: tuple[Dataset, ...]
    design: Design | None  # None for an estimate from existing logs
    verification: Verification | None
    text: str
    law: LawTuning | None = None

    @functools.cached_property
    def errors(self) -> ThreeErrors:
        """Return the errors of the new model on the excitation, whose motor torque excludes the acceleration torque."""
        return errors_of(self.logs, self.estimate.model)

    @property
    def better(self) -> bool:
        """Return True if the new file has the smaller error on data that was not used for the estimate."""
        if self.verification is not None:
            before = self.verification.before
            return before is None or self.verification.after.rms < before.rms
        return self.estimate.calibration.better


@dataclass(frozen=True)
class _Trial:
    """A new model file that is tried on the rig."""

    kind: str  # suffix of the names of its file and its run
    found: Estimate
    law: LawTuning | None
    text: str
    played: tuple[Path, float]  # the file and the applied share of its friction term, 1
    bearable: float  # permitted share of the given file's friction term, 1

    @property
    def has_feedback(self) -> bool:
        """Return True if the law corrects the friction term by the joint torque sensor."""
        return self.law is not None and FEEDBACK_KEY in self.law.keys

    def without_feedback(self) -> _Trial:
        """Return the same trial without that correction."""
        assert self.law is not None
        keys = {name: key for name, key in self.law.keys.items() if name != FEEDBACK_KEY}
        return dataclasses.replace(self, kind=f"{self.kind}-open", law=dataclasses.replace(self.law, keys=keys))

    @property
    def values(self) -> Mapping[str, float | None] | None:
        """Return the values for [axis.law], which may include the compensation, or None if nothing was derived."""
        return None if self.law is None else self.law.values


class Procedure:
    """Run the phases on one rig in order and report the progress."""

    def __init__(
        self,
        runner: RigRunner,
        path: Path,
        model: TendonSheath,
        bounds: Bounds,
        settings: Settings,
        law_of: LawOf,
        folder: Path,
        say: Progress,
        ask: Ask | None = None,
    ) -> None:
        """Prepare the phases. Nothing moves yet.

        Args:
            runner: runner that plays waveforms on the axis.
            path: model file of the axis.
            model: parameters in that file.
            bounds: permitted torque, speed and travel of the joint.
            settings: the user's settings.
            law_of: function that returns the keys of [axis.law] for an estimate and the measurements of the motor.
            folder: folder in which the new model file is written for its trial.
            say: function that receives the progress.
            ask: function that asks the user to move the joint; None if no user is present.
        """
        self._runner = runner
        self._path = path
        self._model = model
        self._bounds = bounds
        self._settings = settings
        self._law_of = law_of
        self._folder = folder
        self._say = say
        self._ask = ask
        self._total = PROBE_SECONDS + SHAKE_SECONDS + settings.seconds + 3.0 * settings.verification_seconds
        self._total += sum(seconds for _, seconds in routing_runs(settings))
        self._done = 0.0
        self._others: dict[str, Waveform] = {}  # torques of the other joints by name

    def run(self) -> Outcome:
        """Probe, shake, excite, estimate and verify.

        Raises:
            UsageError: The rig's motion is not sufficient for an estimate.
            BusError: A run failed.
        """
        designed = self._design()
        mechanics = self._shake(designed.shake)
        self._others = {name: self._moving(name, bounds) for name, bounds in self._settings.others.items()}
        logs, learned = self._excite(designed.excitation, mechanics)
        learned = self._with_stiffness(logs, learned, mechanics)
        trials = [self._trial(learned, mechanics, logs)]
        if learned.plain is not None:
            trials.append(self._trial(learned.plain, mechanics, logs, "-plain"))
        if trials[0].has_feedback:
            trials.append(trials[0].without_feedback())
        permitted = trials[-1].bearable
        rippled = None if self._settings.by_stretch else with_torque_ripple(learned, logs)
        if rippled is not None:
            trials.append(self._trial(rippled, mechanics, logs, "-ripple"))
        self._total += (len(trials) - 1) * self._settings.verification_seconds
        motion = designed.verification
        without = self._play("without", self._path, 0.0, motion, BARE, others=self._others)
        before, fault = self._tried("before", self._path, permitted, motion)
        tried = [self._tried(f"after{trial.kind}", *trial.played, motion, trial.values) for trial in trials]
        errors = [np.inf if run is None else run.rms for run, _ in tried]
        best = int(np.argmin(errors))
        after = tried[best][0]
        if after is None:
            raise BusError(f"a fault ended the verification run with the new file: {tried[0][1]}; nothing is written")
        found = trials[best].found
        tripped = [cause for run, cause in tried if run is None]
        if learned.plain is not None and found.effects == learned.plain.effects:
            found = dataclasses.replace(found, notes=(*found.notes, _worse(learned, errors[0], errors[best])))
        if trials[0].has_feedback and not trials[best].has_feedback:
            note = (
                "law.feedback is not used: on a motion not used for the fit the error is "
                f"{_milli(errors[0])} with the correction by the joint torque sensor, and "
                f"{_milli(errors[best])} without"
            )
            found = dataclasses.replace(found, notes=(*found.notes, note))
        if rippled is not None and trials[best].kind != "-ripple":
            note = (
                f"{rippled.notes[-1].split(';')[0]}. It is not written: on a motion not used for the fit the error is "
                f"{_milli(errors[-1])} with it and {_milli(errors[best])} without"
            )
            found = dataclasses.replace(found, notes=(*found.notes, note))
        agreeing = _agreeing(after, found)
        if agreeing and not self._settings.by_stretch:
            found = dataclasses.replace(found, notes=(*found.notes, agreeing))
        if tripped:
            note = f"a fault ended {len(tripped)} of {len(tried)} verification runs with new files: {tripped[0]}"
            found = dataclasses.replace(found, notes=(*found.notes, note))
        verification = Verification(without, before, after, fault)
        return Outcome(self._model, found, logs, designed, verification, trials[best].text, trials[best].law)

    def _with_stiffness(self, logs: Sequence[Dataset], learned: Estimate, mechanics: Mechanics) -> Estimate:
        """Return the estimate, repeated with the measured stiffness if this separates friction angle and pretension.

        The stiffness determines dT_p/dTheta, which the torques separate poorly from the gains of other joints. The
        interval of the measurement is used if it is narrower than the file's [uncertainty], which the result keeps.
        """
        if not learned.calibration.split or mechanics.swing is None:
            return learned
        found, given = stiff(learned, mechanics), self._model.axial_stiffness_uncertainty
        share = found.parameters[STIFFNESS].share if STIFFNESS in found.parameters else given
        model = dataclasses.replace(
            self._model,
            axial_stiffness=found.model.axial_stiffness,
            axial_stiffness_uncertainty=min(share, given),
        )
        return _with_uncertainty(learn(logs, model, self._settings), given)

    def _trial(self, learned: Estimate, mechanics: Mechanics, logs: Sequence[Dataset], kind: str = "") -> _Trial:
        """Write the model file of an estimate for its trial, and return the inputs of the verification run."""
        found = stiff(learned, mechanics)
        law = self._law_of(found, mechanics)
        factor = self._settings.compensation
        tried, reason = bearable(factor, self._model, found)
        notes = (*(mechanics.notes if law is None else law.notes), *([reason] if reason else []))
        found = dataclasses.replace(found, notes=(*found.notes, *notes))
        text = new_file(self._path, found, logs, "tune", law, self._runner.origin)
        new = self._folder / f"new{kind}-{self._path.name}"
        new.write_text(text, encoding="utf-8")
        return _Trial(kind, found, law, text, (new, factor), tried)

    def _excite(self, wave: Waveform, mechanics: Mechanics) -> tuple[tuple[Dataset, ...], Estimate]:
        """Play the excitation, and return its logs and the estimate.

        If the joint of a rig without a torque sensor moves too little, the user moves it during a second excitation.
        """
        first = self._excitation("excitation", wave, mechanics)
        for name, joints in self._together():
            first += self._excitation(name, wave, mechanics, joints)
        try:
            return first, learn(first, self._model, self._settings)
        except TooStillError as error:
            if not self._settings.by_stretch:
                raise
            cure = moved_by_hand(self._bounds.torque)
            if self._ask is None:
                more = "and start again, or give logs of such motion by --from-log"
                raise TooStillError(f"{error}; {cure}, {more}") from None
        self._ask(f"{cure}, until the runs have ended")
        self._total += wave.seconds
        second = self._excitation("excitation-moved", wave, mechanics)
        try:
            return (*first, *second), learn((*first, *second), self._model, self._settings)
        except TooStillError:  # the first logs may be unusable
            return second, learn(second, self._model, self._settings)

    def _together(self) -> list[tuple[str, dict[str, Waveform]]]:
        """Return name and torques of each run with other joints: first each joint alone, then all of them."""
        alone = [(f"routing-{name}", {name: wave}) for name, wave in self._others.items()]
        return [*alone, ("routing-all", self._others)] if len(alone) > 1 else alone

    def _moving(self, name: str, bounds: Bounds) -> Waveform:
        """Return the torque that moves another joint within its limits.

        The user must move a joint that its own torque does not move.

        Raises:
            UsageError: The joint does not move, and no user is present.
        """
        own = probe(self._bounds, PROBE_SHARES[0], PROBE_SECONDS)
        for number, share in enumerate(PROBE_SHARES):
            wave = probe(bounds, share, PROBE_SECONDS)
            run = f"routing-probe-{name}-{number + 1}"
            self._play(run, self._path, 0.0, own, BARE, others={name: wave})
            motion = self._runner.motion_of(run, name)
            if float(np.std(motion["q_j"])) > LEAST_SWING:
                break
        else:
            if self._ask is None:
                raise UsageError(
                    f"tune: joint '{name}' moves by less than {LEAST_SWING:g} rad with {wave.peak:.2g} N*m, so its "
                    "effect on the wrap angle cannot be measured; run tsa tune in a terminal and move the joint by "
                    "hand, or give logs of such motion by --from-log"
                )
            self._ask(f"move joint '{name}' by hand, slowly back and forth, until the runs have ended")
            return multi_sine(OTHER_JOINTS, 0.0, self._settings.seconds)
        found = response(motion)
        if found.by_torque < MOVED_BY_TORQUE:  # moved from outside
            return multi_sine(OTHER_JOINTS, 0.0, self._settings.seconds)
        peak = design(found, wave.peak, bounds, self._settings.seconds, 4.0 * RAMP).excitation.peak
        return multi_sine(OTHER_JOINTS, peak, self._settings.seconds)

    def _tried(
        self,
        name: str,
        model: Path,
        compensation: float,
        motion: Waveform,
        law: Mapping[str, float | None] | None = None,
    ) -> tuple[Run | None, str]:
        """Return the verification run of a file, or None and the cause if a fault ended it."""
        try:
            return self._play(name, model, compensation, motion, law, others=self._others), ""
        except TrippedError as error:
            return None, error.cause

    def _excitation(
        self, name: str, wave: Waveform, mechanics: Mechanics, others: Mapping[str, Waveform] | None = None
    ) -> tuple[Dataset, ...]:
        logs = self._play(name, self._path, 0.0, wave, BARE, others=others).learnable()
        self._say(phase("estimate"), self._done / self._total)
        swing = mechanics.swing
        return logs if swing is None else tuple(pulling(log, swing.inertia.value) for log in logs)

    def _shake(self, slow: Waveform) -> Mechanics:
        """Shake the motor, and return the measured quantities. The tuning continues if some are missing."""
        peak, period = SHARE * self._bounds.torque, self._settings.period
        played = self._play("shake", self._path, 0.0, shaken(slow, peak, period), BARE, fastest(peak, period))
        return measured(played.learnable(), self._model)

    def _design(self) -> Design:
        """Probe with increasing torque until the joint moves, and then design the excitation."""
        for number, share in enumerate(PROBE_SHARES):
            wave = probe(self._bounds, share, PROBE_SECONDS)
            played = self._play(f"probe-{number + 1}", self._path, 0.0, wave, BARE)
            found = response(longest(played.learnable()))
            if found.rms_speed >= MOVING:
                break
        settings = self._settings
        designed = design(found, wave.peak, self._bounds, settings.seconds, settings.verification_seconds)
        return designed if settings.excitation is None else playing(designed, settings.excitation)

    def _play(
        self,
        name: str,
        model: Path,
        compensation: float,
        waveform: Waveform,
        law: Mapping[str, float | None] | None = None,
        rate: float | None = None,
        others: Mapping[str, Waveform] | None = None,
    ) -> Run:
        seconds, begin = waveform.seconds, self._done

        def tick(share: float) -> None:
            self._say(phase(name), min(1.0, (begin + share * seconds) / self._total))

        tick(0.0)
        played = self._runner.play(name, model, compensation, waveform, tick, law, rate, others)
        self._done += seconds
        return played


# 1, largest disagreement of elongation and sensor over the friction torque. On six rigs below it, the estimator
# "stretch" has 0.07 to 1.2 times the error of "sensor" after the friction has changed by 25 or 30 %. On a rig with a
# disagreement of 0.07 it has four times the error without a change.
AGREES = 0.03


def _agreeing(run: Run, found: Estimate) -> str:
    """Return a note if the joint torques from the tendon elongation and the sensor agree, or else ""."""
    difference, half_loop = run.disagreement(), abs(sliding(found.model).half_loop)
    if not difference < AGREES * half_loop:
        return ""
    return (
        "the joint torque from the tendon elongation agrees with the sensor within "
        f"{100.0 * difference / half_loop:.1f} % of the "
        'friction torque. On this rig, [axis.estimator] kind = "stretch" detects a change of the friction earlier '
        'than the default "sensor" while the joint is held'
    )


def _milli(error: float) -> str:
    """Return the readable text of an RMS error (N*m), which is infinite for a run that a fault ended."""
    return f"{1e3 * error:.0f} mN·m" if np.isfinite(error) else "unknown (a fault ended the run)"


def _worse(learned: Estimate, first: float, second: float) -> str:
    """Return the note that explains why the effects added by the diagnosis are not written."""
    return (
        f"not used: {' and '.join(learned.effects)}, which the diagnosis identified; on a motion not used for the "
        f"fit the error is {_milli(first)} with and {_milli(second)} without it"
    )


def routing_runs(settings: Settings) -> list[tuple[str, float]]:
    """Return the label and the duration (s) of each run with other joints."""
    names = list(settings.others)
    alone = [run for name in names for run in ((f"probe of {name}", PROBE_SECONDS), (name, settings.seconds))]
    return [*alone, (" and ".join(names), settings.seconds)] if len(names) > 1 else alone


def phase(name: str) -> str:
    """Return the label of a run's phase, for example "phase 3 of 7: excitation"."""
    number = 1 + PHASES.index(name.split("-")[0])
    return f"phase {number} of {len(PHASES)}: {name}"


def from_logs(path: Path, model: TendonSheath, logs: Sequence[Dataset], settings: Settings) -> Outcome:
    """Return the estimate from existing logs, without moving the rig."""
    found = learn(logs, model, settings)
    return Outcome(model, found, tuple(logs), None, None, new_file(path, found, logs, "tune --from-log"))


def learn(logs: Sequence[Dataset], model: TendonSheath, settings: Settings) -> Estimate:
    """Estimate the new model from logs.

    Raises:
        UsageError: The logs contain too little motion, or contradict the pulley radii.
    """
    routed = None if settings.by_stretch else routing_of_logs(logs, model, settings.certified_gain)
    ratio = radius_ratio(logs, model if routed is None else routed)
    model, notes = with_ratio(model, ratio)
    if routed is not None:
        routed = dataclasses.replace(routed, joint_pulley_radius=model.joint_pulley_radius)
    if settings.by_stretch:
        found = estimate_by_stretch(logs, model)
    else:
        found = beside_stretch(estimate(logs, model, settings.certified_gain, settings.forms, routed), logs, model)
        found = extended(logs, model, found) if settings.extended else found
    known = {} if ratio is None else {"radius_ratio": ratio}
    return dataclasses.replace(found, parameters={**known, **found.parameters}, notes=(*notes, *found.notes))


def _with_uncertainty(found: Estimate, share: float) -> Estimate:
    """Return the estimate with the uncertainty `share` (1) of the axial stiffness in all of its models."""
    model = dataclasses.replace(found.model, axial_stiffness_uncertainty=share)
    return dataclasses.replace(
        found,
        model=model,
        calibration=dataclasses.replace(found.calibration, model=model),
        plain=None if found.plain is None else _with_uncertainty(found.plain, share),
    )


def stiff(found: Estimate, mechanics: Mechanics) -> Estimate:
    """Return the estimate with the tendon stiffness from the motor's oscillation, if that was measured."""
    changed = None if mechanics.swing is None else stiffened(found.model, mechanics.swing)
    if changed is None:
        return found
    model, quantity = changed
    return dataclasses.replace(
        found,
        model=model,
        calibration=dataclasses.replace(found.calibration, model=model),
        parameters={**found.parameters, STIFFNESS: quantity},
    )


def new_file(
    path: Path,
    found: Estimate,
    logs: Sequence[Dataset],
    command: str,
    law: LawTuning | None = None,
    origin: Origin | None = None,
) -> str:
    """Return the text of the new model file, with the old comments and layout, the new values and their provenance.

    Args:
        path: old model file.
        found: estimate.
        logs: logs of the estimate.
        command: command that made the file, for its provenance.
        law: derived keys of [axis.law].
        origin: the joint that was tuned; None for existing logs.
    """
    result = found.calibration
    how = {"split": result.split, "form": found.form.value, "effects": list(found.effects)}
    motor = {} if law is None else law.quantities
    source = provenance(command, logs, path, {**result.quantities, **found.parameters, **motor}, origin, **how)
    return dump_model(result.written(found.model), template=path, provenance=source)
