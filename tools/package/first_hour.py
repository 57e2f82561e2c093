"""What newcomers met in their first hour, and what the same commands say today.

Usage: tools/run package/first_hour [--only NUMBER ...]

The commands run as they stand in a folder that `tsa init` has made, with a log of 12 s of `tsa simulate-loop` in it,
a table of another program, and a log from which a sample is missing. What a table cannot show has its tests: the
dashboard (tests/dashboard), set-points from a program and what a daemon tells (tests/daemon), what `tsa tune` shows
while it moves (tests/tune).
"""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path

from tools import answers
from tools.answers import Case
from tsa_ctrl.settings import write_text
from tsa_ctrl.system.processes import tsa

DIAGNOSE = "tsa diagnose log.csv --model actuator.toml --out d"
DESK = "tsa init desk --desk && (timeout 40 tsa plant desk/plant.toml & sleep 25)"
IMPORT = "tsa log import foreign.csv --out imported --column tau_m='Moment [mNm]' --column q_m='Winkel [deg]'"
CASES = (
    Case(1, "the measurement overwritten", "tsa calibrate log.csv --model actuator.toml --out log.csv", "^tsa"),
    Case(
        1, "a file replaced silently", "tsa calibrate log.csv --model actuator.toml --out actuator.toml", "^tsa|written"
    ),
    Case(2, "no home: numba's traceback", "HOME=/proc/none tsa simulate log.csv --model actuator.toml", "cache|^RMS"),
    Case(3, "two into one folder, both rc 0", f"{DIAGNOSE} & sleep 2; {DIAGNOSE}; wait", "another command"),
    Case(4, "the whole help in a paragraph", "tsa drive", "^Usage"),
    Case(5, "no files in the wheel", "tsa init copy", "written: copy/[a-z]*.toml|^  tsa"),
    Case(6, "the plant compiles in silence", DESK, "starting|compil|ready"),
    Case(8, "a table of another program", "tsa log import foreign.csv --out imported", "^tsa"),
    Case(8, "the same, told what it holds", f"{IMPORT} --yes", "Zeit|Moment|Winkel|written"),
    Case(9, "a lost sample: cut the file", "tsa simulate hole.csv --model actuator.toml", "missing|hole|filled|^RMS"),
    Case(11, "unit 1 printed", "tsa calibrate log.csv --model actuator.toml", "slope .*[0-9]"),
    Case(15, "a file of the other kind", "tsa simulate log.csv --model controller.toml", "^tsa"),
    Case(20, "--out x.mcap refused, against the manual", "tsa log convert run/tsa.mcap --out x.mcap", "^tsa"),
    Case(20, "a constant log, no word", "tsa simulate constant.csv --model actuator.toml", "one point|nothing|^RMS"),
)


def prepare(place: Path) -> None:
    """The rig's files, its log, and what else the commands read."""
    for line in (
        ("init", "--desk", "."),
        ("simulate-loop", "controller.toml", "plant.toml", "--seconds", "12", "--out", "run"),
        ("log", "convert", "run/tsa.mcap", "--out", "log.csv"),
    ):
        subprocess.run(tsa(*line), cwd=place, capture_output=True, check=True)
    rows = (place / "log.csv").read_text(encoding="utf-8").splitlines()
    write_text(place / "hole.csv", "\n".join(rows[:3000] + rows[3001:]) + "\n")
    angles = [0.3 * (number % 200 - 100) for number in range(2000)]
    table = [f"{0.005 * i:.3f};{25.0 + 5.0 * (i // 200 % 2):.2f};{angle:.3f}" for i, angle in enumerate(angles)]
    write_text(
        place / "foreign.csv", ("Zeit [s];Moment [mNm];Winkel [deg]\n" + "\n".join(table)).replace(".", ",") + "\n"
    )
    constant = "".join(f"{0.001 * i:.3f},0.5,0.5,0.1\n" for i in range(2000))
    write_text(place / "constant.csv", "t,tau_m,tau_j,omega_j\n" + constant)


def main() -> int:
    wanted = answers.asked(__name__, __doc__, CASES)
    with tempfile.TemporaryDirectory() as folder:
        prepare(Path(folder))
        answers.show(answers.rows(Path(folder), wanted))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
