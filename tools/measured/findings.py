"""What once went wrong on measured logs of others, and what each command says of them today.

Usage: tools/run measured/findings [--only NUMBER ...]

Each line is a command of a user's, run as it stands in a folder with the measured sets (emps, epos, bam, davinci) and
with what is made of them: one set twice over, a torque that has little to do with the motion, a cogging map. What it
prints that matters follows; exit status 0 or 2 is an answer, anything else ends this with the command's own words. The
data are looked for in the folder named by TSA_DATA, else in ../shared/data; without them there is one line.
"""

from __future__ import annotations

import re
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from tools import command
from tsa_ctrl.identify.dataset import load_log
from tsa_ctrl.log.csv_out import write_columns
from tsa_ctrl.system.processes import tsa

RELATED = 0.14  # correlation of what stands in the place of the torque with the torque: as of a PWM that was found so
SEGMENT = 500  # samples of the torque that change places: its spectrum stays, its motion goes
RATE = 100.0  # Hz, of the cogging map
TURN = 60.0  # s, of one slow turn each way


@dataclass(frozen=True)
class Finding:
    """A row of what was found: what went wrong then, the command that shows it, and which of its lines matter."""

    number: int
    found: str
    line: str  # arguments of tsa
    shown: str  # pattern of the lines that are shown


FINDINGS = (
    Finding(
        1,
        "the published axis simulated at 14 N, and unexplained",
        "diagnose emps/emps.csv.gz --model emps/emps.toml",
        "^[A-Z].*falls",
    ),
    Finding(1, "the same, by simulate", "simulate emps/emps.csv.gz --model emps/emps.toml", "^RMS|omega_m is derived"),
    Finding(
        2,
        "half of the time at rest: asymmetric friction, offset excluded",
        "diagnose epos/start_stop/*.csv.gz --model epos/drive.toml",
        "^[A-Z].*falls",
    ),
    Finding(
        4,
        "one log of 20 s: a weight of 1.27 N·m, where the torque is 0.07",
        "diagnose davinci/load050_0.3Hz.csv.gz --model davinci/actuator.toml",
        "^These",
    ),
    Finding(
        5,
        "50 trials, 1,000 s: the joint hardly moves",
        "diagnose twice/*.csv.gz --model davinci/actuator.toml",
        "^[A-Z].*falls",
    ),
    Finding(
        6,
        "a spring of 9e-11 N·m/rad that rests at 3.8e6 rad",
        "diagnose epos/steady/*.csv.gz --model epos/drive.toml",
        "^[A-Z].*falls",
    ),
    Finding(
        7,
        "a weight, or an offset, or asymmetric friction",
        "diagnose bam/*.csv.gz --model bam/xl330.toml",
        "^[A-Z].*falls|^Excluded",
    ),
    Finding(
        8,
        "a PWM for torque: one name alone, gain 93 %",
        "diagnose pwm.csv --model emps/emps.toml",
        "^verdict|^These|^[A-Z].*(falls|held-out)",
    ),
    Finding(9, "a cogging map: the joint hardly moves", "diagnose cogging.csv --model bam/xl330.toml", "^[A-Z].*falls"),
    Finding(
        10,
        "calibrated was worse, without a word",
        "calibrate davinci/*.csv.gz --model davinci/actuator.toml --out calibrated.toml",
        "^RMS",
    ),
    Finding(
        10,
        "a rigid drive was refused without a hint",
        "calibrate epos/steady/*.csv.gz --model epos/drive.toml --out drive.toml",
        "^tsa",
    ),
    Finding(
        11,
        "a late row refused the file",
        "simulate bam/kp100_up_and_down.csv.gz --model bam/xl330.toml",
        "jitters|late|^RMS",
    ),
    Finding(
        11,
        "7.8 Hz: t seems to be in milliseconds",
        "simulate epos/steady/n002.csv.gz --model epos/drive.toml",
        "samples at|^RMS",
    ),
    Finding(
        12, "recalibrated was worse, not said", "diagnose emps/emps.csv.gz --model emps/emps.toml", "^Recalibration"
    ),
    Finding(
        15,
        "what is left depends on the joint's angle",
        "diagnose davinci/*_0.3Hz.csv.gz --model davinci/actuator.toml",
        "^[A-Z].*falls|^What is left",
    ),
)


def prepare(data: Path, place: Path) -> None:
    """Everything that the commands read."""
    for name in ("emps", "epos", "bam", "davinci"):
        (place / name).symlink_to(data / name)
    (place / "twice").mkdir()
    for log in sorted((data / "davinci").glob("*.csv.gz")):
        for copy in ("a", "b"):
            (place / "twice" / f"{copy}_{log.name}").symlink_to(log)
    axis, rng = load_log(data / "emps" / "emps.csv.gz"), np.random.default_rng(0)
    torque = axis["tau_m"] - axis["tau_m"].mean()
    parts = rng.permutation(len(torque) // SEGMENT)
    other = np.concatenate([torque[SEGMENT * part : SEGMENT * (part + 1)] for part in parts])
    torque, t, q = (values[: len(other)] for values in (torque, axis["t"], axis["q_m"]))
    other -= torque * float(other @ torque) / float(torque @ torque)
    pwm = RELATED * torque / np.std(torque) + np.sqrt(1.0 - RELATED**2) * other / np.std(other)
    write_columns(place / "pwm.csv", {"t": t, "tau_m": pwm, "q_m": q}, keeping=False)
    t = np.arange(round(2.0 * TURN * RATE)) / RATE
    q = 2.0 * np.pi * (1.0 - np.abs(t / TURN - 1.0))
    torque = 0.05 * np.sign(TURN - t) + 0.03 * np.sin(7.0 * q) + 0.002 * rng.normal(size=len(t))
    write_columns(place / "cogging.csv", {"t": t, "tau_m": torque, "q_m": q}, keeping=False)


def said(finding: Finding, place: Path) -> str:
    """What the command prints that matters; raises SystemExit where it ended by anything but an answer."""
    words: list[str] = []
    for word in finding.line.split():
        words += [str(path.relative_to(place)) for path in sorted(place.glob(word))] if "*" in word else [word]
    if words[0] == "diagnose":
        words += ["--out", f"out{finding.number}"]
    run = subprocess.run([*tsa(), *words], cwd=place, capture_output=True, text=True, check=False)
    if run.returncode not in (0, 2):
        raise SystemExit(f"tsa {finding.line}: exit status {run.returncode}: {run.stderr[-2000:]}")
    lines = [line.strip() for line in (run.stdout + run.stderr).splitlines() if re.search(finding.shown, line)]
    return " ".join(lines) or f"nothing of '{finding.shown}' in: {run.stdout}{run.stderr}"


def rows(place: Path, findings: Sequence[Finding]) -> list[tuple[str, ...]]:
    """A line each: number, what was found, the command, what it says now; last the longest of the first sentences."""
    found = [(str(each.number), each.found, f"`tsa {each.line}`", said(each, place)) for each in findings]
    words = [len(row[-1].split(". ")[0].split()) for row in found if row[2].startswith("`tsa diagnose")]
    if words:
        found.append(("14", "a first sentence of 110 to 130 words", "those above", f"at most {max(words)} words"))
    return found


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--only", type=int, nargs="+", help="these rows")
    asked = parser.parse_args()
    data = command.measured_data(__name__)
    if data is None:
        return 0
    with tempfile.TemporaryDirectory() as folder:
        prepare(data.parent, Path(folder))
        wanted = [each for each in FINDINGS if asked.only is None or each.number in asked.only]
        shown = Table("row", "found once", "command", "says now")
        for row in rows(Path(folder), wanted):
            shown.add_row(*row)
    Console(width=2000).print(shown)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
