"""`tsa help`: show the pages of the manual in the terminal; the package contains them."""

from __future__ import annotations

import difflib
import re
import sys
import textwrap
from pathlib import Path

import click

from tsa_ctrl.bus.canopen.meanings import Code, code_in, meanings
from tsa_ctrl.errors import UsageError
from tsa_ctrl.outputs import terminal
from tsa_ctrl.safety.causes import HELD_UP_CODES, Cause

PACKAGE = Path(__file__).parents[1]
TOPICS = {
    "commands": ("cli/README.md", "every command, the files, first steps at a desk"),
    "rig": ("shipped/README.md", "a real drive: wiring, rights, watchdogs, first torque, troubleshooting, every key"),
    "choose": ("CHOOSE.md", "tables: sensors and estimator, class of use, kind of model, load of a simulation"),
    "drives": (
        "bus/drive/README.md",
        "a new drive: probe, profiles and their open questions",
    ),
    "safety": ("safety/README.md", "hazards, their detection, and the condition of passivity"),
    "monitor": ("monitor/README.md", "the second channel: checks, reaction, outputs for safe torque off"),
    "model": ("model/README.md", "the equations as printed and as used, the catalogue of effects"),
    "identify": ("identify/README.md", "calibrate and diagnose: how to read a verdict, the method, limits"),
    "figures": ("FIGURES.md", "every figure of the manual, with the command that prints it, when and on which version"),
    "changes": ("CHANGES.md", "changes of each version; those that affect a motor torque come first"),
    "client": (
        "ipc/README.md",
        "your own controller as a client: set-points over the socket, the lease, permissions",
    ),
    "design": ("DESIGN.md", "ranked goals, decisions with their reasons, rejected alternatives"),
    "code": ("README.md", "a map of the code, and how to extend it"),
}


@click.command("help", epilog="Example: tsa help rig", context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("topics", metavar="[TOPIC]", nargs=-1)
@click.pass_context
def command(ctx: click.Context, topics: tuple[str, ...]) -> None:
    """Show a page of the manual, the help of a command, or the remedy of a fault; without TOPIC, list all topics."""
    topic = " ".join(topics)
    if not topic:
        for name in TOPICS:
            click.echo(f"{name:10s}{TOPICS[name][1]}")
        click.echo("and every command: tsa help diagnose shows tsa diagnose --help")
        click.echo("and every fault by its cause_id, for example tsa help stale_pdo; tsa help faults lists them all")
        click.echo("and every code of a drive: EMCY, SDO abort code, object or statusword, for example tsa help 0x8250")
        return
    if topic in TOPICS:
        _page((PACKAGE / TOPICS[topic][0]).read_text(encoding="utf-8"))
        return
    causes = {cause.id: cause for cause in Cause}
    if topic == "faults":
        click.echo("\n".join(f"{identifier:20s}{each.title}" for identifier, each in causes.items()))
        return
    if cause := causes.get(_identifier(topic)):
        click.echo(f"{cause.title} (cause_id {cause.id})\n{textwrap.fill(f'Remedy: {cause.remedy}.', 100)}")
        return
    if code := code_in(topic):
        _explain(code, topic)
        return
    root = ctx.find_root()
    group = root.command
    assert isinstance(group, click.Group)
    verb = group.get_command(root, topic)
    if verb is None:
        known = [*TOPICS, "faults", *causes, *group.list_commands(root)]
        near = difflib.get_close_matches(topic, known, n=1)
        advice = f"did you mean '{near[0]}'?" if near else f"available: {', '.join(TOPICS)}, faults, and every command"
        raise UsageError(f"help: no page '{topic}'; {advice}")
    with click.Context(verb, info_name=topic, parent=root) as inner:
        click.echo(verb.get_help(inner))


def _explain(code: Code, topic: str) -> None:
    """Print every meaning of a number of a CANopen device, and the pages of the manual that mention it."""
    lines = meanings(code, topic)
    texts = {name: (PACKAGE / page).read_text(encoding="utf-8") for name, (page, _) in TOPICS.items()}
    pages = [name for name, text in texts.items() if str(code).lower() in text.lower() and name != "changes"]
    if not lines and not pages:
        raise UsageError(
            f"help: {code} is no code of CiA 301 or 402 that this program knows; look in the manual of the drive "
            "(error codes, abort codes, object dictionary), or read it with tsa drive dump"
        )
    for line in lines:
        click.echo(line)
    if code.value in HELD_UP_CODES and code.subindex is None:
        click.echo(f"Remedy: {Cause.HELD_UP.remedy} (tsa help {Cause.HELD_UP.id})")
    elif any(" as EMCY " in line for line in lines):
        click.echo(f"Remedy: {Cause.EMERGENCY.remedy} (tsa help {Cause.EMERGENCY.id})")
    if pages:
        click.echo(f"See also: {', '.join(f'tsa help {name}' for name in pages)}")


def _identifier(topic: str) -> str:
    """Return the id of a cause from its id, its title, or an event with its title, as printed by status and events."""
    words = topic.strip().lower()
    titles = {cause.title.lower(): cause.id for cause in Cause}
    contained = [title for title in titles if re.search(rf"\b{re.escape(title)}\b", words)]
    return titles[max(contained, key=len)] if contained else words.replace(" ", "_").replace("-", "_")


def _page(text: str) -> None:
    """Print a page: rendered and in a pager on a terminal, otherwise as plain text."""
    if not sys.stdout.isatty():
        click.echo(text)
        return
    from rich.markdown import Markdown

    console = terminal()
    with console.pager(styles=True):
        console.print(Markdown(text))
