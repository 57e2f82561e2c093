"""Write the JSON object and the page of an investigation."""

from __future__ import annotations

import json
from html import escape
from pathlib import Path
from typing import Any

from tsa_ctrl import settings
from tsa_ctrl.identify.diagnosis.report.words import four_lines
from tsa_ctrl.investigate.procedure import Answer, Investigation, Step

JSON, PAGE = "investigation.json", "report.html"
STYLE = (
    "body{font:15px/1.5 sans-serif;max-width:60em;margin:2em auto;padding:0 1em;color:#222}"
    "dl{display:grid;grid-template-columns:max-content 1fr;gap:.2em 1em}dt{font-weight:600}dd{margin:0}"
    "table{border-collapse:collapse}td,th{border:1px solid #ccc;padding:.3em .6em;text-align:left;vertical-align:top}"
)


def to_dict(found: Investigation, folder: Path) -> dict[str, Any]:
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


def write(found: Investigation, folder: Path) -> Path:
    """Write JSON and page to `folder`; return the page."""
    settings.write_text(folder / JSON, json.dumps(to_dict(found, folder), indent=2, allow_nan=False) + "\n")
    page = folder / PAGE
    settings.write_text(page, _page(found, folder))
    return page


TITLES = {
    Answer.NONE: "no cause found",
    Answer.CAUSE: "the cause was found",
    Answer.GROUP: "causes that this rig cannot separate",
    Answer.OUTSIDE: "a cause outside the catalogue",
    Answer.INSUFFICIENT: "the motions are insufficient",
    Answer.STOPPED: "stopped with an open question",
}


def _page(found: Investigation, folder: Path) -> str:
    rows = "\n".join(_row(step, folder) for step in found.steps)
    title = f"Investigation: {TITLES[found.answer]}"
    statement = escape(found.statement[:1].upper() + found.statement[1:])
    lines = {} if found.result is None else four_lines(found.result)
    summary = "".join(f"<dt>{name}</dt><dd>{escape(line)}</dd>" for name, line in lines.items())
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title><style>{STYLE}</style>'
        f"</head><body>\n<h1>{title}</h1>\n<p>{statement}.</p>\n<dl>{summary}</dl>\n"
        "<table><tr><th>motion</th><th>seconds</th><th>made to separate (standard deviations)</th><th>verdict</th>"
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
