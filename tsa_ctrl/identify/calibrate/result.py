"""Hold the result of a calibration: identified combinations, parameters, and the measurements still required."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from tsa_ctrl.display import Displayed, bars
from tsa_ctrl.identify.quantity import Quantity, rounded
from tsa_ctrl.identify.three_errors import ThreeErrors
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.steady_sliding import sliding
from tsa_ctrl.outputs import json_types

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Share by which the mean square of a held-out error may increase by chance: two parameters from about 18 independent
# blocks (`regression.BLOCKS`), compared with a file that may have been fitted to the held-out logs as well.
BY_CHANCE = 2.0 / 18.0
UNEXPLAINED = 0.5  # of the model's friction torque: with a larger error while sliding, the model describes no friction
ROUNDING = 1e-4  # share of the error on the fitted data: smaller differences are rounding


@dataclass(frozen=True, repr=False)
class Calibration(Displayed):
    """Result of `calibrate`.

    `slope` (1) is d tau_J / d tau_M. `half_loop_torque` (N*m) is the friction torque, half the distance between the two
    branches. Both are at the model's own bending angle and pretension: r_J/r_M cosh x and 2 T_p r_J sinh x for the
    simplified model. `split` is True if the data separate the product into x and T_p. Otherwise `friction_angle` and
    `pretension` keep the nominal file's proportion, and their intervals are the ranges that [uncertainty] and the
    friction torque permit. `by_slope` is True if the slope of one configuration separated them.

    `routing`: gains of other joints by "gain.JOINT" (rad/rad; "gain_a.JOINT", "gain_b.JOINT" where the tendons differ)
    and "pretension_per_wrap_angle" (N/rad); empty where no other joint bends the sheath.

    RMS errors are in N*m. `rms_before` (nominal model) and `rms_after` (fitted to the other data) are on held-out data.
    `rms_given` (nominal model) and `rms_written` (`model`, which is written to the file) are on all data, to which
    `model` was fitted. `sliding_before` to `sliding_written` are the same errors where the joint certainly slides; they
    decide whether a model is better or worse. `errors` are those of `model` on all samples, including reversals and
    standstill, as `simulate` reports them.
    """

    friction_angle: Quantity
    pretension: Quantity
    slope: Quantity
    half_loop_torque: Quantity
    split: bool
    condition_number: float
    admitted_seconds: float
    refused: tuple[str, ...]
    rms_before: float
    rms_after: float
    rms_given: float
    rms_written: float
    experiment: str
    notes: tuple[str, ...]
    model: TendonSheath
    errors: ThreeErrors = field(default_factory=ThreeErrors)
    routing: Mapping[str, Quantity] = field(default_factory=dict)
    by_slope: bool = False
    sliding_before: float = math.nan
    sliding_after: float = math.nan
    sliding_given: float = math.nan
    sliding_written: float = math.nan

    @property
    def better(self) -> bool:
        """Return True if the calibrated model has the smaller error while sliding on held-out data."""
        return self.sliding_after < self.sliding_before

    @property
    def worse(self) -> str:
        """Return a text on the data where the sliding error exceeds the given model's; empty if there are none."""
        found = []
        if self.sliding_written > (1.0 + ROUNDING) * self.sliding_given:
            found.append(f"{self.sliding_given:.4g} -> {self.sliding_written:.4g} N·m on these logs")
        if self.sliding_after > math.sqrt(1.0 + BY_CHANCE) * self.sliding_before:
            found.append(f"{self.sliding_before:.4g} -> {self.sliding_after:.4g} N·m on held-out data")
        return " and ".join(found)

    @property
    def objection(self) -> str:
        """Return why the model must not be written unasked, with the remedy; empty if it may be written."""
        if self.worse:
            return (
                f"the error while sliding is larger than with the given model ({self.worse}): an effect is missing, "
                "which tsa diagnose identifies"
            )
        friction = abs(sliding(self.model).half_loop)
        if self.sliding_written > UNEXPLAINED * friction:
            return (
                f"the error while sliding is {self.sliding_written:.3g} N·m, and the model's friction torque is "
                f"{friction:.3g} N·m; allowed is half of it: check that all columns belong to one run, their units, "
                "delays and zeros; tsa diagnose compares them"
            )
        return ""

    @property
    def quantities(self) -> dict[str, Quantity]:
        """Return the estimated quantities by their public names."""
        names = ("friction_angle", "pretension", "half_loop_torque", "slope")
        return {**{name: getattr(self, name) for name in names}, **self.routing}

    def facts(self) -> dict[str, str]:
        """Return the estimates with their intervals, and the error on held-out data before and after."""
        found = {name.replace("_", " "): str(quantity) for name, quantity in self.quantities.items()}
        return {**found, "held-out error": f"{self.rms_before:.4g} -> {self.rms_after:.4g} N·m"}

    def plot(self) -> Figure:
        """Return a picture of the RMS errors before and after the calibration."""
        errors = {
            "nominal, held-out data": self.rms_before,
            "calibrated, held-out data": self.rms_after,
            "nominal, all data": self.rms_given,
            "calibrated, all data": self.rms_written,
        }
        return bars(errors, "RMS error (N·m)", f"Friction torque {self.half_loop_torque}")

    def written(self, model: TendonSheath) -> TendonSheath:
        """Return the model with friction coefficient and pretension rounded to the digits that the intervals justify.

        The narrowest interval of all estimated quantities determines the number of digits.
        """
        share = min(found.share for found in self.quantities.values() if found.share >= 0.0)
        return replace(
            model,
            friction_coefficient=rounded(model.friction_coefficient, share),
            pretension=rounded(model.pretension, share),
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the public JSON object of `tsa calibrate --json`."""
        found: dict[str, Any] = json_types(
            {
                "schema": 1,
                "parameters": {name: getattr(self, name) for name in ("friction_angle", "pretension")},
                "combinations": {name: getattr(self, name) for name in ("slope", "half_loop_torque")},
                **({"routing": dict(self.routing)} if self.routing else {}),
                **{name: getattr(self, name) for name in ("split", "condition_number", "admitted_seconds", "refused")},
                "rms": {"before": self.rms_before, "after": self.rms_after, "held_out": True, "unit": "N*m"},
                "rms_in_sample": {"before": self.rms_given, "after": self.rms_written, "unit": "N*m"},
                "errors": self.errors.to_dict(),
                "worse_than_given": bool(self.worse),
                "experiment": self.experiment,
                "notes": self.notes,
            }
        )
        return found

    def to_json(self) -> str:
        return json.dumps(self.to_dict(), allow_nan=False)
