"""Play motions, each designed for the open question, until one answer remains; report the answer."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from html import escape
from pathlib import Path
from typing import Any

from tsa_ctrl import settings
from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.diagnosis import Diagnosis, diagnose
from tsa_ctrl.identify.diagnosis.report.result import Verdict
from tsa_ctrl.identify.diagnosis.report.words import four_lines
from tsa_ctrl.identify.diagnosis.rivals.groups import UNRECORDED
from tsa_ctrl.identify.three_errors import MORE_THAN_NOISE
from tsa_ctrl.investigate.design import SECONDS, Designer, Experiment, Pair
from tsa_ctrl.investigate.response import Joint, JointModel
from tsa_ctrl.model.catalogue import PARAMETER_ERROR
from tsa_ctrl.model.parameters import RigidDrive
from tsa_ctrl.tune.excitation import MOVING, PROBE_SECONDS, PROBE_SHARES, Bounds, Waveform, probe, response
from tsa_ctrl.tune.run import RigRunner, longest

SEPARATES = 5.0  # standard deviations; a motion with a smaller predicted separation is not played
LEAST_MOTIONS = 2  # an answer must also hold on a second motion
ATTEMPTS = 2  # motions designed for the same pair before it counts as inseparable
OUTSIDE = 3  # motions after which an unexplained error counts as outside the catalogue

JSON, PAGE = "investigation.json", "report.html"
STYLE = (
    "body{font:15px/1.5 sans-serif;max-width:60em;margin:2em auto;padding:0 1em;color:#222}"
    "dl{display:grid;grid-template-columns:max-content 1fr;gap:.2em 1em}dt{font-weight:600}dd{margin:0}"
    "table{border-collapse:collapse}td,th{border:1px solid #ccc;padding:.3em .6em;text-align:left;vertical-align:top}"
)

Play = Callable[[str, Waveform], tuple[Sequence[Dataset], Path]]  # from name and set-point to logs and folder
Progress = Callable[[str, float], None]  # activity, and the completed share


class Answer(Enum):
    """The possible answers of an investigation."""

    NONE = "none"  # the model fits
    CAUSE = "cause"
    GROUP = "group"  # no motion within the limits separates these causes
    OUTSIDE = "outside"  # the cause is outside the catalogue
    INSUFFICIENT = "insufficient"
    STOPPED = "stopped"  # by the user or by the permitted number of motions, with a question open


@dataclass(frozen=True)
class Step:
    """Hold one motion and its diagnosis. `promised`: the predicted separation of each pair, in standard deviations."""

    name: str
    seconds: float
    result: Diagnosis
    folder: Path | None
    promised: Mapping[tuple[str, str], float] = field(default_factory=dict)

    @property
    def hypotheses(self) -> tuple[tuple[str, ...], ...]:
        """Return each cause with its alternatives."""
        return tuple((cause.effect, *cause.alternatives) for cause in self.result.causes)


@dataclass(frozen=True)
class Investigation:
    """Hold the answer, one sentence that states it, and the steps that led to it."""

    answer: Answer
    statement: str
    steps: tuple[Step, ...]

    @property
    def result(self) -> Diagnosis | None:
        """Return the last diagnosis."""
        return self.steps[-1].result if self.steps else None


def investigate(
    play: Play,
    model: JointModel,
    bounds: Bounds,
    most: int,
    seed: int = 0,
    logs: Sequence[Dataset] = (),
    say: Progress = lambda what, share: None,
    write: Callable[[Step], None] = lambda step: None,
    seconds: float = SECONDS,
) -> Investigation:
    """Diagnose `logs`, or a first motion, and play at most `most` motions until one answer remains.

    `seconds`: duration of each motion. `write` receives each step as soon as it is done. A KeyboardInterrupt ends the
    investigation and keeps the result.

    Raises:
        UsageError: the joint does not move, or no motion is possible within `bounds`.
        BusError: a run failed.
    """
    return _Investigator(play, model, bounds, most, seed, say, write, seconds).run(logs)


@dataclass
class _Investigator:
    """Hold the arguments of `investigate`, and the logs and steps so far."""

    _play: Play
    _model: JointModel
    _bounds: Bounds
    _most: int
    _seed: int
    _say: Progress
    _write: Callable[[Step], None]
    _seconds: float
    _logs: list[Dataset] = field(default_factory=list)
    _steps: list[Step] = field(default_factory=list)
    _motions: int = 0
    _attempts: dict[frozenset[str], int] = field(default_factory=dict)

    def run(self, logs: Sequence[Dataset]) -> Investigation:
        try:
            if logs:
                self._logs += logs
                self._diagnose("given logs", sum(log.seconds for log in logs), None, {})
            else:
                self._first()
            while True:
                answer = self._answer()
                if isinstance(answer, Investigation):
                    return answer
                self._perform(f"motion-{self._motions + 1}", answer)
        except KeyboardInterrupt:
            return self._ended(Answer.STOPPED, "stopped by Ctrl-C; the result contains the motions so far")

    def _first(self) -> None:
        """Probe with increasing torque until the joint moves, then cover speeds, loads and angles."""
        for number, share in enumerate(PROBE_SHARES):
            logs, _ = self._played(f"probe-{number + 1}", probe(self._bounds, share, PROBE_SECONDS))
            found = response(longest(logs))
            if found.rms_speed >= MOVING:
                break
        else:
            raise UsageError(
                f"investigate: the joint hardly moves ({found.rms_speed:.3f} rad/s RMS at "
                f"{share * self._bounds.torque:.2g} N*m), so friction cannot be measured; move it, release it, or "
                "allow more --torque"
            )
        designer = Designer(Joint.of(logs, self._model), self._bounds, logs, 1.0, self._seed, self._seconds)
        self._perform("motion-1", designer.best([]))

    def _perform(self, name: str, experiment: Experiment) -> None:
        for pair in experiment.separation:
            key = frozenset(pair)
            self._attempts[key] = self._attempts.get(key, 0) + 1
        self._motions += 1
        logs, folder = self._played(name, experiment.waveform)
        self._logs += logs
        self._diagnose(name, experiment.waveform.seconds, folder, experiment.separation)

    def _played(self, name: str, wave: Waveform) -> tuple[Sequence[Dataset], Path]:
        self._say(name, min(1.0, self._motions / self._most))
        return self._play(name, wave)

    def _diagnose(
        self, name: str, seconds: float, folder: Path | None, promised: Mapping[tuple[str, str], float]
    ) -> None:
        self._say(f"diagnosis after {name}", min(1.0, self._motions / self._most))
        result = diagnose(self._logs, self._model, seed=self._seed)
        self._steps.append(Step(name, seconds, result, folder, promised))
        self._write(self._steps[-1])

    def _answer(self) -> Investigation | Experiment:
        """Return the result, or the next motion."""
        result = self._steps[-1].result
        pairs, why = open_pairs(result), "no motion separates them without column temperature; log the temperature"
        predictable = [pair for pair in pairs if not self._needs_temperature(pair)]
        if predictable:
            if self._motions >= self._most:
                more = f"not separated in {self._most} motions; allow more with --most"
                return self._ended(Answer.STOPPED, f"{_group(predictable)}: {more}")
            found = self._separating_motion(predictable)
            if isinstance(found, Experiment):
                return found
            why = f"no motion on this rig separates them; {found}"
        left = unexplained_while_sliding(result)
        needed = 0 if predictable else LEAST_MOTIONS
        if left or result.verdict is Verdict.INSUFFICIENT:
            needed = OUTSIDE
        if self._motions < min(needed, self._most):
            return self._designer(result).best([])
        named = " and ".join(" or ".join((cause.effect, *cause.alternatives)) for cause in result.causes)
        if result.verdict is Verdict.INSUFFICIENT:
            return self._ended(Answer.INSUFFICIENT, result.sentence.rstrip("."))
        if left:
            beside = f"in addition to {named}, " if named else ""
            return self._ended(Answer.OUTSIDE, f"{beside}an effect outside the catalogue acts: {result.unexplained}")
        if pairs:
            return self._ended(Answer.GROUP, f"{_group(predictable or pairs)}: {why}")
        if named:
            return self._ended(Answer.CAUSE, f"the cause is {named}")
        beside = "; the remaining error lies in reversals" if result.verdict is Verdict.UNEXPLAINED else ""
        return self._ended(Answer.NONE, f"the recalibrated model leaves only noise while the joint slides{beside}")

    def _separating_motion(self, pairs: Sequence[Pair]) -> Experiment | str:
        """Return the motion that separates the hypotheses, or the reason why no motion does."""
        untried = [pair for pair in pairs if self._attempts.get(frozenset(pair.names), 0) < ATTEMPTS]
        if not untried:
            return f"{ATTEMPTS} motions designed for this did not separate them"
        experiment = self._designer(self._steps[-1].result).best(untried)
        size = max(experiment.separation.values())
        if size >= SEPARATES:
            return experiment
        return f"the best motion within the limits would separate them by {size:.2g} standard deviations"

    def _needs_temperature(self, pair: Pair) -> bool:
        """Return True if the diagnosis invented the temperature of the competing hypothesis, which is not logged."""
        return UNRECORDED in pair.names and not all("temperature" in log for log in self._logs)

    def _designer(self, result: Diagnosis) -> Designer:
        noise = result.rms.extended or result.rms.recalibrated or 1.0
        assert not isinstance(result.model, RigidDrive)  # it is of the same kind as self._model
        joint = Joint.of(self._logs, result.model)
        return Designer(joint, self._bounds, self._logs, noise, self._seed + self._motions + 1, self._seconds)

    def _ended(self, answer: Answer, statement: str) -> Investigation:
        return Investigation(answer, statement, tuple(self._steps))


def _group(pairs: Sequence[Pair]) -> str:
    return " or ".join(dict.fromkeys(name for pair in pairs for name in pair.names))


def unexplained_while_sliding(result: Diagnosis) -> bool:
    """Return True if the sliding error and the held-out error both exceed MORE_THAN_NOISE times the sensor noise.

    The result is also True if the verdict leaves an error but the errors or the noise are unknown. Errors at reversals
    do not count, because no model reproduces these moments exactly.
    """
    if result.verdict not in (Verdict.UNEXPLAINED, Verdict.PARTLY_EXPLAINED):
        return False
    errors = [error for error in (result.errors.sliding, result.rms.extended) if error is not None]
    noise = result.errors.sensor_noise
    return not errors or noise is None or min(errors) > MORE_THAN_NOISE * noise


def open_pairs(result: Diagnosis) -> list[Pair]:
    """Return each cause with each remaining alternative, as models.

    `parameter_error` is omitted, because the parameters of the base model are determined by calibration.
    """
    assert not isinstance(result.model, RigidDrive)
    return [
        Pair((cause.effect, name), result.model, rival)
        for cause in result.of_torque
        for name, rival in cause.rivals.items()
        if not isinstance(rival, RigidDrive) and name != PARAMETER_ERROR
    ]


def on_the_rig(runner_of: Callable[[Path], RigRunner], folder: Path, path: Path) -> Play:
    """Return a `Play` that uses one subfolder of `folder` for each motion; `path` is the model file."""

    def play(name: str, wave: Waveform) -> tuple[Sequence[Dataset], Path]:
        own = folder / name
        own.mkdir(parents=True)
        run = runner_of(own).play(name, path, 0.0, wave, lambda share: None, {})
        return run.learnable(), own

    return play


TITLES = {
    Answer.NONE: "no cause found",
    Answer.CAUSE: "the cause was found",
    Answer.GROUP: "causes that this rig cannot separate",
    Answer.OUTSIDE: "a cause outside the catalogue",
    Answer.INSUFFICIENT: "the motions are insufficient",
    Answer.STOPPED: "stopped with an open question",
}


def report_dict(found: Investigation, folder: Path) -> dict[str, Any]:
    """Return the JSON object; paths are relative to `folder`."""
    result = found.result
    return {
        "schema": 1,
        "answer": found.answer.value,
        "statement": found.statement,
        "causes": [] if result is None else result.to_dict()["causes"],
        "motions": sum(step.folder is not None for step in found.steps),
        "seconds": round(sum(step.seconds for step in found.steps if step.folder is not None), 3),
        "steps": [_step(step, folder) for step in found.steps],
        "report": PAGE,
    }


def _step(step: Step, folder: Path) -> dict[str, Any]:
    return {
        "name": step.name,
        "seconds": round(step.seconds, 3),
        "verdict": step.result.verdict.value,
        "hypotheses": [list(names) for names in step.hypotheses],
        "separation": {f"{a} or {b}": round(size, 2) for (a, b), size in step.promised.items()},
        "folder": None if step.folder is None else str(step.folder.relative_to(folder)),
    }


def write_report(found: Investigation, folder: Path) -> Path:
    """Write JSON and page to `folder`; return the page."""
    settings.write_text(folder / JSON, json.dumps(report_dict(found, folder), indent=2, allow_nan=False) + "\n")
    page = folder / PAGE
    settings.write_text(page, _page(found, folder))
    return page


def _page(found: Investigation, folder: Path) -> str:
    rows = "\n".join(_row(step, folder) for step in found.steps)
    title = f"Investigation: {TITLES[found.answer]}"
    statement = escape(found.statement[:1].upper() + found.statement[1:])
    lines = {} if found.result is None else four_lines(found.result)
    summary = "".join(f"<dt>{name}</dt><dd>{escape(line)}</dd>" for name, line in lines.items())
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title><style>{STYLE}</style>'
        f"</head><body>\n<h1>{title}</h1>\n<p>{statement}.</p>\n<dl>{summary}</dl>\n"
        "<table><tr><th>motion</th><th>seconds</th><th>expected separation (standard deviations)</th><th>verdict</th>"
        f"<th>causes, with alternatives</th></tr>\n{rows}\n</table>\n</body></html>\n"
    )


def _row(step: Step, folder: Path) -> str:
    name = escape(step.name)
    if step.folder is not None:
        name = f'<a href="{escape(str(step.folder.relative_to(folder)))}/report.html">{name}</a>'
    made = "; ".join(f"{a} or {b}: {size:.2g}" for (a, b), size in step.promised.items())
    causes = "; ".join(" or ".join(names) for names in step.hypotheses) or "none"
    cells = (name, f"{step.seconds:.3g}", escape(made) or "-", step.result.verdict.value, escape(causes))
    return "<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>"
