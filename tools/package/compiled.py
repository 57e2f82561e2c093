"""Make the compiled build of this source, and compare results, speed and tests with the interpreted build.

Usage: tools/run package/compiled [--rows N] [--seed 0] [--speed ROUNDS] [--tests]

If .cache has no build of the present source, the command makes one and prints its duration and size. All commands of
tools/run use it until the source changes. With TSA_COMPILE=0 they interpret the source. A C compiler and Python's
headers are required.

--rows N runs N random rows of the virtual runs of `tools/run pins` in both builds (0: none). Every value of the log, of
the plant's truth and of the result must be equal to the last bit. --speed runs the example files alternately in both
builds. --tests runs the tests of the loop in virtual time on the compiled build. Exit code 1: a row differs, or a test
failed.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from tools import command, compiled
from tools.package import check
from tsa_ctrl.errors import UsageError

TESTS = ("tests/virtual", "tests/drives")
SECONDS = 10.0  # s of virtual time in one round of --speed


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--rows", type=int, default=6, metavar="N", help="rows to compare (default 6)")
    parser.add_argument("--seed", type=int, default=0, help="of the drawn rows")
    parser.add_argument("--speed", type=int, default=0, metavar="ROUNDS", help="compare the speed")
    parser.add_argument("--tests", action="store_true", help="run the tests of the loop on the compiled build")
    parser.add_argument("--child", choices=("rows", "speed"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        print(json.dumps(digests(options.rows, options.seed) if options.child == "rows" else speed()))
        return 0
    build()
    failed = bool(options.rows) and not equal(options.rows, options.seed)
    if options.speed:
        paired(options.speed)
    if options.tests:
        failed |= tests() != 0
    return int(failed)


def build() -> Path:
    """Return the folder of the compiled build, and make the build if it is missing."""
    place = compiled.build_folder()
    if not place.is_dir():
        shutil.rmtree(compiled.BUILDS, ignore_errors=True)
        compiled.BUILDS.mkdir(parents=True)
        began = time.monotonic()
        with tempfile.TemporaryDirectory(prefix="tsa-compiled-", dir=compiled.BUILDS) as name:
            tree, out = check.source(Path(name) / "tsa-ctrl"), Path(name) / "out"
            line = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation"]
            environment = {**os.environ, compiled.VARIABLE: "1"}
            call = [*line, "--disable-pip-version-check", "--target", str(out), str(tree)]
            done = subprocess.run(call, env=environment, capture_output=True, text=True, check=False)
            if done.returncode != 0:
                raise UsageError(f"the compiled build failed; it needs gcc and Python's headers\n{done.stderr.strip()}")
            out.rename(place)
        print(f"built in {time.monotonic() - began:.0f} s")
    size = sum(path.stat().st_size for path in place.rglob("*.so"))
    print(f"compiled build: {place}, machine code {size / 1e6:.1f} MB")
    return place


def child(build: str, *words: str) -> Any:
    """Run this command as a child process in a build ("0" interpreted, "1" compiled), and return its parsed output."""
    line = command.process(__name__, *words)
    done = subprocess.run(line, env={**os.environ, compiled.VARIABLE: build}, capture_output=True, text=True)
    if done.returncode != 0:
        raise UsageError(f"{' '.join(words)} with {compiled.VARIABLE}={build}: {done.stderr.strip()[-2000:]}")
    return json.loads(done.stdout)


def digests(count: int, seed: int) -> dict[str, str]:
    """Return the SHA-256 of all values of random virtual runs, and the kind of build that ran them."""
    from tools import pin_rows
    from tsa_ctrl.version import build_kind

    pin_rows.EVERY = 1
    jobs = [job for job in pin_rows.jobs() if job.rows[0].startswith("b ")]
    found = {"build": build_kind()}
    for job in random.Random(seed).sample(jobs, min(count, len(jobs))):
        found |= {row: hashlib.sha256(json.dumps(values).encode()).hexdigest() for row, values in job().items()}
    return found


def equal(count: int, seed: int) -> bool:
    """Return True if the random rows are equal in both builds. Print rows that differ."""
    options = ("--child", "rows", "--rows", str(count), "--seed", str(seed))
    ours, theirs = (child(build, *options) for build in "01")
    kinds = ours.pop("build"), theirs.pop("build")
    if kinds != ("interpreted", "compiled"):
        raise UsageError(f"the builds that ran are {kinds[0]} and {kinds[1]}; one of each is needed")
    differing = [row for row in ours if ours[row] != theirs[row]]
    for row in differing:
        print(f"differs: {row}")
    print(f"{len(ours)} rows in both builds, {len(ours) - len(differing)} equal to the last bit")
    return not differing


def speed() -> float:
    """Return virtual time over processor time of the example files, after a first run that loads the compiled code."""
    from tsa_ctrl import simulate_loop

    files = command.CONFIG / "controller.toml", command.CONFIG / "plant.toml"
    simulate_loop(*files, 0.5)
    began = time.process_time()
    simulate_loop(*files, SECONDS)
    return SECONDS / (time.process_time() - began)


def paired(rounds: int) -> None:
    """Run both builds alternately, and print their speed."""
    pairs = [(child("0", "--child", "speed"), child("1", "--child", "speed")) for _ in range(rounds)]
    ours, theirs = (statistics.median(each) for each in zip(*pairs, strict=True))
    gain = statistics.median(second / first for first, second in pairs)
    print(
        f"virtual over processor time, median of {rounds}: interpreted {ours:.2f}, compiled {theirs:.2f}; "
        f"gain {gain:.2f} ({min(b / a for a, b in pairs):.2f} to {max(b / a for a, b in pairs):.2f})"
    )


def tests() -> int:
    """Return the exit code of the tests of the loop on the compiled build."""
    environment = {**os.environ, compiled.SAFE_PATH: "1", "PYTHONPATH": str(compiled.build_folder())}
    marks = "not soak and not vcan and not hil and not interpreted"
    # -p loads the package before pytest puts this folder with the source at the start of the path.
    line = [sys.executable, "-m", "pytest", "-q", "-p", "tsa_ctrl", "-n", "2", "-m", marks, *TESTS]
    return subprocess.run(line, cwd=command.ROOT, env=environment, check=False).returncode
