"""What stands at the head of a log: where it came from and what its codes mean."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass, field

from tsa_ctrl.version import __version__


@dataclass(frozen=True)
class LogHeader:
    """What stands at the head of a log.

    `files` maps the name of each configuration or model file to its text, `codes` the name of a coded field to
    {code: name}; `started` is the time of t = 0 in s since 1970; `rate` in Hz.
    """

    axes: tuple[str, ...]
    rate: float
    files: dict[str, str] = field(default_factory=dict)
    codes: dict[str, dict[int, str]] = field(default_factory=dict)
    started: float = field(default_factory=time.time)
    version: str = __version__

    def to_json(self) -> str:
        return json.dumps({**vars(self), "axes": list(self.axes)})

    @staticmethod
    def from_json(text: str) -> LogHeader:
        data = json.loads(text)
        data["axes"] = tuple(data["axes"])
        data["codes"] = {key: {int(code): name for code, name in names.items()} for key, names in data["codes"].items()}
        return LogHeader(**data)
