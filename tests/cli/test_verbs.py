"""Test the common properties of all commands: help with an example, one-line errors, and shell completion."""

from __future__ import annotations

import contextlib
import io
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from tests.conftest import ROOT
from tsa_ctrl.cli import OTHER_NAMES, VERBS, cli, main, module_of
from tsa_ctrl.cli.drive import find_target
from tsa_ctrl.cli.options import Finite
from tsa_ctrl.errors import UsageError
from tsa_ctrl.safety.causes import Cause


def commands() -> list[str]:
    """Return all commands, with a group replaced by its subcommands."""
    found: list[str] = []
    for verb in VERBS:
        command = cli.get_command(click.Context(cli), verb)
        if isinstance(command, click.Group):
            found += [f"{verb} {name}" for name in command.list_commands(click.Context(command))]
        else:
            found.append(verb)
    return found


@pytest.mark.parametrize("line", commands())
def test_help_has_an_example_and_no_number_may_be_nan_or_infinite(line: str) -> None:
    text = CliRunner().invoke(cli, [*line.split(), "--help"], catch_exceptions=False).output
    assert f" tsa {line}" in text.partition("Example")[2]
    command: click.Command | None = cli
    for word in line.split():
        assert isinstance(command, click.Group)
        command = command.get_command(click.Context(command), word)
    assert command is not None
    for option in command.params:
        for kind in getattr(option.type, "types", [option.type]):
            assert isinstance(kind, Finite) or not isinstance(kind, click.types.FloatParamType), option.name


def failed(*line: str) -> str:
    """Return the message of a command with a wrong option."""
    out, err = io.StringIO(), io.StringIO()
    with pytest.raises(SystemExit) as ended, contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        main(list(line))
    assert (ended.value.code, out.getvalue(), err.getvalue().count("\n")) == (2, "", 1)
    return err.getvalue()


@pytest.mark.parametrize("line", [*commands(), ""])
def test_wrong_option_is_one_line_and_code_2(line: str) -> None:
    for wrong in ("--no-such-option", "--json=maybe"):
        failed(*line.split(), wrong)


def test_a_number_that_is_none_is_one_line_and_code_2() -> None:
    for line, option in (
        ("run", "--seconds"),
        ("bench", "--seconds"),
        ("doctor", "--seconds"),
        ("verify-safety", "--torque"),
    ):
        for number in ("nan", "inf", "-inf"):
            assert option in failed(line, "no.toml", option, number)
    for line in ("tune", "investigate"):
        assert "--travel" in failed(line, "no.toml", "--out", "out", "--travel", "-inf", "inf")


def test_unknown_verb_is_one_line_with_the_nearest(monkeypatch: pytest.MonkeyPatch) -> None:
    assert failed("diagnoze").startswith("tsa: No such command 'diagnoze'")
    assert "did you mean 'status'?" in failed("stat")
    assert "did you mean 'diagnose FOLDER'?" in failed("fleet", "folder")
    assert "did you mean 'log convert'?" in failed("convert", "file")
    assert "did you mean 'drive diff'?" in failed("dif", "file")
    assert all(name.split()[0] in VERBS or name == "--version" for name in OTHER_NAMES.values())
    monkeypatch.setenv("SHELL", "/bin/tcsh")
    assert "no completion for shell 'tcsh'" in failed("--install-completion")


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_is_installed_where_the_shell_looks(
    shell: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("SHELL", f"/usr/bin/{shell}")
    with pytest.raises(SystemExit) as ended:
        main(["--install-completion"])
    assert ended.value.code == 0
    path = Path(capsys.readouterr().out.split(":")[0])
    assert path.is_relative_to(tmp_path)
    assert "_TSA_COMPLETE" in path.read_text("utf-8")


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash here")
def test_bash_completes_a_verb_by_the_installed_script(tmp_path: Path) -> None:
    environment = {**os.environ, "HOME": str(tmp_path), "SHELL": "/bin/bash"}
    environment["PATH"] = f"{Path(sys.executable).parent}:{environment['PATH']}"
    subprocess.run(["tsa", "--install-completion"], env=environment, check=True, capture_output=True)
    script = tmp_path / ".local/share/bash-completion/completions/tsa"
    ask = f"source {script}; COMP_WORDS=(tsa diag); COMP_CWORD=1; _tsa_completion tsa; echo ${{COMPREPLY[@]}}"
    found = subprocess.run(["bash", "-c", ask], env=environment, capture_output=True, text=True, check=False)
    assert found.stdout.split() == ["diagnose"]


LOADED = """
import importlib, sys
for name in sys.argv[2:]:
    importlib.import_module(name)
    print(name, [each for each in sys.argv[1].split() if each in sys.modules])
"""


def test_help_and_completion_load_nothing_that_is_slow_to_load() -> None:
    heavy = "numba scipy matplotlib canopen can numpy mcap tomlkit rich.console starlette"
    names = [module_of(verb) for verb in VERBS]
    found = subprocess.run([sys.executable, "-c", LOADED, heavy, *names], capture_output=True, text=True, check=True)
    assert found.stdout.splitlines() == [f"{name} []" for name in names]


def test_no_process_of_a_run_loads_what_draws_reports_serves_or_fits() -> None:
    """No process imports a library for plots, reports or fits. numba imports the package `scipy` without submodules."""
    heavy = "matplotlib duckdb jinja2 pyarrow rich scipy.linalg scipy.optimize scipy.stats starlette uvicorn"
    modules = ("daemon.run", "daemon.monitor_process", "ipc.server", "ipc.client", "log.process", "log.writer")
    names = [f"tsa_ctrl.{name}" for name in (*modules, "cli.running")]
    found = subprocess.run([sys.executable, "-c", LOADED, heavy, *names], capture_output=True, text=True, check=True)
    assert found.stdout.splitlines() == [f"{name} []" for name in names]


@pytest.mark.parametrize(("line", "first"), [([], "Usage: tsa [OPTIONS]"), (["drive"], "Usage: tsa drive [OPTIONS]")])
def test_a_command_without_its_verb_shows_the_help_as_it_is_formatted(
    line: list[str], first: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(line)
    said = capsys.readouterr().err.splitlines()
    assert ended.value.code == 2
    assert said[0].startswith(first)
    assert len(said) > 5


def test_ctrl_c_while_the_verbs_are_loaded_is_one_line() -> None:
    code = """
import sys
class Interrupting:
    def find_spec(self, name, path=None, target=None):
        if name == "click":
            raise KeyboardInterrupt
sys.meta_path.insert(0, Interrupting())
from tsa_ctrl.__main__ import entry
entry()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (1, "", "tsa: interrupted\n")


def test_little_is_loaded_before_ctrl_c_is_a_line() -> None:
    """An interrupt before `entry` of the script `tsa` prints a traceback, so few modules are imported until then."""
    code = f"import sys; sys.path.insert(0, {str(ROOT)!r}); import tsa_ctrl.__main__; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-SE", "-c", code], capture_output=True, text=True, check=True)
    assert {"typing", "tempfile", "shutil", "click", "tsa_ctrl.cli"}.isdisjoint(loaded.stdout.split())


def test_help_of_a_fault_gives_its_remedy() -> None:
    """The fault is found by its id in the JSON status, by its title in any letter case, and by its event."""
    for cause in Cause:
        event = f"2.7 s  knee: {cause.title}: node 1"
        for topics in ([cause.id], [cause.title], [cause.title.upper()], cause.title.split(), [event]):
            result = CliRunner().invoke(cli, ["help", *topics], catch_exceptions=False)
            assert cause.remedy in " ".join(result.output.split())


@pytest.mark.parametrize(
    ("topic", "words"),
    [
        ("0x8250", ["0x8250 as EMCY error code: RPDO time-out\n", "choose a lower rate", "tsa help held_up"]),
        ("8250", ["0x8250 as EMCY error code: RPDO time-out\n"]),
        ("EMCY 0x8130", ["life guard or heartbeat error", "tsa help held_up"]),
        ("emcy 0x2311", ["over-current at the output (the group; the manual of the drive", "tsa help emergency"]),
        ("0x06090030", ["0x06090030 as SDO abort code: the node rejected an SDO access: "]),
        ("abort 06020000", ["Object does not exist"]),
        ("0x6072", ["0x6072 as object: 0x6072:0 max torque, U16\n", "See also: tsa help "]),
        ("6072h", ["0x6072 as object: 0x6072:0 max torque"]),
        ("0x1018:4", ["0x1018:4 serial number"]),
        ("0x1018", ["0x1018:1 vendor", "0x1018:4 serial number"]),
        ("0x6872", ["0x6872:0 max torque, U16, of slot 2"]),
        ("0x1A02:1", ["mapping of TPDO 3"]),
        ("0x2003:5", ["an object of the manufacturer", "tsa drive dump"]),
        ("0x0637", ["statusword: state operation_enabled; bits set: 4 voltage enabled, 9 remote, 10 target reached"]),
        ("statusword 0x1208", ["state fault"]),
        ("0xFF12", ["device specific; the manual of the drive"]),
    ],
)
def test_help_explains_the_codes_of_a_drive(topic: str, words: list[str]) -> None:
    result = CliRunner().invoke(cli, ["help", *topic.split()], catch_exceptions=False)
    assert result.exit_code == 0
    assert [each for each in words if each not in result.output] == [], result.output
    assert max(map(len, result.output.splitlines())) < 250


@pytest.mark.parametrize("topic", ["0x12345678", "0xC0DE:1", "abort 0x1"])
def test_help_of_an_unknown_code_gives_the_place_to_look(topic: str) -> None:
    error = CliRunner().invoke(cli, ["help", *topic.split()]).exception
    assert isinstance(error, UsageError)
    assert re.fullmatch(r"help: 0x\w+ is no code .*; look in the manual of the drive .*", str(error))


def test_help_lists_every_fault_and_knows_a_misspelt_one() -> None:
    output = CliRunner().invoke(cli, ["help", "faults"]).output
    assert [line.split()[0] for line in output.splitlines()] == [cause.id for cause in Cause]
    assert isinstance(
        CliRunner().invoke(cli, ["help", "each"]).exception, UsageError
    )  # no hexadecimal number with an h
    error = CliRunner().invoke(cli, ["help", "stalepdo"]).exception
    assert isinstance(error, UsageError)
    assert "did you mean 'stale_pdo'?" in str(error)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("verify-safety no.toml --held --torque 0.1 --record out", "--held does not use --torque and --record"),
        ("demo --leg --seed 2", "--leg can only be combined with"),
        ("demo --leg --load imposed", "--leg can only be combined with"),
        ("demo --seed 2", "--hidden and --seed require --full"),
    ],
)
def test_an_option_without_effect_is_rejected(line: str, words: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(line.split())
    said = capsys.readouterr()
    assert (ended.value.code, said.out, said.err.count("\n"), words in said.err) == (2, "", 1, True)


def test_the_profile_of_a_drive_is_a_path_from_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mine.toml").write_text('name = "mine"\n', encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    assert find_target(None, None, 1, "virtual", "x", 1_000_000, "mine.toml").profile.name == "mine"
