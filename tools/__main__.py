"""Start a command of this folder with `tools/run NAME [ARGUMENT...]`. Without a name, list the commands.

NAME is the path of a file. For example, bench/cycle calls `main` of tools/bench/cycle.py. tools/vcan and the first
process of its guest also start here. Their Python has no installed packages, so this module uses the standard library
only.
"""

from __future__ import annotations

import ast
import difflib
import importlib
import os
import sys
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
OF_VCAN = ("guest/vcan", "guest/init")  # started by tools/vcan and as the first process of its guest
USAGE = "usage: tools/run NAME [ARGUMENT...]"


def commands() -> dict[str, str]:
    """Return the first line of the docstring of each command, by name."""
    paths = sorted([*FOLDER.glob("*.py"), *FOLDER.glob("*/*.py")])
    names = [path.relative_to(FOLDER).with_suffix("").as_posix() for path in paths]
    return {name: line for name in names if (line := first_line(name))}


def first_line(name: str) -> str:
    """Return the first line of the docstring of a command, or "" if the docstring has no call with `tools/run`."""
    path = FOLDER / f"{name}.py"
    text = (path.is_file() and ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))) or ""
    return text.splitlines()[0] if f"tools/run {name} " in " ".join([*text.split(), ""]) else ""


def listing() -> str:
    """Return the table that is printed if no name is given."""
    found = commands()
    width = max(map(len, found)) + 2
    lines = [f"  {name:{width}}{text}" for name, text in found.items()]
    return "\n".join([f"{USAGE}; --help lists the options of each command", "", *lines])


def main(arguments: list[str]) -> int:
    """Call `main` of the command. Print a TsaError as one line, and return its exit code."""
    if not arguments or arguments[0] in ("-h", "--help"):
        print(listing())
        return 0
    name = arguments[0].removeprefix("tools/").removesuffix(".py")
    if name not in OF_VCAN and not first_line(name):
        near = difflib.get_close_matches(name.replace("_", "/"), commands(), n=1)
        hint = f"did you mean '{near[0]}'?" if near else "tools/run alone lists what there is"
        print(f"tools/run {name}: no such command; {hint}", file=sys.stderr)
        return 2
    if sys.flags.safe_path:
        sys.path.insert(0, str(FOLDER.parent))
    else:
        sys.path[0] = str(FOLDER.parent)
    importlib.import_module("tools.compiled").use()
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(variable, "1")  # one thread for libraries, because commands run one process per core
    sys.argv = [f"tools/run {name}", *arguments[1:]]
    try:
        code = importlib.import_module(f"tools.{name.replace('/', '.')}").main()
    except KeyboardInterrupt:
        print(f"tools/run {name}: interrupted", file=sys.stderr)
        return 130
    except Exception as error:
        errors = sys.modules.get("tsa_ctrl.errors")  # the guest's commands never load the package
        if errors is None or not isinstance(error, errors.TsaError):
            raise
        print(f"tools/run {name}: {error}", file=sys.stderr)
        return int(error.exit_code)
    return int(code)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
