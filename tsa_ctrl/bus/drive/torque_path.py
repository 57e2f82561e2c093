"""Read the limits, ramps and scales that a drive applies between the torque command and the motor."""

from __future__ import annotations

from collections.abc import Collection

from tsa_ctrl.bus.canopen.cia402 import TORQUE_PATH, Effect, Influence
from tsa_ctrl.bus.drive.checks import Node
from tsa_ctrl.bus.drive.report import Row
from tsa_ctrl.bus.drive.scale import PER_MILLE, drive_scale
from tsa_ctrl.bus.drive.session import SdoRefusedError, Session

_SLOW_RAMP = 0.1  # s from zero to max_torque; a faster ramp is over before the joint has moved


def check_torque_path(
    session: Session, node: Node, written: Collection[tuple[int, int]]
) -> tuple[list[Row], list[str]]:
    """Read the objects of the torque path that the plan does not write.

    Args:
        session: an open session; nothing is written.
        node: the drive.
        written: keys of the objects that the plan writes; they are left out.

    Returns:
        Rows of the objects to watch while the loop runs, and a note for each object that limits or ramps the torque.
    """
    rows, notes = [], []
    for influence in TORQUE_PATH:
        entry = influence.entry.of(node.axis.drive.slot)
        if entry.key in written or not node.profile.has(entry):
            continue
        try:
            found = session.read_if_there(node.node_id, entry)
        except SdoRefusedError:
            notes.append(f"{entry} cannot be read, so its effect on the torque is not known")
            continue
        if found is None:
            continue
        if influence.watched:
            rows.append(Row(entry, found, found))
        effect = _effect(influence, found, node)
        if effect:
            notes.append(f"{entry.name} (0x{entry.index:04X}) is {found} {influence.unit}: {effect}")
    return rows, notes


def _effect(influence: Influence, found: int, node: Node) -> str:
    """Return the effect of a value on the torque, or an empty text if it has none."""
    drive = node.axis.drive
    most = drive_scale(drive, node.profile, f"axis '{node.axis.name}'").max_torque_digits
    rated = drive.rated_torque * drive.gear_ratio / PER_MILLE
    if influence.effect is Effect.LIMITS and found < most:
        return (
            f"the drive delivers no more than {found * rated:.3g} N*m, and max_torque in [axis.drive] is "
            f"{most * rated:.3g} N*m; raise the limit with the maker's tool, or lower max_torque"
        )
    if influence.effect is Effect.RAMPS and influence.unit and 0 < found * _SLOW_RAMP < most:
        return (
            f"{most / found:.3g} s from zero to max_torque; CiA 402 applies it in the profile torque mode only, but "
            "some drives also apply it in cyclic torque; raise it with the maker's tool if the torque lags"
        )
    return ""
