"""Process logs offline: datasets, simulation, calibration and diagnosis.

Example:

    from tsa_ctrl.identify import diagnose
    result = diagnose([{"t": t, "tau_m": ..., "tau_j": ..., "omega_j": ...}], load_model("actuator.toml"))
    print(result.verdict, result.sentence)
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tsa_ctrl.identify.diagnosis import Diagnosis, diagnose

__all__ = ["Diagnosis", "diagnose"]


def __getattr__(name: str) -> Any:
    """Load the diagnosis on first use, because `tsa simulate` and `tsa calibrate` do not need it."""
    if name in __all__:
        from tsa_ctrl.identify import diagnosis

        return getattr(diagnosis, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
