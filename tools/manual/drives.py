"""Tables of drives that others wrote: the profiles that are shipped, and what the simulated drive can do otherwise."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator

from tools.campaign.drive.makes import makes
from tools.campaign.drive.variations import VARIATIONS
from tsa_ctrl.plant.identity import Quirks

_FIELD = re.compile(r"^    (?P<key>[a-z_]+): .+ = (?P<default>[^#]+?)  # (?P<words>.+)$")


def profiles() -> Iterator[tuple[str, ...]]:
    """File, sources, what they do not say, and what differs at power-on."""
    yield "profile", "sources", "not known", "`tsa drive diff` at power-on: objects that differ, of those compared"
    for make in makes():
        sources, unknown = make.profile.sources, make.profile.unknown
        yield f"`{make.name}`", "; ".join(sources), "; ".join(unknown) or "-", make.short


def quirks() -> Iterator[tuple[str, ...]]:
    """Key, default, words, and the variations of the matrix that have it."""
    yield "key of `[axis.drive]`", "default", "what the drive does", "tried as"
    for line in inspect.getsource(Quirks).splitlines():
        field = _FIELD.match(line)
        if field is not None:
            names = [variation.name for variation in VARIATIONS if field["key"] in variation.quirks]
            tried = "; ".join(names) if len(names) <= 3 else f"{names[0]}; {names[1]}; {len(names) - 2} more"
            yield f"`{field['key']}`", f"`{field['default']}`", field["words"], tried
