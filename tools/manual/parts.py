"""What stands in the manual by name: tables from the catalogue, the verbs, the model's own arithmetic."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial

from tools.command import read_rows
from tools.manual import drives, hazards, measure, tables
from tools.package.licences import FILE
from tsa_ctrl.cli import VERBS
from tsa_ctrl.model.catalogue import CATALOGUE
from tsa_ctrl.model.curvature import Profile
from tsa_ctrl.model.effects.specification import Specification
from tsa_ctrl.model.functions import SCALARS

SHAPES: Mapping[str, Profile] = {
    "all at the motor end": Profile.of("motor_end"),
    "evenly": Profile.of("uniform"),
    "S: halves at 0.3 and 0.7": Profile(((0.0, 0.0), (0.3, 0.0), (0.3, 0.5), (0.7, 0.5), (0.7, 1.0), (1.0, 1.0))),
    "all at the joint end": Profile.of("joint_end"),
}
ANGLES = (0.1, 0.26, 0.5, 0.8, 1.2)


def table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    """Markdown."""
    lines = [head, tuple("---" for _ in head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def catalogue() -> str:
    """Every effect: where it enters, its parameters, what a log needs."""
    rows = [
        (f"`{spec.name}`", spec.equation, _parameters(spec), _columns(spec), spec.summary)
        for spec in CATALOGUE.values()
    ]
    return table(("name", "how it enters", "parameters (unit)", "needs", "in words"), rows)


def _parameters(spec: Specification) -> str:
    own = ", ".join(f"`{p.name}`" + ("" if p.unit == "1" or p.choices else f" ({p.unit})") for p in spec.parameters)
    return own + (", and constants by name" if spec.named else "") or "none"


def _columns(spec: Specification) -> str:
    return "; ".join(" or ".join(f"`{name}`" for name in names) for names in spec.columns) or "-"


def slope_and_half_loop(profile: Profile, x: float) -> tuple[float, float]:
    """Slope over r_J/r_M, and half loop over 2 T_p0 r_J, of (3.53) for a sheath of this shape; both 1."""
    alpha, beta = profile.mean_exponential(SCALARS, x), profile.mean_exponential(SCALARS, -x)
    total = alpha + beta
    return (alpha * math.exp(-x) + beta * math.exp(x)) / total, 2.0 * math.sinh(x) * 2.0 / total / 2.0


def errors() -> str:
    """What (3.55) says too much of slope and half loop, by shape and friction angle."""
    rows = []
    for name, profile in SHAPES.items():
        cells = []
        for x in ANGLES:
            slope, half = slope_and_half_loop(profile, x)
            cells.append(f"{100 * (math.cosh(x) / slope - 1):+.1f}, {100 * (math.sinh(x) / half - 1):+.1f}")
        rows.append((name, f"{profile.centre:.2f}", *cells))
    return table(("bent", "s_c", *(f"x = {x:g}" for x in ANGLES)), rows)


def profiles() -> str:
    """Drive profiles that are shipped, and what differs at the drive."""
    head, *rows = drives.profiles()
    return table(head, rows)


def quirks() -> str:
    """What the simulated drive can do otherwise than the standard."""
    head, *rows = drives.quirks()
    return table(head, rows)


def verbs() -> str:
    """A verb a line."""
    return table(("verb", "what it does"), [(f"`tsa {verb}`", words) for verb, words in VERBS.items()])


def _short(value: float) -> str:
    """Three digits, of a large number all before the point."""
    return f"{value:.3g}" if abs(value) < 1000.0 else f"{value:.0f}"


def figures(*beginnings: str) -> str:
    """What was measured, from the file that the measuring wrote: all of it, or what has such a name."""
    rows: list[tuple[str, ...]] = []
    for name, row in measure.load().items():
        if beginnings and not name.startswith(beginnings):
            continue
        spread = "" if row["runs"] == 1 else f" ({_short(row['low'])} to {_short(row['high'])} in {row['runs']})"
        value = f"{_short(row['value'])} {row['unit']}{spread}"
        rows.append((row["words"], value, f"`{row['command']}`", f"{row['date']}, {row['commit']}"))
    return table(("what", "figure", "command", "measured"), rows)


def licences() -> str:
    """What the package needs at run time, and under which licence."""
    listed = json.loads(FILE.read_text(encoding="utf-8"))
    by_licence: dict[str, list[str]] = {}
    for name, row in listed.items():
        by_licence.setdefault(row["licence"], []).append(f"**{name}**" if row["direct"] else name)
    return table(
        ("licence", "needed directly (bold), and by those"), [(k, ", ".join(v)) for k, v in sorted(by_licence.items())]
    )


def hazard_table() -> str:
    """Every hazard of the campaign in virtual time, and what only hardware can do."""
    about = hazards.load()["about"]
    counted = (
        f"{about['trials']} trials of `tools/run campaign/virtual --seed {about['seed']}` on {about['date']}, "
        f"{about['pairs']} of them with two faults at once, of {hazards.WHOLE} and {hazards.PAIRS} that there are: "
        f"{about['safe']} safe."
    )
    missing = hazards.not_shown()
    shown = f"Causes by which no trial ended first: {', '.join(missing)}." if missing else ""
    only = table(("what no software can do", "what can"), hazards.HARDWARE)
    return "\n\n".join(part for part in (counted, table(hazards.HEAD, hazards.rows()), shown, only) if part)


def measured_table(name: str) -> str:
    """A table that a benchmark of hours printed, with the command that prints it."""
    row = tables.load()[name]
    lines = table(tuple(row["head"]), [tuple(cells) for cells in row["rows"]])
    return f"{lines}\n\n(`{row['command']}`, {row['date']}, {row['commit']})"


def otherwise_table() -> str:
    """The diagnosis on measured drives of others, beside what people do otherwise."""
    from tools.bench import otherwise  # the diagnosis with it: slow to import

    return table(*otherwise.table(read_rows(otherwise.FILE)))


def folds_table() -> str:
    """The diagnosis of the measured cable drive, each load and each frequency left out once."""
    from tools.measured import diagnose  # the diagnosis with it: slow to import

    return table(*diagnose.table(read_rows(diagnose.FILE)))


def hidden_in_measured() -> str:
    """Known effects hidden in measured logs, and what the diagnosis said by their size."""
    from tools.bench import measured  # the diagnosis with it: slow to import

    return table(*measured.table(read_rows(measured.FILE)))


SOURCES: Mapping[str, Callable[[], str]] = {
    "catalogue": catalogue,
    "errors": errors,
    "verbs": verbs,
    "profiles": profiles,
    "quirks": quirks,
    "figures": figures,
    "diagnosis-figures": partial(
        figures, "diagnose-speed", "ten-minutes-", "hour-", "outside-", "plain-", "pairs-", "base-"
    ),
    "licences": licences,
    "hazards": hazard_table,
    **{name: partial(measured_table, name) for name in tables.COMMANDS},
    "otherwise": otherwise_table,
    "folds": folds_table,
    "hidden-in-measured": hidden_in_measured,
}
