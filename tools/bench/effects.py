"""One instance of every effect of the catalogue, for the tools that measure what it costs."""

from __future__ import annotations

from typing import Any

from tsa_ctrl.model.catalogue import CATALOGUE

EFFECTS: dict[str, dict[str, Any]] = {name: dict(spec.shown.parameters) for name, spec in CATALOGUE.items()}
EFFECTS["presliding_hysteresis"]["elements"] = 8  # as many as the diagnosis tries: the heaviest
STACK = {name: values for name, values in EFFECTS.items() if not CATALOGUE[name].excludes}  # all that go together
