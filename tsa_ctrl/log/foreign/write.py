"""The files of an import: canonical CSV, the mapping that was understood, a model-file skeleton and a picture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl import outputs, settings
from tsa_ctrl.display import TIME, axis_label
from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.convert import write_columns
from tsa_ctrl.log.foreign.mapping import Mapped, dump_map
from tsa_ctrl.log.foreign.text import ForeignTable
from tsa_ctrl.signals import COLUMNS

POINTS = 4000  # drawn per curve
Columns = Mapping[str, NDArray[np.float64]]

RIGID = """# A plain drive: tau_M = J domega/dt + tau_c sign(omega) + b omega + c. A key behind # may be a cause.
[actuator]
kind = "rigid_drive"
coulomb_friction = {coulomb:.3g}{pad}# N*m: half of the torque's usual size in this log; your best guess instead
# inertia = 1e-4                 # kg*m^2
# viscous_friction = 0.0         # N*m*s/rad
# torque_offset = 0.0            # N*m
"""
GEARED = """# A drive with a gear and a joint torque sensor, without tendons:
# tau_J = eta^s N tau_M - tau_c sigma - b omega_J, s = +1 where the motor drives, -1 where it is driven.
[actuator]
kind = "geared_drive"
ratio = 1.0                      # N, motor turns per joint turn: put in yours
efficiency = 0.9                 # eta, 1
coulomb_friction = {coulomb:.3g}{pad}# tau_c, N*m: a twentieth of the torque's usual size in this log; your best guess
viscous_friction = 0.0           # b, N*m*s/rad
"""


@dataclass(frozen=True)
class Imported:
    """The written files by their kind."""

    log: Path
    mapping: Path
    model: Path | None  # None: there was one
    picture: Path


def take(table: ForeignTable, mapped: list[Mapped]) -> dict[str, NDArray[np.float64]]:
    """The columns in SI, time from 0 at the first row.

    Raises UsageError with the line of a value that is not a number.
    """
    columns = {column.name: column.values(table) for column in sorted(mapped, key=lambda column: column.name != "t")}
    t = columns["t"]
    good = np.isfinite(t)
    if good.any():
        columns["t"] = t - t[good][0]
    return columns


def write(
    folder: Path,
    table: ForeignTable,
    mapped: list[Mapped],
    columns: Columns,
    skeleton: Path,
    stem: str,
    kind: str = "",
) -> Imported:
    """Write all of it to `folder`. Raises UsageError.

    `skeleton` is the commented model file of a tendon-sheath. `kind` of the model file; default: a tendon-sheath if
    the joint torque is there, else a plain drive.
    """
    log, mapping, model = folder / f"{stem}.csv", folder / f"{stem}-map.toml", folder / "model.toml"
    picture = folder / f"{stem}.png"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{folder}: cannot be made ({error.strerror}); choose another --out") from None
    for path in (log, mapping, picture):
        outputs.refuse_inputs(path, [table.path])
    write_columns(log, columns)
    outputs.keep(mapping)
    settings.write_text(mapping, dump_map(table, mapped))
    made = None
    if not model.exists():
        made = model
        settings.write_text(model, _skeleton(columns, skeleton, kind))
    _draw(picture, table, columns)
    return Imported(log, mapping, made, picture)


def _skeleton(columns: Columns, tendon_sheath: Path, kind: str) -> str:
    kind = kind or ("tendon_sheath" if "tau_j" in columns else "rigid_drive")
    if kind == "tendon_sheath":
        text = tendon_sheath.read_text(encoding="utf-8")
        return "# A SKELETON: replace the radii, the tendon and the sheath of the example by yours.\n" + text
    text, name, share = (GEARED, "tau_j", 0.05) if kind == "geared_drive" else (RIGID, "tau_m", 0.5)
    tau = columns.get(name, np.zeros(1))
    coulomb = share * float(np.nanmedian(np.abs(tau))) if tau.size else 0.0
    value = f"{coulomb:.3g}"
    return text.format(coulomb=coulomb, pad=" " * max(1, 33 - len(f"coulomb_friction = {value}")))


def _draw(path: Path, table: ForeignTable, columns: Columns) -> None:
    from matplotlib.figure import Figure

    names = [name for name in columns if name != "t"]
    figure = Figure(figsize=(9.0, 1.0 + 1.5 * len(names)), layout="constrained")
    step = max(1, len(columns["t"]) // POINTS)
    for i, name in enumerate(names, start=1):
        axes = figure.add_subplot(len(names), 1, i)
        axes.plot(columns["t"][::step], columns[name][::step], linewidth=0.8)
        axes.set_ylabel(axis_label(name, COLUMNS[name].unit).replace(" (", "\n("))
        axes.grid(alpha=0.3)
        if i == len(names):
            axes.set_xlabel(TIME)
    figure.suptitle(f"{table.path.name}: imported columns in SI units")
    with outputs.beside(path) as part:
        figure.savefig(part, dpi=110, format="png")
