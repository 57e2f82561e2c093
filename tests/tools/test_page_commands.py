"""Every command in a page or a help text exists and accepts the shown options. Blocks that need no rig are run."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import click
import numpy as np
import pytest

from tests.cli.test_verbs import commands
from tests.conftest import ROOT
from tools.manual.write import PAGES
from tsa_ctrl.cli import cli, main

BLOCK = re.compile(r"^```\w*\n(.*?)^```", re.DOTALL | re.MULTILINE)
INLINE = re.compile(r"`([^`\n]+(?:\n[^`\n]+)?)`")
COMMANDS = ("tsa ", "tools/run ", ".venv/bin/tsa ")
SKIPPED_WORDS = {"&&", "|", ">", ">>", "&"}  # the words after these belong to the shell


def lines_of(text: str) -> Iterator[str]:
    """Yield every command in a page, from blocks (without a trailing comment) and between back-ticks."""
    blocks = "".join(match[1] for match in BLOCK.finditer(text))
    spoken = (" ".join(match[1].split()) for match in INLINE.finditer(BLOCK.sub("", text)))
    for line in (*(line.split("  #")[0].split(" # ")[0].strip() for line in blocks.splitlines()), *spoken):
        if line.startswith(COMMANDS):
            yield line.removeprefix(".venv/bin/")


def shown() -> list[tuple[str, str]]:
    found = {}
    for page in PAGES:
        if (ROOT / page).is_file():
            found.update(dict.fromkeys(lines_of((ROOT / page).read_text(encoding="utf-8")), page))
    return sorted((line, page) for line, page in found.items())


def words_of(line: str) -> list[str]:
    words = shlex.split(line)
    return words[: min((words.index(word) for word in SKIPPED_WORDS if word in words), default=len(words))]


def parsed(line: str) -> None:
    """Raise click's error if the command does not exist or does not have the options. Nothing is run."""
    context, command, words = click.Context(cli), cli, words_of(line)[1:]
    assert isinstance(command, click.Command)
    while isinstance(command, click.Group) and words and not words[0].startswith("-"):
        name, found, words = command.resolve_command(context, words)
        assert found is not None
        context, command = click.Context(found, info_name=name, parent=context), found
    try:
        command.make_parser(context).parse_args([*words])
    except click.BadOptionUsage as error:
        if error.option_name != words[-1]:  # a page may mention an option without its value
            raise


@pytest.mark.parametrize(("line", "page"), [pair for pair in shown() if pair[0].startswith("tsa ")])
def test_a_verb_of_a_page_takes_what_the_page_writes(line: str, page: str) -> None:
    try:
        parsed(line)
    except click.UsageError as error:
        pytest.fail(f"{page}: `{line}`: {error.format_message()}")


def test_the_check_prints_what_the_commissioning_page_expects(capsys: pytest.CaptureFixture[str]) -> None:
    page = (ROOT / "config/README.md").read_text(encoding="utf-8")
    with pytest.raises(SystemExit):
        main(["run", "--check", str(ROOT / "config/controller.toml")])
    printed = capsys.readouterr().out.strip().removeprefix(f"{ROOT}/config/")
    assert f"`{printed}`" in page
    assert f"The check prints `{printed.split()[1].rstrip(';')}`" in page


@pytest.mark.parametrize(("line", "page"), [pair for pair in shown() if pair[0].startswith("tools/run ")])
def test_a_tool_of_a_page_is_there_and_knows_the_option(line: str, page: str) -> None:
    _, name, *words = words_of(line)
    path = ROOT / "tools" / f"{name}.py"
    if name in {"NAME", "--help"}:
        return
    assert path.is_file(), f"{page}: `{line}`: no {path}"
    text = path.read_text(encoding="utf-8")
    for folder, names in re.findall(r"^from tools\.([\w.]+) import ([\w, ]+)$", text, re.MULTILINE):
        modules = [ROOT / "tools" / folder.replace(".", "/") / f"{module}.py" for module in names.split(", ")]
        text += "".join(module.read_text(encoding="utf-8") for module in modules if module.is_file())  # its modes
    shared = {
        f"--{each}" for found in re.findall(r'command\.share\(parser, "([\w ]+)"', text) for each in found.split()
    }
    for option in (word.split("=")[0] for word in words if word.startswith("--")):
        assert option in shared or f'"{option}"' in text, f"{page}: `{line}`: {name} has no {option}"


@pytest.mark.parametrize("verb", commands())
def test_the_example_of_a_help_text_is_valid(verb: str) -> None:
    context, command = click.Context(cli), cli
    for word in verb.split():
        assert isinstance(command, click.Group)
        found = command.get_command(context, word)
        assert found is not None
        context, command = click.Context(found, info_name=word, parent=context), found
    text = " ".join(command.get_help(context).partition("Example")[2].split())
    lines = [f"tsa {words}" for words in re.split(r"(?:^|[ ;])tsa (?!\.)", text.partition(": ")[2])[1:]]
    assert lines
    for line in lines:
        parsed(line.removesuffix(";"))


def test_what_is_wrong_in_a_page_is_found() -> None:
    """The check detects an option and a command that do not exist."""
    assert list(lines_of("a `tsa demo --virtual` b\n```\ntsa run x.toml  # words\n```\n")) == [
        "tsa run x.toml",
        "tsa demo --virtual",
    ]
    for wrong in ("tsa demo --no-such", "tsa nonsense", "tsa log nonsense"):
        with pytest.raises(click.UsageError):
            parsed(wrong)


def write_foreign(path: Path) -> None:
    """Write a table in the style of other programs: semicolons, decimal commas, ms, degrees, mN m.

    The data have a Coulomb friction of 2 mN m and an offset of 1 mN m.
    """
    t = np.arange(0.0, 10.0, 0.005)
    angle, speed = np.sin(1.9 * t) + 0.4 * np.sin(3.1 * t), 1.9 * np.cos(1.9 * t) + 1.24 * np.cos(3.1 * t)
    noise = np.random.default_rng(7).normal(0.0, 0.2, t.size)
    torque = 1e-3 * speed + 2.0 * np.tanh(speed / 0.01) + 1.0 + noise
    rows = zip(1e3 * t, np.degrees(angle), np.degrees(speed), torque, strict=True)
    lines = [f"{a:.0f};{b:.5f};{c:.5f};{d:.4f}".replace(".", ",") for a, b, c, d in rows]
    head = "Zeit [ms];Winkel Motor [°];Drehzahl Motor [°/s];Drehmoment Motor [mNm]"
    path.write_text("\n".join([head, *lines, ""]), encoding="cp1252")


@pytest.mark.slow
def test_the_block_of_the_readme_about_a_log_of_ones_own_works_as_written(tmp_path: Path) -> None:
    """A table of another program passes import, simulate and diagnose up to the report."""
    write_foreign(tmp_path / "measured.txt")
    block = BLOCK.search((ROOT / "README.md").read_text(encoding="utf-8").partition("## Bring your log")[2])
    assert block is not None
    lines = list(lines_of(block[0]))
    assert [words_of(line)[1] for line in lines] == ["log", "simulate", "diagnose"]
    for line in lines:
        done = subprocess.run(
            [str(Path(sys.executable).with_name("tsa")), *words_of(line)[1:]],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            stdin=subprocess.DEVNULL,
            check=False,
        )
        assert done.returncode == 0, f"{line}: {done.stderr}"
    assert (tmp_path / "mine/diagnosis/report.html").is_file()
