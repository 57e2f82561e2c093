"""`tsa --install-completion`: the shell's completion script where the shell looks for it.

The script and what it completes are click's own; click only has no command that puts the script in its place.
"""

from __future__ import annotations

import os
from pathlib import Path

import click
from click.shell_completion import get_completion_class

from tsa_ctrl.errors import UsageError
from tsa_ctrl.settings import write_text

PLACES = {
    "bash": (".local/share/bash-completion/completions/tsa", "a new shell has it where bash-completion is installed"),
    "zsh": (".zfunc/_tsa", "a new shell has it with 'fpath+=~/.zfunc; autoload -Uz compinit; compinit' in ~/.zshrc"),
    "fish": (".config/fish/completions/tsa.fish", "a new shell has it"),
}


def install(ctx: click.Context, _: click.Parameter, asked: bool) -> None:
    """Write the script of the user's shell ($SHELL) and say where; raises UsageError for another shell."""
    if not asked:
        return
    shell = Path(os.environ.get("SHELL", "")).name
    maker = get_completion_class(shell) if shell in PLACES else None
    if maker is None:
        raise UsageError(f"--install-completion: no completion for shell '{shell}'; set SHELL to {', '.join(PLACES)}")
    place, hint = PLACES[shell]
    path = Path.home() / place
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{path.parent}: cannot be made ({error.strerror}); correct its owner") from None
    write_text(path, maker(ctx.command, {}, "tsa", "_TSA_COMPLETE").source())
    click.echo(f"{path}: written; {hint}")
    ctx.exit()
