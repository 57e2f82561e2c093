"""Write the licences of the packages that are needed at run time, as stated by their distributions.

Usage: tools/run package/licences

The file tools/package/licences.json has name and licence of each package, and a flag for direct dependencies.
`tools/run manual/write` generates a table from it.
"""

from __future__ import annotations

import importlib.metadata as metadata
import json
import re
import tomllib
from pathlib import Path

from tools import command
from tsa_ctrl import settings
from tsa_ctrl.errors import UsageError

FILE = Path(__file__).with_name("licences.json")
DEVELOPMENT = ("docs", "dev")  # extras that no user installs
# All of these allow use by a program under any licence; any-OSI (apsw) lets the user choose. LGPL (gpiod, nptdms,
# python-can) requires a separate library that the user can replace; an import from site-packages fulfils this.
COMPATIBLE = re.compile(r"MIT|BSD|Apache|PSF|Python Software Foundation|LGPL|Zlib|CC0|HPND|any-OSI")


def runtime() -> list[str]:
    """Return the names of the direct dependencies of the package and of all extras that its users install."""
    project = tomllib.loads((command.ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    lines = [line for extra, lines in extras.items() if extra not in DEVELOPMENT for line in lines]
    return sorted({_name(line) for line in [*project["dependencies"], *lines]})


def _name(requirement: str) -> str:
    found = re.match(r"[A-Za-z0-9._-]+", requirement)
    assert found is not None
    return re.sub(r"[-_.]+", "-", found[0]).lower()


def licence(name: str) -> str:
    """Return the licence of a distribution: its expression, its classifiers, or the first line of its text."""
    about = metadata.metadata(name).json
    if about.get("license_expression"):
        return str(about["license_expression"])
    classifiers = [line.rpartition(" :: ")[2] for line in about.get("classifier", []) if line.startswith("License")]
    return ", ".join(classifiers) or str(about.get("license", "not stated")).splitlines()[0]


def needed(names: list[str]) -> list[str]:
    """Return the names and all their direct and indirect dependencies that are installed."""
    found: set[str] = set()
    waiting = list(names)
    while waiting:
        name = waiting.pop()
        if name in found:
            continue
        try:
            requires = metadata.requires(name) or []
        except metadata.PackageNotFoundError:
            continue  # not installed: for another system or an older Python
        found.add(name)
        waiting += [_name(line) for line in requires if "extra ==" not in line]
    return sorted(found)


def main() -> int:
    command.parser(__name__, __doc__).parse_args()
    direct = runtime()
    if missing := sorted(set(direct) - set(needed(direct))):
        raise UsageError(f"{', '.join(missing)}: not installed, so the licence is unknown; pip install each of them")
    rows = {name: {"licence": licence(name), "direct": name in direct} for name in needed(direct)}
    settings.write_text(FILE, json.dumps(rows, indent=1, sort_keys=True) + "\n")
    strange = [name for name, row in rows.items() if not COMPATIBLE.search(str(row["licence"]))]
    for name in strange:
        print(f"{name}: {rows[name]['licence']}: check if this licence is compatible")
    return int(bool(strange))
