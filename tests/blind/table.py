"""Print the table of targets: counts with binomial intervals, baseline strategies and wrong answers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.stats import binom

from .score import FURTHER, TARGETS, Target, counted, interval

STRATEGIES = ("bic", "validation", "lasso", "stlsq")
GAIN = (0.97, 0.9)  # required median and tenth percentile of the gain
COVERED = (0.93, 0.97)  # required coverage of 95 % intervals
SIGNIFICANT = 0.02  # a gate with few cases fails only if chance does not explain the count

Result = dict[str, Any]


def print_table(results: Sequence[Result]) -> None:
    """Print all results of the benchmark on stdout."""
    _row("draws", "target", "found", "95 % interval", "the target is", STRATEGIES)
    for target in (*TARGETS, *FURTHER):
        _line(target, results)
    _gains(results)
    _coverage(results)
    _per_name(results)
    seconds = [r["seconds"] for r in results if r.get("seconds") is not None]
    if seconds:
        print(f"seconds per diagnosis: median {np.median(seconds):.1f}, longest {max(seconds):.1f}")
    _wrong(results)


def failed(results: Sequence[Result]) -> list[str]:
    """Return the targets that these results miss significantly, and print each of them."""
    out = []
    for target in TARGETS:
        count, total = counted(target, results)
        if target.at_most:
            missed = count > 0 and binom.sf(count - 1, total, target.share) < SIGNIFICANT
        else:
            missed = total > 0 and binom.cdf(count, total, target.share) < SIGNIFICANT
        if missed:
            out.append(target.text)
            print(f"FAILED {target.text}: {count} of {total}")
    return out


def _line(target: Target, results: Sequence[Result]) -> None:
    count, total = counted(target, results)
    if total == 0:
        return
    low, high = interval(count, total)
    met = count / total <= target.share if target.at_most else count / total >= target.share
    wanted = f"{'<=' if target.at_most else '>='} {target.share:.0%}"
    theirs = [_naive(target, results, strategy) for strategy in STRATEGIES]
    _row(target.text, wanted, f"{count}/{total} {count / total:.1%}", f"{low:.1%}-{high:.1%}", _met(met), theirs)


def _row(text: str, target: str, found: str, spread: str, met: str, theirs: Sequence[str] = ("-",) * 4) -> None:
    """Print a row of the table. The columns are separated by blanks, so no column may be empty."""
    print(
        f"{text:62s}  {target:>14s}  {found:>16s}  {spread:>24s}  {met:>14s}"
        + "".join(f"  {each:>10s}" for each in theirs)
    )


def _met(met: bool) -> str:
    return "met" if met else "MISSED"


def _naive(target: Target, results: Sequence[Result], strategy: str) -> str:
    theirs = []
    for result in results:
        if "naive" not in result:
            continue
        found = result["naive"][strategy]
        verdict = "explained" if found["named"] else "consistent"
        theirs.append({**result, "mark": found, "verdict": verdict, "error": ""})
    count, total = counted(target, theirs)
    return f"{count / total:.1%}" if total else "-"


def _gains(results: Sequence[Result]) -> None:
    right = [r for r in results if r["family"] == "single" and r["mark"]["unique"]]
    for key, text in (
        ("gain", "gain on held-out data, as reported"),
        ("fresh_gain", "gain on a fresh motion, noise-free"),
    ):
        values = [r[key] for r in right if r.get(key) is not None]
        if values:
            median, tenth = float(np.median(values)), float(np.quantile(values, 0.1))
            spread = f"worst {min(values):.3f} of {len(values)}"
            met = median >= GAIN[0] and tenth >= GAIN[1]
            _row(
                f"{text}: median, tenth percentile",
                f">= {GAIN[0]}, {GAIN[1]}",
                f"{median:.3f}, {tenth:.3f}",
                spread,
                _met(met),
            )


def _coverage(results: Sequence[Result]) -> None:
    groups: dict[str, list[bool]] = {}
    for result in results:
        for parameter, inside in result["mark"]["covered"].items():
            groups.setdefault(parameter, []).append(inside)
    for text, chosen in (
        ("95 % intervals of effect parameters cover", [g for name, g in groups.items() if "." in name]),
        ("95 % intervals of the base model cover", [g for name, g in groups.items() if "." not in name]),
    ):
        inside = [answer for group in chosen for answer in group]
        if inside:
            low, high = interval(sum(inside), len(inside))
            share = f"{sum(inside)}/{len(inside)} {np.mean(inside):.1%}"
            met = COVERED[0] <= float(np.mean(inside)) <= COVERED[1]
            _row(text, f"{COVERED[0]:.0%}-{COVERED[1]:.0%}", share, f"{low:.1%}-{high:.1%}", _met(met))
    poor = {name: group for name, group in groups.items() if len(group) >= 5 and np.mean(group) < 0.85}
    for name, group in sorted(poor.items(), key=lambda item: float(np.mean(item[1]))):
        print(f"    {name}: {sum(group)}/{len(group)}")


def _per_name(results: Sequence[Result]) -> None:
    """Print the results of each effect, kind of cause and row."""
    keys = {
        "single": "unique",
        "outside": "flagged",
        "confounded": "grouped",
        "rigid": "unique",
        "geared": "unique",
        "none": "named",
    }
    for family, key in keys.items():
        names = sorted({r["name"] for r in results if r["family"] == family})
        if not names:
            continue
        print(f"\n{family} ({key}):")
        for name in names:
            marks = [r["mark"] for r in results if (r["family"], r["name"]) == (family, name)]
            hits = [m[key] for m in marks if m[key] is not None]
            more = (
                f", within {sum(bool(m['within']) for m in marks)}" if family in ("single", "rigid", "geared") else ""
            )
            more += f", by a formula {sum(bool(m['described']) for m in marks)}" if family == "outside" else ""
            more += f", resolved {sum(bool(m['resolved']) for m in marks)}" if family == "confounded" else ""
            if hits:
                print(f"    {name:34s} {sum(hits)}/{len(hits)}{more}, wrong {sum(m['wrong'] for m in marks)}")


def _wrong(results: Sequence[Result], most: int = 60) -> None:
    """Print the wrong cases with the hidden and the reported effects. Family, name and seed reproduce a case."""
    lines = []
    for r in results:
        m = r["mark"]
        good = {
            "none": not m["named"],
            "hidden_direction": not m["named"],
            "single": m["unique"],
            "pair": m["both"],
            "outside": m["flagged"],
            "confounded": m["grouped"] and m["advised"] and m["resolved"] is not False,
            "rigid": m["unique"] if r["name"] != "none" else not m["named"],
            "geared": m["unique"] if r["name"] != "none" else not m["named"],
        }[r["family"]]
        if good and not (m["wrong"] and r["family"] not in ("outside",)):
            continue
        said = "; ".join(effect + (f" or {', '.join(others)}" if others else "") for effect, others, *_ in r["causes"])
        lines.append(
            f"    {r['family']}/{r['name']}/{r['seed']} (size/noise {r['ratio']:.1f}): hidden "
            f"{' + '.join(r['effects']) or 'nothing of the catalogue'}; said {r['verdict']}: {said or 'nothing'}"
            + (f"; experiment said {r['experiment_causes']}" if r.get("experiment_causes") is not None else "")
        )
    if lines:
        print(f"\nnot as wanted ({len(lines)}):")
        print("\n".join(lines[:most]))
