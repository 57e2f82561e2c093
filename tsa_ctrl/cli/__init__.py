"""The `tsa` command: a table of commands, each in a separate module that is imported only when it is called."""

from __future__ import annotations

import difflib
import importlib
import os
import sys
from pathlib import Path
from typing import Any

import click
from click.shell_completion import get_completion_class

from tsa_ctrl.errors import TsaError, UsageError
from tsa_ctrl.outputs import make_folder
from tsa_ctrl.settings import write_text
from tsa_ctrl.version import __version__

PLACES = {
    "bash": (".local/share/bash-completion/completions/tsa", "active in a new shell if bash-completion is installed"),
    "zsh": (".zfunc/_tsa", "active in a new shell with 'fpath+=~/.zfunc; autoload -Uz compinit; compinit' in ~/.zshrc"),
    "fish": (".config/fish/completions/tsa.fish", "active in a new shell"),
}


VERBS: dict[str, str] = {
    "init": "write commented example files for a rig, a desk or a leg",
    "demo": "run the whole system on this machine and measure the gain of compensation",
    "run": "run the daemon: bring the drive up, run the loop, log",
    "plant": "simulate drives and joints as CANopen nodes on a bus",
    "status": "show the state of a running daemon",
    "set": "change a parameter of a running daemon",
    "stop": "ramp a running daemon's torque to zero and end it",
    "tune": "tune an axis step by step: excite, estimate, show, verify, write",
    "calibrate": "estimate friction angle and pretension from logs",
    "simulate-loop": "run the real loop on the simulated plant in virtual time",
    "simulate": "predict the joint torque for a log and print the error",
    "diagnose": "find and explain model errors, and quantify the improvement",
    "investigate": "find the cause of a torque error with experiments that the command chooses",
    "doctor": "check that this machine can run the loop",
    "data": "fetch and check published measured data",
    "log": "inspect, convert and import logs; show a rig's health over its runs",
    "drive": "probe a drive; dump, restore or compare its objects",
    "verify-safety": "hang and kill the loop, and measure each drive's reaction",
    "bench": "find the highest rate for this machine, adapter and configuration",
    "help": "show the manual's pages, or the remedy for a fault",
    "dashboard": "open a local page to watch and tune",
    "bundle": "write a field report of a run, from which it can be reproduced",
    "live": "publish signals on a WebSocket for Foxglove and PlotJuggler",
}


# Names that other programs or earlier versions use, and the commands that do this here
OTHER_NAMES = {
    "fleet": "diagnose FOLDER",
    "batch": "diagnose FOLDER",
    "health": "log trend",
    "check": "run --check",
    "probe": "drive probe",
    "fetch": "data fetch",
    "report": "bundle",
    "start": "run",
    "get": "status",
    "version": "--version",
}
RUNNING = ("status", "set", "stop", "dashboard", "live")  # commands to a running daemon, which share a module


def module_of(verb: str) -> str:
    """Return the name of the module that contains a command."""
    return "tsa_ctrl.cli." + ("running" if verb in RUNNING else verb.replace("-", "_"))


class LazyGroup(click.Group):
    """Load `tsa_ctrl.cli.NAME` on first use."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in VERBS:
            return None
        name = f"{cmd_name}_command" if cmd_name in RUNNING else "command"
        command = getattr(importlib.import_module(module_of(cmd_name)), name)
        assert isinstance(command, click.Command)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Suggest a similar command, because click searches only the loaded commands, and none is loaded."""
        if args[0] not in VERBS and not ctx.resilient_parsing and (said := self._nearest(ctx, args[0])):
            ctx.fail(f"No such command '{args[0]}'; did you mean '{said}'?")
        return super().resolve_command(ctx, args)

    def _nearest(self, ctx: click.Context, name: str) -> str | None:
        """Return the command that was probably meant: by another name, spelled alike, or a subcommand."""
        near = difflib.get_close_matches(name, VERBS, n=1)
        if name in OTHER_NAMES or near:
            return OTHER_NAMES.get(name) or near[0]
        groups = {verb: command for verb in VERBS if isinstance(command := self.get_command(ctx, verb), click.Group)}
        within = {sub: f"{verb} {sub}" for verb, group in groups.items() for sub in group.list_commands(ctx)}
        near = difflib.get_close_matches(name, within, n=1)
        return within[near[0]] if near else None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(VERBS.items()))


def install_completion(ctx: click.Context, _: click.Parameter, asked: bool) -> None:
    """Write the completion script for the user's shell ($SHELL) and print its path; raise UsageError for others."""
    if not asked:
        return
    shell = Path(os.environ.get("SHELL", "")).name
    maker = get_completion_class(shell) if shell in PLACES else None
    if maker is None:
        raise UsageError(f"--install-completion: no completion for shell '{shell}'; set SHELL to {', '.join(PLACES)}")
    place, hint = PLACES[shell]
    path = Path.home() / place
    make_folder(path.parent, "correct its owner")
    write_text(path, maker(ctx.command, {}, "tsa", "_TSA_COMPLETE").source())
    click.echo(f"{path}: written; {hint}")
    ctx.exit()


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="tsa")
@click.option(
    "--install-completion",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=install_completion,
    help="Install completion of commands and options for this shell.",
)
def cli() -> None:
    """Feedforward torque control through tendon-sheaths, and the diagnosis of its model."""


def main(argv: list[str] | None = None) -> Any:
    """Run `tsa`. Exit codes: 0 done, 1 machine or bus failed, 2 wrong command, configuration or data."""
    try:
        code = cli.main(args=argv, prog_name="tsa", standalone_mode=False)
        sys.exit(code if isinstance(code, int) else 0)
    except click.exceptions.Abort:
        print("tsa: interrupted", file=sys.stderr)
        sys.exit(1)
    except click.exceptions.NoArgsIsHelpError as error:  # its message is the whole help
        print(error.format_message(), file=sys.stderr)
        sys.exit(2)
    except click.ClickException as error:
        where = error.ctx.command_path if isinstance(error, click.UsageError) and error.ctx else "tsa"
        hint = f" (see '{where} --help')" if isinstance(error, click.UsageError) else ""
        print(f"{where}: {' '.join(error.format_message().split())}{hint}", file=sys.stderr)
        sys.exit(2)
    except TsaError as error:
        print(f"tsa: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(error.exit_code)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except KeyboardInterrupt:
        print("tsa: interrupted", file=sys.stderr)
        sys.exit(1)
