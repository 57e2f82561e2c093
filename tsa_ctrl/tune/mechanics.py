"""Measure the motor's oscillation on the tendons and derive the keys of [axis.law] from it.

    motor_inertia, delay, ringing    measured (`swing`, `delay`)
    turn, lead, damping              by `control.law_design`; damping holds at the upper end of the delay's interval
    compensation                     lower end of the friction torque's interval, so friction is not overcompensated
    feedback                         `FEEDBACK`, on an axis with a joint torque sensor

The damping gain keeps a gain margin of 2 at that delay for stiffnesses of 0.8 to 1.25 times the measured one. If no
useful gain satisfies this, damping is set to 0, and the file and the report state the reason.
"""

from __future__ import annotations

import dataclasses
import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import tomlkit

from tsa_ctrl.config import AxisSettings, Configuration, plan_for
from tsa_ctrl.control.law_design import Plan
from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.quantity import Quantity, rounded
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.signals import zero_phase_derivative
from tsa_ctrl.model.steady_sliding import motor_stiffness, sliding, sliding_stiffness
from tsa_ctrl.tune.delay import Delay, command_delay
from tsa_ctrl.tune.estimate import Estimate
from tsa_ctrl.tune.swing import Swing, swing

# The keys of [axis.law] that a tuning may change in the controller file. All but `feedback` follow from measurements.
MOTOR = ("motor_inertia", "delay", "ringing", "turn", "lead", "damping")  # describe and damp the motor
FEEDBACK_KEY = "feedback"
TUNED = (*MOTOR, "compensation", FEEDBACK_KEY)
MARK = "tsa tune: "  # start of the comment after each written key


@dataclass(frozen=True)
class Key:
    """A value of [axis.law] and the comment on the same line."""

    value: float
    comment: str


def with_law(text: str, axis: str, keys: Mapping[str, Key]) -> str:
    """Return the file's text with these keys in the axis' [axis.law], each with its comment.

    All other values and the layout of the file stay the same.

    Raises:
        UsageError: The layout of the file prevents the change.
    """
    document: Any = tomlkit.parse(text)
    table = next(table for table in document["axis"] if table["name"] == axis)
    if "law" not in table:
        table["law"] = tomlkit.table()
    law = table["law"]
    for name, key in keys.items():
        law[name] = key.value
        if not isinstance(law, tomlkit.items.InlineTable):
            law[name].comment(MARK + key.comment)
    new: str = tomlkit.dumps(document)
    wanted = tomllib.loads(text)
    chosen = next(table for table in wanted["axis"] if table["name"] == axis)
    chosen["law"] = {**chosen.get("law", {}), **{name: key.value for name, key in keys.items()}}
    try:
        same = tomllib.loads(new) == wanted
    except tomllib.TOMLDecodeError:
        same = False
    if not same:
        lines = ", ".join(f"{name} = {key.value:g}" for name, key in keys.items())
        raise UsageError(f"axis '{axis}': {lines} cannot be inserted into this layout; write it into [axis.law]")
    return new


def moved(text: str, axis: str, model: str, folder: Path) -> str:
    """Return the file's text for use in another folder.

    The axis' model becomes `model`. The relative paths of other models, drive profiles and set-point files are resolved
    from `folder`.
    """
    document: Any = tomlkit.parse(text)
    for table in document["axis"]:
        table["model"] = model if table["name"] == axis else str((folder / table["model"]).resolve())
        profile, setpoint = str(table["drive"].get("profile", "")), table.get("setpoint", {})
        if profile.endswith(".toml"):
            table["drive"]["profile"] = str((folder / profile).resolve())
        if "file" in setpoint:
            setpoint["file"] = str((folder / setpoint["file"]).resolve())
    return str(tomlkit.dumps(document))


def differ_in_law_alone(old: str, new: str, axis: str) -> bool:
    """Return True if the tuned keys of [axis.law] are the only difference between `old` and `new`."""
    document: Any = tomlkit.parse(new)
    law: Any = next((table.get("law", {}) for table in document.get("axis", []) if table.get("name") == axis), {})
    keys = {}
    for name in law:  # in the order in which they were added
        if name in TUNED:
            comment = law[name].trivia.comment.removeprefix("#").strip()
            if comment.startswith(MARK) or isinstance(law, tomlkit.items.InlineTable):
                keys[name] = Key(float(law[name]), comment.removeprefix(MARK))
    return bool(keys) and with_law(old, axis, keys) == new


NEEDED = frozenset(("tau_m_cmd", "tau_m", "q_m", "omega_m", "q_j", "omega_j"))
LEAST_MARGIN = 2.0
DIGITS = 3  # significant digits of derived values
MOST_COMPENSATION = 0.98  # upper limit for any interval: friction may drop by 2 % before a guard detects it
LEAST_COMPENSATION = 0.8  # below this, the friction interval is too wide to use
# Hz, bandwidth of the torque sensor's correction: above the 1 Hz of a gait, and a tenth of the ringing of heavy motors.
# On random rigs 3 and 6 Hz have nearly the same error.
FEEDBACK = 3.0
STIFFEST = 10.0  # largest plausible ratio of measured and model stiffness, and of its inverse


@dataclass(frozen=True)
class Mechanics:
    """The results of the shake phase. A result that was not measured is None, and `notes` have the reason."""

    delay: Delay | None
    swing: Swing | None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class LawTuning:
    """The derived keys of [axis.law] and the measurements behind them.

    Attributes:
        keys: values and comments by key.
        quantities: measurements with their intervals.
        margin: gain margin of the damping; None without damping.
        notes: notes for the report.
    """

    keys: Mapping[str, Key]
    quantities: Mapping[str, Quantity]
    margin: float | None
    notes: tuple[str, ...] = ()

    @property
    def values(self) -> dict[str, float]:
        return {name: key.value for name, key in self.keys.items()}


def measured(logs: Sequence[Dataset], model: TendonSheath) -> Mechanics:
    """Measure delay, motor inertia and stiffness from logs of a motor that was shaken while the joint moved."""
    missing = sorted({name for name in NEEDED for log in logs if name not in log})
    if missing:
        note = f"the log has no {', '.join(missing)}: delay and motor inertia are not measured"
        return Mechanics(None, None, (note,))
    delay = command_delay(logs)
    if delay is None:
        note = "the drive's reported torque does not follow the command: delay and motor inertia are not measured"
        return Mechanics(None, None, (note,))
    radii = model.motor_pulley_radius, model.joint_pulley_radius
    found = swing(logs, radii, motor_stiffness(model), delay)
    if found is None:
        note = (
            "the joint slides too little compared with the motor's oscillation: motor inertia and stiffness are "
            "not measured, and the oscillation is not damped unless [axis.law] has motor_inertia; "
            "move the joint farther and faster"
        )
        return Mechanics(delay, None, (note,))
    return Mechanics(delay, found)


def pulling(log: Dataset, inertia: float) -> Dataset:
    """Return the log with the torque that reaches the tendons: tau_m minus the motor's acceleration torque.

    `inertia` is the motor inertia, kg*m^2.
    """
    carrying = inertia * zero_phase_derivative(log["omega_m"], log.period)
    return dataclasses.replace(log, columns={**log.columns, "tau_m": log["tau_m"] - carrying})


def stiffened(model: TendonSheath, found: Swing) -> tuple[TendonSheath, Quantity] | None:
    """Return the model with the measured tendon stiffness, and E A (N) with its interval.

    The stiffness of a series spring is scaled by the same factor. The result is None if the factor exceeds `STIFFEST`.
    """
    factor = found.stiffness.value / sliding_stiffness(model)
    if not 1.0 / STIFFEST < factor < STIFFEST:
        return None
    axial, share = factor * model.axial_stiffness, found.stiffness.high / found.stiffness.value - 1.0
    quantity = Quantity(axial, axial * (1.0 - share), axial * (1.0 + share), "N")
    series = None if model.series_stiffness is None else rounded(factor * model.series_stiffness, share)
    return dataclasses.replace(model, axial_stiffness=rounded(axial, share), series_stiffness=series), quantity


def law_tuning(
    configuration: Configuration, axis: AxisSettings, learned: Estimate, found: Mechanics
) -> LawTuning | None:
    """Return the keys of [axis.law] for an estimate, or None if the delay was not measured."""
    model = learned.model
    if found.delay is None:
        return None
    delay, swing = found.delay.delay, found.swing
    known: dict[str, Quantity] = {"delay": delay}
    if swing is not None:
        known |= {"motor_inertia": swing.inertia, "ringing": swing.ringing}
    keys = {
        name: Key(rounded(q.value, q.share), f"measured, {q.low:.3g} to {q.high:.3g} {q.unit}")
        for name, q in known.items()
    }
    if axis.has_torque_sensor and not axis.law.feedback > 0.0:
        keys[FEEDBACK_KEY] = Key(FEEDBACK, "Hz, the joint torque sensor corrects the friction term")
    if swing is None:
        return LawTuning(keys, known, None, found.notes)
    anew = {**dict.fromkeys(MOTOR), **{name: key.value for name, key in keys.items()}}
    law = msgspec.structs.replace(axis.law, **anew)
    keys |= _compensation(axis, learned)

    def planned(**changes: float) -> Plan:
        changed = msgspec.structs.replace(axis, law=msgspec.structs.replace(law, **changes))
        return plan_for(f"axis '{axis.name}'", changed, model, configuration.file)

    late = delay.high + max(0.0, swing.late)
    plan, worst = planned(), planned(delay=late)
    keys["turn"] = Key(_floored(plan.turn), "s, duration of a reversal by the limits of the drive")
    keys["lead"] = Key(_floored(plan.lead), "s, half of turn plus delay")
    notes = list(found.notes)
    gain = _floored(min(plan.damping, worst.damping))
    if gain > 0.0:
        try:
            margin = min(planned(damping=gain).margin, planned(damping=gain, delay=late).margin)
        except UsageError:
            gain = 0.0
    if gain > 0.0:
        keys["damping"] = Key(gain, f"gain margin {margin:.2g} at {1e3 * late:.2g} ms")
        notes.append(
            f"damping of the motor's oscillation: {gain:.3g} N*m*s/rad, gain margin {margin:.2g} at a delay of "
            f"{1e3 * late:.2g} ms and a ringing of {swing.ringing.value:.3g} Hz"
        )
        return LawTuning(keys, known, margin, tuple(notes))
    keys["damping"] = Key(0.0, f"none: no gain margin of {LEAST_MARGIN:g} at {1e3 * late:.2g} ms")
    notes.append(
        f"a delay of {1e3 * late:.2g} ms leaves no gain margin of {LEAST_MARGIN:g} at a ringing of "
        f"{swing.ringing.value:.3g} Hz: the motor's oscillation is not damped"
    )
    return LawTuning(keys, known, None, tuple(notes))


def bearable(compensation: float, given: TendonSheath, learned: Estimate) -> tuple[float, str | None]:
    """Return the permitted share of the given file's friction term, and the reason if it is below `compensation`.

    The condition is c h_given <= h, where h is the friction torque at the lower end of its measured interval. A file
    with more friction than the rig has would drive the joint without a set-point and fail its verification run.
    """
    loop, new = learned.calibration.half_loop_torque, sliding(learned.model)
    least = abs(new.motor_half_loop) * min(1.0, max(0.0, loop.low / loop.value))
    said = abs(sliding(given).motor_half_loop)
    if not compensation * said > least:
        return compensation, None
    share = _floored(least / said)
    return share, (
        f"the given file has {said:.3g} N*m of friction at the motor, the rig at least {least:.3g} N*m: so that "
        f"the joint does not move by itself, the file was tested with {100.0 * share:.3g} % of its friction term, not "
        f"{100.0 * compensation:.3g} %"
    )


def _compensation(axis: AxisSettings, learned: Estimate) -> dict[str, Key]:
    """Return the compensation that the lower end of the friction torque's interval permits.

    The result is empty if the interval is too wide or the file's compensation is 0.
    """
    loop, given = learned.calibration.half_loop_torque, axis.law.compensation
    share = _floored(min(MOST_COMPENSATION, loop.low / loop.value))
    if not share >= LEAST_COMPENSATION or given == 0.0:
        return {}
    return {"compensation": Key(share, f"friction torque at least {100.0 * share:.3g} % of the model's")}


def _floored(value: float) -> float:
    """Round down to `DIGITS` significant digits. Return 0 for a value that is not positive."""
    if value <= 0.0:
        return 0.0
    step = 10.0 ** (math.floor(math.log10(value)) - DIGITS + 1)
    return float(f"{math.floor(value / step + 1e-9) * step:.{DIGITS}g}")
