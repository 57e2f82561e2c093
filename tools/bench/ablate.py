"""Diagnose a fixed corpus with the code as it is or with one number or rule of the diagnosis changed.

Usage: tools/run bench/ablate [--change MODULE.NAME=VALUE ...] [--only TEXT] [--rows FILE] [--against FILE]

The corpus has blind logs of every family, rigs with several noise seeds, and the measured sets (TSA_DATA, else
../shared/data). A row has the answer, the held-out error in mN*m, and a mark. The mark is 1 for the right cause, and
0.5 for the right cause in a group or an uncertain answer. It is 0 for a wrong answer, and -1 for a single wrong cause
without alternatives. The mark of a measured set is the share of the published causes that were identified.

--change sets a constant of a module in tsa_ctrl.identify.diagnosis in every module that imports it, or makes a function
return the value. Examples are `selection.entry.SMALLEST=0.4` and `selection.forward._plain_steps=()`. --against prints
only the rows that differ from the given file. Rows of the same change in --rows are not run again.
"""

from __future__ import annotations

import ast
import dataclasses
import json
import pickle
import sys
import time
import tomllib
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tests.blind import FAMILIES, case
from tests.blind.cases import Case, finish
from tests.blind.score import QUIET, mark
from tests.blind.two_encoders import names as two_encoder_names
from tests.blind.two_encoders import two_encoder_case
from tools import command
from tools.command import Results, Row
from tools.pin_rows import data
from tsa_ctrl.identify import diagnose
from tsa_ctrl.identify.dataset import load_logs
from tsa_ctrl.model.parameters import load_model, model_from

PACKAGE = "tsa_ctrl.identify.diagnosis."
SEED = 7000  # of the first case; these seeds were not used in development
CACHE = command.ROOT / "out" / "ablate"  # cases are cached, because generating one takes longer than its diagnosis
COUNTS = {"none": 5, "hidden_direction": 1, "single": len(FAMILIES["single"]), "pair": 6, "outside": 9}
COUNTS |= {"confounded": 5, "rigid": 5, "geared": 4, "two_encoders": 5}
LONG: tuple[tuple[str, str], ...] = (
    ("single", "presliding_hysteresis"),
    ("single", "torque_constant_error"),
    ("single", "pretension_relaxation"),
)
LONG += (("pair", "any"), ("outside", "viscoelastic_tendon"), ("outside", "oval_pulley"), ("none", "rich"))
NOISE_SEEDS = 3  # for each rig of SEEDED: one without an effect, and one with each of two effects
SEEDED = ("", "velocity_lag", "stribeck_friction")
# Pattern of the logs, pattern of the held-out logs, model file, and the accepted names of each published cause.
ASYMMETRIC, WEIGHT, OFFSET = "direction_asymmetric_friction", "gravity_load", "torque_offset"
PRESLIDING, LOADED = "presliding_hysteresis", ("load_dependent_friction", "sheath_asymmetry", "tendon_slack")
SETS: dict[str, tuple[str, str | None, str, tuple[tuple[str, ...], ...]]] = {
    "emps": ("emps/*.csv.gz", None, "emps/emps.toml", ((ASYMMETRIC,),)),
    "epos steady": ("epos/steady/*.csv.gz", None, "epos/drive.toml", ((OFFSET,),)),
    "epos start_stop": ("epos/start_stop/*.csv.gz", None, "epos/drive.toml", ((OFFSET,),)),
    "bam": ("bam/*.csv.gz", None, "bam/xl330.toml", ((WEIGHT,),)),
    "bam kp400": ("bam/*.csv.gz", "kp400*", "bam/xl330.toml", ((WEIGHT,),)),
    **{
        f"davinci {load}": (
            "davinci/*_0.3Hz.csv.gz",
            f"load0{load}*",
            "davinci/actuator.toml",
            ((PRESLIDING,), LOADED),
        )
        for load in (10, 30, 50, 70, 90)
    },
    "davinci 0.5 Hz": ("davinci/load0[19]0_0.5Hz.csv.gz", None, "davinci/actuator.toml", ((PRESLIDING,),)),
}
FOLDS = tuple(f"measured {name}" for name, each in SETS.items() if name.startswith("davinci") and each[1])


@dataclasses.dataclass(frozen=True)
class Work:
    """The key of one case, and a function that generates the case. A measured set has no such function."""

    key: str
    draw: Callable[[], Case] | None = None


def corpus() -> Iterator[Work]:
    """Yield every case, starting with the measured sets and the long logs."""
    yield from (Work(f"measured {name}") for name in reversed(SETS))
    for number, (family, name) in enumerate(LONG):
        yield Work(f"long {family} {name}", partial(case, family, name, SEED + 50 + number))
    for effect in SEEDED:
        for seed in range(NOISE_SEEDS):
            yield Work(f"seed {effect or 'none'} {seed}", partial(reseeded, effect, seed))
    for family, count in COUNTS.items():
        names = FAMILIES.get(family) or two_encoder_names()
        for place in range(count):
            name, seed = names[place * len(names) // count if count < len(names) else place % len(names)], SEED + place
            draw = two_encoder_case if family == "two_encoders" else partial(case, family)
            yield Work(f"{family} {name} {seed}", partial(draw, name, seed, True))


def reseeded(effect: str, seed: int) -> Case:
    """Return the log of a fixed rig and motion, with sensor noise that depends on the seed."""
    drawn = case("single", effect, SEED, True) if effect else case("none", "rich", SEED, True)
    assert drawn.bench is not None
    rng = np.random.default_rng(seed)
    return finish(rng, drawn.family, drawn.name, seed, drawn.bench, drawn.truth.effects, drawn.truth.noise, "rich")


def change(text: str) -> None:
    """Apply MODULE.NAME=VALUE to all loaded modules of the diagnosis."""
    place, _, value = text.partition("=")
    module, _, name = place.rpartition(".")
    old, new = getattr(sys.modules[PACKAGE + module], name), ast.literal_eval(value)
    for loaded in [each for path, each in sys.modules.items() if path.startswith(PACKAGE)]:
        if getattr(loaded, name, None) is old:
            setattr(loaded, name, (lambda *_, **__: new) if callable(old) else new)


def answer(report: Row) -> str:
    """Return one line with the verdict and each cause with its alternatives."""
    causes = ["/".join([each["effect"], *sorted(each["alternatives"])]) for each in report["causes"]]
    return f"{report['verdict']}: {', '.join(sorted(causes))}"


def score(work: Work, found: Case | None, report: Row) -> float:
    """Return the mark of an answer, from 1 (right) to -1 (a single wrong cause).

    The mark of a measured set (`found` is None) is the share of its published causes that were identified.
    """
    causes = report["causes"]
    named = [{each["effect"], *each["alternatives"]} for each in causes]
    if found is None:
        published = SETS[work.key.removeprefix("measured ")][3]
        return sum(any(set(names) & group for group in named) for names in published) / len(published)
    marks = mark(found, report)
    if marks.wrong:
        return -1.0
    if found.truth.outside:
        return 1.0 if marks.flagged else 0.0
    if found.family == "two_encoders":  # right: the cause, its group, or no cause if recalibration absorbs it
        absorbed = "parameter_error" in found.truth.twins and not causes
        held = any(set(found.truth.effects) <= group for group in named)
        return 1.0 if held or absorbed or (not found.truth.effects and not causes) else 0.0
    if found.truth.twins:
        return 1.0 if marks.grouped else 0.0
    if not found.truth.effects:
        return 0.0 if causes else 1.0 if report["verdict"] in QUIET else 0.5
    if len(found.truth.effects) == 2:
        one = marks.both_within or any(set(found.truth.effects) & group for group in named)
        return 1.0 if marks.both else 0.5 if one else 0.0
    return 1.0 if marks.unique else 0.5 if marks.within else 0.0


def one(work: Work, changes: Sequence[str]) -> Row:
    """Diagnose one case under these changes."""
    found: Case | None = None
    logs: Any
    hold_out = None
    if work.draw is None:
        pattern, hold_out, file, _ = SETS[work.key.removeprefix("measured ")]
        logs, model = load_logs(sorted(data().glob(pattern))), load_model(data() / file)
    else:
        found = cached(work)
        if found is None:
            return {"key": work.key, "changes": list(changes), "answer": "not drawn", "error": None, "mark": 0.0}
        logs, model = {log.name: log.columns for log in found.logs}, model_from(tomllib.loads(found.model), "nominal")
    for each in changes:
        change(each)
    started = time.process_time()
    try:
        report = json.loads(diagnose(logs, model, hold_out=hold_out).to_json())
        error = (report["rms"] or {}).get("extended")
        row: Row = {"answer": answer(report), "error": error and 1e3 * error, "mark": score(work, found, report)}
        row["formula"] = (report.get("formula") or {}).get("expression")
        row["noise"] = 1e3 * found.truth.noise if found else None
    except Exception as problem:
        row = {"answer": f"{type(problem).__name__}: {problem}", "error": None, "mark": -1.0}
    return {"key": work.key, "changes": list(changes), **row, "seconds": time.process_time() - started}


def cached(work: Work) -> Case | None:
    """Return a case from the cache, or generate and store it. Return None if it cannot be generated."""
    path = CACHE / f"{work.key.replace('/', '_')}.pickle"
    if path.is_file():
        kept: Case | None = pickle.loads(path.read_bytes())
        return kept
    assert work.draw is not None
    try:
        drawn = work.draw()
    except RuntimeError:  # no such case can be generated
        return None
    kept = dataclasses.replace(drawn, bench=None, experiment=None)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(pickle.dumps(kept))
    return kept


def differs(row: Row, other: Row | None) -> bool:
    """Return True if the answers or formulas differ, or the held-out errors differ by more than 0.1 %."""
    if other is None or row["answer"] != other["answer"] or row.get("formula") != other.get("formula"):
        return True
    a, b = row["error"] or 0.0, other["error"] or 0.0
    return bool(abs(a - b) > 1e-3 * max(a, b))


def table(rows: Sequence[Row], against: Results | None) -> None:
    """Print the rows, or only the rows that differ from `against`, and the sums."""
    lines = []
    for row in rows:
        other = against[row["key"]] if against is not None and row["key"] in against else None
        if against is None or differs(row, other):
            for each in (other, row) if other else (row,):
                error = "-" if each["error"] is None else f"{each['error']:.4g}"
                lines.append((each["key"], f"{each['mark']:g}", error, each["answer"]))
    command.print_table(("case", "mark", "error (mN*m)", "answer"), lines)
    blind = [row for row in rows if not row["key"].startswith("measured")]
    folds = [row["error"] for row in rows if row["key"] in FOLDS and row["error"]]
    print(f"{len(rows)} cases, sum of marks {sum(row['mark'] for row in rows):g}", end="; ")
    print(f"blind: {sum(row['mark'] == 1 for row in blind)} of {len(blind)} right", end=", ")
    print(f"{sum(row['mark'] < 0 for row in blind)} with a wrong single name", end="; ")
    pooled = np.sqrt(np.mean(np.square(folds))) if folds else np.nan
    print(f"cable drive, loads left out: {pooled:.4g} mN*m pooled")


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--change", nargs="+", default=[], metavar="MODULE.NAME=VALUE", help="all at once")
    parser.add_argument("--only", default="", metavar="TEXT", help="cases whose name has it")
    parser.add_argument("--against", type=Path, help="rows of a run without the change")
    command.share(parser, "processes rows", rows=CACHE / "rows.jsonl")
    chosen = parser.parse_args()
    chosen.rows.parent.mkdir(parents=True, exist_ok=True)
    results = Results(chosen.rows, lambda row: row["key"], lambda row: row["changes"] == chosen.change)
    wanted = [each for each in corpus() if chosen.only in each.key]
    jobs = [each for each in wanted if each.key not in results]
    for row in command.parallel(partial(one, changes=chosen.change), jobs, chosen.processes):
        results.add(row)
    against = Results(chosen.against, lambda row: row["key"]) if chosen.against else None
    table([results[each.key] for each in wanted if each.key in results], against)
    return 0
