"""What a drive itself makes of signs and positions (0x607E, 0x608F, 0x6091, 0x6092), against the configuration.

Another tool may have turned them since the configuration was measured; a sign that is wrong pushes where it should give
way. Only what a drive has is compared, and nothing is changed here: `polarity` in [axis.drive] has 0x607E written.
"""

from __future__ import annotations

from fractions import Fraction

from tsa_ctrl.bus.canopen import objects
from tsa_ctrl.bus.canopen.objects import Object
from tsa_ctrl.bus.drive.checks import Node
from tsa_ctrl.bus.drive.session import Session
from tsa_ctrl.errors import UsageError

_TURNED = ((0x80, "position"), (0x40, "velocity"), (0x20, "torque"))  # bits of 0x607E


def check_signs(session: Session, node: Node) -> None:
    """Raises UsageError where a drive's polarity, or what it counts per revolution, is not what was configured."""
    _check_polarity(session, node)
    _check_counts(session, node)


def _check_polarity(session: Session, node: Node) -> None:
    written = any(extra.index == objects.POLARITY.index for extra in node.profile.extra)
    if written or node.axis.drive.polarity is not None:
        return
    found = _look(session, node, objects.POLARITY)
    turned = [name for bit, name in _TURNED if found is not None and found & bit]
    if turned:
        raise UsageError(
            f"{node.name}: polarity (0x607E) is 0x{found:02X}, the drive turns the sign of {' and '.join(turned)}; "
            f"write polarity = 0x{found:02X} in [axis.drive], if torque_sign and position_sign were found with that, "
            "or polarity = 0 to have it written, and find the signs anew"
        )


def _check_counts(session: Session, node: Node) -> None:
    """Positions are increments of the encoder, or units of a feed constant behind the drive's own gear."""
    increments = _share(session, node, objects.ENCODER_INCREMENTS, objects.ENCODER_REVOLUTIONS)
    gear = _share(session, node, objects.GEAR_MOTOR, objects.GEAR_SHAFT) or Fraction(1)
    feed = _share(session, node, objects.FEED, objects.FEED_SHAFT)
    wanted = node.axis.drive.counts_per_revolution
    if gear != 1 and (feed is None or feed / gear != wanted):
        raise UsageError(
            f"{node.name}: its gear ratio (0x6091) is {gear}, so what a position of it means is not known; set it to 1 "
            f'with the maker\'s tool, or write absent = ["{objects.GEAR_MOTOR.name}"] in {node.profile_file}, if it '
            "leaves 0x6064 and 0x6071 as the motor's, and be sure of counts_per_revolution in [axis.drive]"
        )
    known = [float(value) for value in (increments, None if feed is None else feed / gear) if value is not None]
    if known and wanted not in known:
        shown = " or ".join(f"{value:g}" for value in dict.fromkeys(known))
        raise UsageError(
            f"{node.name}: it counts {shown} in a revolution of the motor (0x608F, 0x6092), the configuration says "
            f'{wanted}; correct counts_per_revolution in [axis.drive], or write absent = ["'
            f'{objects.ENCODER_INCREMENTS.name}", "{objects.FEED.name}"] in {node.profile_file}, if its 0x6064 counts '
            "otherwise"
        )


def _share(session: Session, node: Node, first: Object, second: Object) -> Fraction | None:
    """One object by the other; None where the drive does not have both, or says nothing by them."""
    above, below = _look(session, node, first), _look(session, node, second)
    return Fraction(above, below) if above and below else None


def _look(session: Session, node: Node, entry: Object) -> int | None:
    return node.look(session, entry) if node.profile.has(entry) else None
