"""Generate the parts of the manual's pages: tables of effects, signals, drives, hazards, figures and licences."""

from __future__ import annotations

import inspect
import json
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

from tools.campaign.phase import plan
from tools.campaign.phase.catalogue import HAZARDS, Hazard
from tools.campaign.phase.results import KEPT
from tools.campaign.phase.rigs import LIMIT
from tools.command import CONFIG, read_rows
from tools.manual import measure
from tools.package.licences import FILE
from tsa_ctrl.bus.drive import budget
from tsa_ctrl.bus.drive.profile import load_profile
from tsa_ctrl.bus.settings import AxisNodes, BusSettings, DriveSettings, EncoderSettings, TorqueSensorSettings
from tsa_ctrl.cli import VERBS
from tsa_ctrl.model.catalogue import CATALOGUE
from tsa_ctrl.model.curvature import Profile
from tsa_ctrl.model.functions import SCALARS
from tsa_ctrl.plant.settings import Quirks
from tsa_ctrl.safety.causes import Cause
from tsa_ctrl.signals import SIGNALS, Kind, Place

SHAPES: Mapping[str, Profile] = {
    "all at the motor end": Profile.of("motor_end"),
    "evenly": Profile.of("uniform"),
    "S: halves at 0.3 and 0.7": Profile(((0.0, 0.0), (0.3, 0.0), (0.3, 0.5), (0.7, 0.5), (0.7, 1.0), (1.0, 1.0))),
    "all at the joint end": Profile.of("joint_end"),
}
ANGLES = (0.1, 0.26, 0.5, 0.8, 1.2)
HAZARD_HEAD = (
    "hazard", "cause", "detected as", "reaction", "torque zero after, median (worst)",
    "joint at worst: rad/s, rad, J", "residual risk", "safe of trials",
)  # fmt: skip
HARDWARE = (
    ("the motor has torque although its drive reports that it is off", "safe torque off, by a switch within reach"),
    ("a limb falls when the torque ends", "a brake, a counterweight or springs; a mechanical end stop"),
    ("both measurements of a quantity have the same error", "a second sensor of another kind; a slipping clutch"),
    ("the unloaded tendon tears, and the other pulls with its pretension", "an end stop; less pretension"),
)
WHOLE = len(HAZARDS) * len(plan.PHASES) * plan.MOMENTS  # trials of the campaign
STOPS = "latched"
FIELD = re.compile(r"^    (?P<key>[a-z_]+): .+ = (?P<default>[^#]+?)  # (?P<words>.+)$")


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = [head, ["---" for _ in head], *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def catalogue() -> str:
    """Return the table of effects with equation, parameters and required columns of a log."""
    rows = []
    for spec in CATALOGUE.values():
        own = ", ".join(f"`{p.name}`" + ("" if p.unit == "1" or p.choices else f" ({p.unit})") for p in spec.parameters)
        needs = "; ".join(" or ".join(f"`{name}`" for name in names) for names in spec.columns) or "-"
        more = ", and constants by name" if spec.named else ""
        rows.append((f"`{spec.name}`", spec.equation, own + more or "none", needs, spec.summary))
    return table(("name", "how it enters", "parameters (unit)", "needs", "in words"), rows)


def signals() -> str:
    """Return the table of signals with name, unit, meaning, and the interfaces that contain them."""
    places = (Place.LOG, Place.STATUS, Place.CLIENT)
    rows = [
        (
            f"`{signal.name}`",
            signal.unit,
            signal.doc,
            *("yes" if place in signal.where else "" for place in places),
        )
        for signal in SIGNALS.values()
        if signal.source and signal.kind is not Kind.AGE
    ]
    return table(("name", "unit", "meaning", "log", "status", "client"), rows)


def slope_and_half_loop(profile: Profile, x: float) -> tuple[float, float]:
    """Return the slope over r_J/r_M and the friction torque over 2 T_p0 r_J of (3.53) for a sheath of this shape."""
    alpha, beta = profile.mean_exponential(SCALARS, x), profile.mean_exponential(SCALARS, -x)
    total = alpha + beta
    return (alpha * math.exp(-x) + beta * math.exp(x)) / total, 2.0 * math.sinh(x) / total


def errors() -> str:
    """Return the errors of slope and friction torque of (3.55), %, by shape and friction angle."""
    rows = []
    for name, profile in SHAPES.items():
        cells = []
        for x in ANGLES:
            slope, half = slope_and_half_loop(profile, x)
            cells.append(f"{100 * (math.cosh(x) / slope - 1):+.1f}, {100 * (math.sinh(x) / half - 1):+.1f}")
        rows.append((name, f"{profile.centre:.2f}", *cells))
    return table(("bent", "s_c", *(f"x = {x:g}" for x in ANGLES)), rows)


def profiles() -> str:
    """Return the table of the shipped drive profiles with their sources and unknown data."""
    rows = []
    for path in sorted((CONFIG / "drives").glob("*.toml")):
        profile = load_profile(path.stem, CONFIG)
        rows.append((f"`{path.stem}`", "; ".join(profile.sources), "; ".join(profile.unknown) or "-"))
    return table(("profile", "sources", "not known"), rows)


def quirks() -> str:
    """Return the table of keys that make the simulated drive differ from the standard."""
    fields = filter(None, map(FIELD.match, inspect.getsource(Quirks).splitlines()))
    rows = [(f"`{field['key']}`", f"`{field['default']}`", field["words"]) for field in fields]
    return table(("key of `[axis.drive]`", "default", "what the drive does"), rows)


def faults() -> str:
    """Return the table of fault causes with their remedies."""
    head, rows = ("fault", "`tsa help`", "remedy"), [(each.title, f"`{each.id}`", each.remedy) for each in Cause]
    return table(head, rows)


def verbs() -> str:
    """Return the table of the commands of `tsa` with their descriptions."""
    return table(("command", "what it does"), [(f"`tsa {verb}`", words) for verb, words in VERBS.items()])


def _short(value: float) -> str:
    """Format a number with three significant digits, or a number of at least 1000 as an integer."""
    return f"{value:.3g}" if abs(value) < 1000.0 else f"{value:.0f}"


def figures() -> str:
    """Return the table of measured figures."""
    rows: list[tuple[str, ...]] = []
    for row in measure.load(measure.FIGURES).values():
        spread = "" if row["runs"] == 1 else f" ({_short(row['low'])} to {_short(row['high'])} in {row['runs']})"
        value = f"{_short(row['value'])} {row['unit']}{spread}"
        rows.append((row["words"], value, f"`{row['command']}`", f"{row['date']}, {row['commit']}"))
    return table(("what", "figure", "command", "measured"), rows)


def licences() -> str:
    """Return the table of licences with the packages that are needed at run time."""
    by_licence: dict[str, list[str]] = {}
    for name, row in json.loads(FILE.read_text(encoding="utf-8")).items():
        by_licence.setdefault(row["licence"], []).append(f"**{name}**" if row["direct"] else name)
    rows = [(licence, ", ".join(names)) for licence, names in sorted(by_licence.items())]
    return table(("licence", "needed directly (bold), and by those"), rows)


def hazard_results() -> dict[str, Any]:
    """Return the results that `tools/run campaign/virtual --keep` wrote."""
    found: dict[str, Any] = json.loads(KEPT.read_text(encoding="utf-8"))
    return found


def hazard_rows() -> list[tuple[str, ...]]:
    """Return a line for each hazard with results, in the order of the catalogue."""
    kept = hazard_results()
    found, watched = kept["hazards"], kept["about"]["watched"]
    return [_hazard_row(hazard, found[hazard.name], watched) for hazard in HAZARDS if hazard.name in found]


def _hazard_row(hazard: Hazard, row: dict[str, Any], watched: float) -> tuple[str, ...]:
    stopped, running = row["stopped"], row["running"]
    goes_on = hazard.goes_on or f"no effect within {watched:g} s"
    if not running:
        reaction = "no trial with torque in this sample"
    elif not stopped:
        reaction = "the drive's time-out" if hazard.act == "die" else f"continues: {goes_on}"
    elif stopped < running:
        reaction = f"{STOPS} in {stopped} of {running}, otherwise continues: {goes_on}"
    else:
        reaction = STOPS
    detected = "; ".join(row["causes"]) or "-"
    zero = "-"
    if row["zero_worst"] is not None:
        zero = f"{1e3 * row['zero_median']:.0f} ms ({1e3 * row['zero_worst']:.0f} ms)"
    worst = f"{row['speed']:.1f}, {row['travel']:.2f}, {row['energy']:.2f}"
    unsafe = "".join(f"; {count} unsafe while {phase}" for phase, count in row["unsafe"].items())
    residual = "; ".join(words for words in (hazard.residual, _open(hazard, row)) if words) or "-"
    counted = f"{row['safe']}/{row['trials']}{unsafe}"
    return hazard.hazard, hazard.name, detected, reaction, zero, worst, residual, counted


def _open(hazard: Hazard, row: dict[str, Any]) -> str:
    """Describe the known unsafe trials of a hazard: their number, joints and excess, and the present limits."""
    if not hazard.open:
        return ""
    beyond = row.get("beyond")
    if beyond is None:
        return f"open, although all these trials were safe: {hazard.open}"
    count = sum(row["unsafe"].values())
    joints = ", ".join(f"{name} {times}" for name, times in beyond["joints"].items())
    worst = f"{beyond['speed']:.1f} rad/s, {beyond['travel']:.2f} rad, {beyond['energy']:.2f} J"
    if beyond["peak"] > LIMIT:
        worst += f", {beyond['peak']:.1f} N*m at the motor"
    return (
        f"open in {count} of {row['trials']} (joint {joints}; {beyond['blind']} of them without a torque sensor; at "
        f"worst {worst}): {hazard.open}"
    )


def not_shown() -> list[str]:
    """Return the titles of the causes that are not among the main causes of any hazard."""
    shown = {cause_id for row in hazard_results()["hazards"].values() for cause_id in row["cause_ids"]}
    return [cause.title for cause in Cause if cause.id not in shown]


def hazard_table() -> str:
    """Return the hazards of the campaign in virtual time, and those that need hardware measures."""
    about = hazard_results()["about"]
    counted = (
        f"{about['trials']} trials of `tools/run campaign/virtual --seed {about['seed']}` on {about['date']}, "
        f"{about['pairs']} of them with two faults at once, of {WHOLE} and {plan.PAIRS} possible trials: "
        f"{about['safe']} safe. Each fault was watched for at most {about['watched']:g} s."
    )
    missing = not_shown()
    shown = f"Causes that are not among the two most frequent of any hazard: {', '.join(missing)}." if missing else ""
    only = table(("hazard without a software remedy", "hardware remedy"), HARDWARE)
    return "\n\n".join(part for part in (counted, table(HAZARD_HEAD, hazard_rows()), shown, only) if part)


def measured_table(name: str) -> str:
    """Return a table from the output of a benchmark, with its command."""
    row = measure.load(measure.TABLES)[name]
    return f"{table(row['head'], row['rows'])}\n\n(`{row['command']}`, {row['date']}, {row['commit']})"


def of_rows(name: str) -> str:
    """Return the table of a benchmark of measured drives, from its saved rows."""
    from tools.bench import measured  # slow, because it imports the diagnosis
    from tools.measured import diagnose

    module = {"folds": diagnose, "hidden-in-measured": measured}[name]
    return table(*module.table(read_rows(module.FILE)))


def bus_rates() -> str:
    """Return the highest rates of one to four axes on a bus of 1 Mbit/s, by their nodes and `pdo`."""
    rows = []
    for pdo, sensor in (("standard", 0), ("standard", 1), ("lean", 0), ("lean", 1), ("lean", 2)):
        axes = [
            AxisNodes(
                name=f"axis{number}",
                drive=DriveSettings(node_id=1 + number, pdo=pdo),  # type: ignore[arg-type]
                encoder=EncoderSettings(node_id=32 + number),
                torque_sensor=TorqueSensorSettings(node_id=64 + number, every=sensor) if sensor else None,
            )
            for number in range(4)
        ]
        bus = BusSettings()
        rates = [int(budget.load(bus, axes[:count], 1.0).highest_rate(bus.max_load)) for count in (1, 2, 3, 4)]
        nodes = ("drive, encoder", "drive, encoder, torque sensor", "the same, `every = 2`")[sensor]
        rows.append((nodes, f"`{pdo}`", *(f"{rate} Hz" for rate in rates)))
    return table(("nodes of each axis", "`pdo`", "1 axis", "2 axes", "3 axes", "4 axes"), rows)


SOURCES: Mapping[str, Callable[[], str]] = {
    "catalogue": catalogue,
    "errors": errors,
    "signals": signals,
    "bus-rates": bus_rates,
    "faults": faults,
    "verbs": verbs,
    "profiles": profiles,
    "quirks": quirks,
    "figures": figures,
    "licences": licences,
    "hazards": hazard_table,
    **{name: partial(measured_table, name) for name in measure.listed()["tables"]},
    **{name: partial(of_rows, name) for name in ("folds", "hidden-in-measured")},
}
