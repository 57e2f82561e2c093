"""What once went wrong on measured logs of others, and what each command says of them today.

Usage: tools/run measured/findings [--only NUMBER ...]

Each line is a command of a user's, run as it stands in a folder with the measured sets (emps, epos, bam, davinci) and
with what is made of them: one set twice over, a torque that has little to do with the motion, a cogging map. The data
are looked for in the folder named by TSA_DATA, else in ../shared/data; without them there is one line.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tools import answers, command
from tools.answers import Case
from tsa_ctrl.identify.dataset import load_log
from tsa_ctrl.log.csv_out import write_columns

RELATED = 0.14  # correlation of what stands in the place of the torque with the torque: as of a PWM that was found so
SEGMENT = 500  # samples of the torque that change places: its spectrum stays, its motion goes
RATE = 100.0  # Hz, of the cogging map
TURN = 60.0  # s, of one slow turn each way

CASES = (
    Case(
        1,
        "the published axis simulated at 14 N, and unexplained",
        "tsa diagnose emps/emps.csv.gz --model emps/emps.toml --out out/1",
        "^[A-Z].*falls",
    ),
    Case(1, "the same, by simulate", "tsa simulate emps/emps.csv.gz --model emps/emps.toml", "^RMS|omega_m is derived"),
    Case(
        2,
        "half of the time at rest: asymmetric friction, offset excluded",
        "tsa diagnose epos/start_stop/*.csv.gz --model epos/drive.toml --out out/2",
        "^[A-Z].*falls",
    ),
    Case(
        4,
        "one log of 20 s: a weight of 1.27 N·m, where the torque is 0.07",
        "tsa diagnose davinci/load050_0.3Hz.csv.gz --model davinci/actuator.toml --out out/3",
        "^These",
    ),
    Case(
        5,
        "50 trials, 1,000 s: the joint hardly moves",
        "tsa diagnose twice/*.csv.gz --model davinci/actuator.toml --out out/4",
        "^[A-Z].*falls",
    ),
    Case(
        6,
        "a spring of 9e-11 N·m/rad that rests at 3.8e6 rad",
        "tsa diagnose epos/steady/*.csv.gz --model epos/drive.toml --out out/5",
        "^[A-Z].*falls",
    ),
    Case(
        7,
        "a weight, or an offset, or asymmetric friction",
        "tsa diagnose bam/*.csv.gz --model bam/xl330.toml --out out/6",
        "^[A-Z].*falls|^Excluded",
    ),
    Case(
        8,
        "a PWM for torque: one name alone, gain 93 %",
        "tsa diagnose pwm.csv --model emps/emps.toml --out out/7",
        "^verdict|^These|^[A-Z].*(falls|held-out)",
    ),
    Case(
        9,
        "a cogging map: the joint hardly moves",
        "tsa diagnose cogging.csv --model bam/xl330.toml --out out/8",
        "^[A-Z].*falls",
    ),
    Case(
        10,
        "calibrated was worse, without a word",
        "tsa calibrate davinci/*.csv.gz --model davinci/actuator.toml --out calibrated.toml",
        "^RMS",
    ),
    Case(
        10,
        "a rigid drive was refused without a hint",
        "tsa calibrate epos/steady/*.csv.gz --model epos/drive.toml --out drive.toml",
        "^tsa",
    ),
    Case(
        11,
        "a late row refused the file",
        "tsa simulate bam/kp100_up_and_down.csv.gz --model bam/xl330.toml",
        "jitters|late|^RMS",
    ),
    Case(
        11,
        "7.8 Hz: t seems to be in milliseconds",
        "tsa simulate epos/steady/n002.csv.gz --model epos/drive.toml",
        "samples at|^RMS",
    ),
    Case(
        12,
        "recalibrated was worse, not said",
        "tsa diagnose emps/emps.csv.gz --model emps/emps.toml --out out/9",
        "^Recalibration",
    ),
    Case(
        15,
        "what is left depends on the joint's angle",
        "tsa diagnose davinci/*_0.3Hz.csv.gz --model davinci/actuator.toml --out out/10",
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


def longest(lines: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    """The row of the first sentences, of what every diagnosis says."""
    words = [len(line[-1].split(". ")[0].split()) for line in lines if line[2].startswith("`tsa diagnose")]
    return "14", "a first sentence of 110 to 130 words", "those above", f"at most {max(words)} words"


def main() -> int:
    wanted = answers.asked(__name__, __doc__, CASES)
    data = command.measured_data(__name__)
    if data is None:
        return 0
    with tempfile.TemporaryDirectory() as folder:
        prepare(data.parent, Path(folder))
        lines = answers.rows(Path(folder), wanted)
    if any("diagnose" in each.line for each in wanted):
        lines.append(longest(lines))
    answers.show(lines)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
