"""What an axis has to say to people: at the start what this rig cannot have, later what was cut, or contradicts."""

from __future__ import annotations

import math
from collections.abc import Sequence

from tsa_ctrl.bus.canopen.cia402 import INTERNAL_LIMIT, WARNING
from tsa_ctrl.control.axis import ControlAxis
from tsa_ctrl.control.estimator import EstimateState
from tsa_ctrl.daemon.events import Events

LESS, AS_SAID = 0.93, 0.97  # of the model file's half loop: told below the one, told again only after the other
AGAIN = 10.0  # s between two remarks of one kind on one axis; the log has the reason of every cycle
BITS = (  # of the statusword, that stop nothing
    (WARNING, "warns (bit 7 of statusword {:#06x}): temperature or voltage; its display, or 0x603F, says what"),
    (
        INTERNAL_LIMIT,
        "is at a limit of its own (bit 11 of statusword {:#06x}): it may give less than it is told; its current limit, "
        "temperature, and 0x6072 and 0x6080",
    ),
)


class Remarks:
    """Turns it into events."""

    def __init__(self, axes: Sequence[ControlAxis], events: Events) -> None:
        self._axes = axes
        self._events = events
        self._cut = [0] * len(axes)
        self._said = [-AGAIN] * len(axes)
        self._slack = [False] * len(axes)
        self._contradicted = [False] * len(axes)
        self._less = [False] * len(axes)
        self._why = [""] * len(axes)
        self._bits = [0] * len(axes)  # that are set
        self._confirmed = [True] * len(axes)
        self._repeated = [0] * len(axes)  # PDOs that came twice in a cycle
        self._repeated_at = [-AGAIN] * len(axes)  # s
        self._shown = [dict.fromkeys((bit for bit, _ in BITS), -AGAIN) for _ in axes]  # s, when each was told

    def begin(self) -> None:
        """Before the first cycle."""
        for axis in self._axes:
            for note in (*axis.law.notes, *axis.compensation_limit.bound.notes):
                self._events.add(0.0, axis.name, note)
            if axis.joint_torque.why_not:
                self._events.add(0.0, axis.name, axis.joint_torque.why_not)

    def update(self, t: float) -> None:
        """Now and then; `t` in s of the log."""
        for index, axis in enumerate(self._axes):
            law = axis.law
            if law.cut > self._cut[index] and t - self._said[index] >= AGAIN:
                self._said[index] = t
                self._cut[index] = law.cut
                self._events.add(
                    t,
                    axis.name,
                    f"the set-point requires a motor torque outside {_range(law.domain)}, where one tendon goes slack; "
                    "the torque is limited to this range (DOMAIN); lower the set-point or raise the pretension",
                )
            known = axis.joint_torque
            if known.contradicted is not self._contradicted[index]:
                self._contradicted[index] = known.contradicted
                self._events.add(t, axis.name, _contradiction(known.contradicted, known.difference))
            estimator = axis.estimator
            if bool(estimator.why) is not bool(self._why[index]):
                if estimator.why:
                    self._events.add(t, axis.name, f"friction and pretension are not estimated: {estimator.why}")
                elif estimator.state is EstimateState.ESTIMATED:  # else it was reset, by a disable
                    self._events.add(t, axis.name, "friction and pretension are estimated again")
                self._why[index] = estimator.why
            found = estimator.found if estimator.use else math.nan
            if found < LESS and not self._less[index]:
                self._less[index] = True
                self._events.add(
                    t,
                    axis.name,
                    f"friction and pretension together are about {100.0 * found:.0f} % of what the model file says, by "
                    "the estimate that is in use: no more is compensated; a tensioner that gave way, a straighter or "
                    "smoother sheath: mend that, or calibrate anew",
                )
            elif found > AS_SAID:
                self._less[index] = False
            if law.near_slack is not self._slack[index]:
                self._slack[index] = law.near_slack
                state = "near slack" if law.near_slack else "no longer near slack"
                self._events.add(
                    t,
                    axis.name,
                    f"pretension {law.pretension:.3g} N at the present wrap angle: the tendons are {state}; the motor "
                    f"torque is limited to {_range(law.domain)}",
                )
            self._look_at_bits(t, index, axis)
            stretch = known.stretch
            if stretch is not None and stretch.confirmation.confirmed is not self._confirmed[index]:
                self._confirmed[index] = stretch.confirmation.confirmed
                if not stretch.confirmation.confirmed:
                    self._events.add(
                        t,
                        axis.name,
                        "the tendon elongation is not as the reported motor torque predicts: friction or stiffness has "
                        "changed, or the motor gives another torque than it reports; the band of tau_j_stretch no "
                        "longer uses the reported torque alone",
                    )
            repeated = axis.image.repeated
            if repeated != self._repeated[index] and t - self._repeated_at[index] >= AGAIN:
                nodes = ", ".join(f"{node} {node.repeated}" for node in axis.image.nodes if node.repeated)
                self._repeated[index], self._repeated_at[index] = repeated, t
                self._events.add(
                    t,
                    axis.name,
                    f"PDOs came more than once in a cycle (since the start: {nodes}); the first of each is used. "
                    "Another node may have the same id, or an error on the bus repeats frames",
                )

    def _look_at_bits(self, t: float, index: int, axis: ControlAxis) -> None:
        """What the drive says beside its state, when it begins."""
        word, before, shown = axis.image.statusword, self._bits[index], self._shown[index]
        self._bits[index] = word
        for bit, words in BITS:
            if word & bit and not before & bit and t - shown[bit] >= AGAIN:
                shown[bit] = t
                self._events.add(t, axis.name, f"{axis.image.nodes[0]} {words.format(word)}")


def _range(domain: tuple[float, float]) -> str:
    return f"{domain[0]:.3g} to {domain[1]:.3g} N*m"


def _contradiction(there: bool, difference: float) -> str:
    if not there:
        return "the joint torque sensor agrees with the tendons' stretch again"
    return (
        f"the joint torque sensor differs from the tendons' stretch, {1e3 * difference:+.0f} mN*m in the mean, beyond "
        "the band most of the time: check the sensor's gain and zero, or identify stiffness and bending (tsa calibrate)"
    )
