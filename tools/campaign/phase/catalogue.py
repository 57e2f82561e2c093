"""Define the faults of the campaign in virtual time, with the required reaction of the running loop."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Hazard:
    """A fault and its hazard to the wearer.

    Attributes:
        name: Name of the fault.
        hazard: Hazard to the wearer.
        cause: Regular expression that a latched fault must match. If it is empty, no fault is required.
        lines: Commands to the plant, as on its control socket.
        act: Key of `ACTS`, instead of commands.
        lie: True if the fault cannot be detected at once, so that the trial is judged by the effect on the joint.
        goes_on: Reason why the loop may continue.
        residual: Description of the residual risk.
        axes: Number of axes that the fault requires.
        released: True if the friction or pretension that holds the joint is lost, independently of the motor.
        stays: True if the fault is permanent.
        sticks: True if small differences decide whether the joint moves or sticks afterwards.
        open: Description of the known unsafe trials; empty if none are known.
    """

    name: str
    hazard: str
    cause: str = ""
    lines: tuple[str, ...] = ()
    act: str = ""
    lie: bool = False
    goes_on: str = ""
    residual: str = ""
    axes: int = 1
    released: bool = False
    stays: bool = False
    sticks: bool = False
    open: str = ""


NO_TORQUE = "torque ends without warning"
OLD = "torque from an old measurement"
OTHER = "torque other than commanded"
MOVES = "unintended joint motion"
NOBODY = "unsupervised torque"

_LOST = "stale PDO|heartbeat lost|node booted|emergency|drive fault|left operation|left the operational|obey|confirm"
_MASTER = "second master|node booted|left the operational|stale PDO|emergency|drive fault|left operation"
_APART = "moved apart|over-speed|joint torque sensor|drive reports|frozen"
_LIMP = "a limb falls by its weight; add a brake or springs"
_TORN = "a limb falls by its weight, or the other tendon pulls with its pretension; add an end stop"
_UNSEEN = "an error that no measurement shows is bounded by the limits alone; add a second sensor"
# Present limits of hazards that are unsafe in some trials, and additional measures. The table lists the number of these
# trials, the joints and the excess.
_LATE = (
    "the motor torque exceeds the limit from the first period on, and only the drive's current limit bounds it; the "
    "tendon elongation reveals it once the torque changes by a thirtieth of its limit; at a constant torque only a "
    "joint torque sensor reveals it; until then a weight or a free joint accelerates; set the current limit and "
    "over_speed, and add an end stop"
)
_SLACK = (
    "a slack tendon transmits no torque until it is wound up, and on a moving joint the elongation of a healthy tendon "
    "may be equally small, so it is not evaluated; add a spring or a switch at the tensioner, which detects it at once"
)
_BLIND = (
    "until the tendons have slid in both directions, the friction compensation may be too large by the uncertainty of "
    "the elongation; most of these joints have no joint torque sensor, which would let the guard reduce it; add a "
    "sensor or a counterweight"
)
_MORE = (
    "without a joint torque sensor, a motor with 40 % more torque cannot be distinguished from one with a "
    "different torque constant; add a sensor, or test with a weight on the joint during commissioning"
)
_FALLS = (
    "if the tendon tears while the torque reverses, a weight falls and the other tendon pulls in the same direction "
    "until over-speed ends the torque; add an end stop or a counterweight, and reduce [axis.limits] joint_speed"
)
_PULLED = (
    "the remaining tendon pulls a joint without a torque sensor by its pretension, slower than over-speed, and motor "
    "and joint move together; add a joint torque sensor or an end stop"
)
_DRIFT = (
    "a free joint that receives only a part of a sine's torque drifts, slower than over-speed; set [axis.limits] "
    "travel and add an end stop"
)
_LOOSE = (
    "a joint that friction held below its desired torque starts to move, because the friction term changes sign with "
    "the noise; use an encoder with less noise and set [axis.limits] travel"
)
_FURTHER = (
    "a free joint that turned while the drive recovered moved 0.37 rad further than without the fault; set "
    "[axis.limits] travel and add an end stop"
)
_LATER = (
    "the start is delayed, so a free joint turns further than without the fault, at the same speed and without added "
    "energy; set [axis.limits] travel"
)
_OLDER = (
    "a free joint received 0.12 J from an older command before the read-back showed it; reduce the RPDO time-out of "
    "the drive"
)
_LIMB = "a limb received 0.16 J within 3 s, while the share of the compensation was changed; add an end stop"

HAZARDS: tuple[Hazard, ...] = (
    # power
    Hazard("power cycle of all nodes", NO_TORQUE, _LOST, ("power_cycle duration=0.15",), residual=_LIMP),
    Hazard("brown-out, 20 ms", NO_TORQUE, _LOST, ("power_cycle duration=0.02",), residual=_LIMP),
    Hazard("drive fault", NO_TORQUE, "drive fault|emergency", ("fault",), residual=_LIMP),
    Hazard("drive fault that stays", NO_TORQUE, "drive fault|emergency", ("fault duration=0.3",), residual=_LIMP,
           open=_FURTHER),
    Hazard("safe torque off", NO_TORQUE, "left operation|does not enable|confirm", ("torque_off",), residual=_LIMP),
    Hazard(
        "safe torque off and back", NO_TORQUE, "left operation|does not enable", ("torque_off duration=0.05",),
        residual=_LIMP,
    ),
    Hazard("power stage without voltage", NO_TORQUE, "left operation|drive reports", ("dead_stage",), residual=_LIMP),
    Hazard("power stage that flaps", OTHER, "left operation|drive reports", ("flapping_stage",)),
    Hazard(
        "derating to a fifth", OTHER, lines=("derating",), goes_on="less torque, within the limits", sticks=True,
        open=_DRIFT,
    ),
    # words of the drive
    Hazard("EMCY without a fault", NO_TORQUE, "emergency", ("emcy",)),
    Hazard("EMCY of the encoder", NO_TORQUE, "emergency.*encoder", ("emcy node=encoder",)),
    Hazard("another mode", OTHER, "wrong mode|does not enable|confirms", ("wrong_mode",)),
    Hazard("command ignored, bit 12 low", OTHER, "ignores the command|does not enable", ("ignored_command",)),
    # frames lost, late, repeated
    Hazard("TPDOs stuck", OLD, "", ("stuck_tpdo",), lie=True, residual="lasts until torque or motion shows it"),
    Hazard(
        "encoder's TPDOs stuck", OLD, "", ("stuck_tpdo node=encoder",), lie=True,
        residual="lasts until the motor has moved farther than its torque elongates the tendons",
    ),
    Hazard("sensor's TPDOs stuck", OTHER, "", ("stuck_tpdo node=torque_sensor",), lie=True),
    Hazard("TPDOs 50 ms late", OLD, "stale PDO|confirm|enable", ("late_tpdo value=0.05",)),
    Hazard("TPDOs 3 ms late", OLD, "", ("late_tpdo value=0.003 duration=0.3",), goes_on="as old as a tolerated loss"),
    Hazard("TPDOs lost", OLD, "stale PDO|confirm|enable", ("missing_tpdo",)),
    Hazard("encoder's TPDOs lost", OLD, "stale PDO.*encoder", ("missing_tpdo node=encoder",)),
    Hazard("two of three TPDOs lost", OLD, "stale PDO", ("sparse_tpdo value=2",), lie=True),
    Hazard("every other TPDO lost", OLD, "stale PDO", ("sparse_tpdo value=1",), lie=True),
    Hazard(
        "a tenth of the TPDOs lost", OLD, "", ("missing_tpdo value=0.1",),
        goes_on="reported; values are a period old",
    ),
    Hazard("TPDOs of a wrong length", OLD, "stale PDO|confirm|enable", ("wrong_length",)),
    Hazard("TPDOs sent twice: a double id", OTHER, "repeated PDOs|two nodes", ("repeated_tpdo",), lie=True),
    Hazard("stale TPDOs replayed", OLD, "", ("replay value=0.1",), goes_on="never accepted as new"),
    Hazard("flood of other identifiers", OLD, lines=("flood value=3000 duration=0.3",), goes_on="they are filtered"),
    Hazard("heartbeat of the drive lost", NOBODY, "heartbeat lost", ("heartbeat_lost",)),
    Hazard("heartbeat of the encoder lost", NOBODY, "heartbeat lost", ("heartbeat_lost node=encoder",)),
    # wires
    Hazard("commands (RPDOs) lost", OLD, "0x8250|drive fault|enable|confirm|reports", ("rpdo_lost",)),
    Hazard("two of three commands lost", OLD, "", ("sparse_rpdo value=2",), goes_on="a command is two periods old"),
    Hazard("four of five commands lost", OLD, "held an older command", ("sparse_rpdo value=4",), lie=True),
    Hazard("nineteen of twenty commands lost", OLD, "held an older command|drive fault|emergency",
           ("sparse_rpdo value=19",), lie=True, open=_OLDER),
    Hazard("the drive hears nothing", OLD, _LOST + "|enable|reset", ("deaf",)),
    Hazard("nothing is heard of the drive", OLD, _LOST + "|enable", ("missing_tpdo", "heartbeat_lost")),
    Hazard("error frame: bus-off", NOBODY, "bus fault", ("error_frame value=64",)),
    Hazard("error frame: error passive", NOBODY, "", ("error_frame value=4",), goes_on="the bus still carries frames"),
    Hazard("interface down, up, stale frames", OLD, "bus fault", ("interface_down duration=0.1",)),
    # others on the bus
    Hazard("second master sends SYNC", OTHER, _MASTER, act="sync"),
    Hazard("second master sends SYNC with a counter", OTHER, _MASTER, act="counted_sync"),
    Hazard("second master sends commands", OTHER, _MASTER, act="command"),
    Hazard("a node is reset by somebody", NOBODY, _MASTER, act="reset"),
    Hazard("a third party's SDO takes the RPDO timer", NOBODY, "second master", act="sdo"),
    Hazard("a third party's SDO takes our heartbeat", NOBODY, "second master", ("foreign_sdo",)),
    Hazard(
        "a tool on another port takes the watchdogs", NOBODY, "configuration changed", ("watchdogs_lost",), lie=True,
        residual="detected within 2 s by reading back; until then only the loop can end the torque",
    ),
    Hazard(
        "a tool on another port writes a torque offset", MOVES, "configuration changed|reports", ("torque_offset",),
        lie=True, residual="detected within 0.3 s by reading back",
    ),
    # the computer
    Hazard("loop stands still for 0.3 s", OLD, _LOST + "|0x8|skipped", act="hang", open=_LATER),
    Hazard("loop stands still for 10 ms", OLD, "", act="hitch", goes_on="shorter than every time-out"),
    Hazard("loop dies", NOBODY, "", act="die", residual="the drive's time-outs stop it: tsa verify-safety"),
    Hazard("recovery asked for meanwhile", MOVES, "", act="recover", goes_on="only from a latched fault"),
    # motor
    Hazard("motor turns the wrong way", MOVES, "", ("reversed_sign",), lie=True, open=_LIMB),
    Hazard("polarity turned", MOVES, "", ("polarity",), lie=True),
    Hazard("motor gives 1.4 times", MOVES, "", ("torque_gain value=1.4",), lie=True, residual=_UNSEEN, open=_MORE),
    Hazard("motor gives twice", MOVES, "", ("torque_gain value=2",), lie=True, residual=_UNSEEN, open=_LATE),
    Hazard("drive's clock drifts by 1 %", OLD, "", ("clock_drift duration=0.3",), goes_on="a value is a period old"),
    # tendons
    Hazard("tendon b tears", MOVES, "", ("torn_tendon value=1",), lie=True, stays=True, residual=_TORN, open=_PULLED),
    Hazard("tendon a tears", MOVES, "", ("torn_tendon value=0",), lie=True, stays=True, residual=_TORN, open=_FALLS),
    Hazard("slack: a tenth of the pretension", MOVES, "", ("slack",), lie=True, released=True, open=_SLACK),
    Hazard("slack: half of the pretension", MOVES, "", ("slack value=0.5",), lie=True, released=True, open=_BLIND),
    Hazard("fraying: pretension goes down", MOVES, "", ("fraying",), lie=True, released=True, open=_BLIND),
    Hazard("friction half", MOVES, "", ("friction value=0.5",), lie=True, released=True, open=_BLIND),
    Hazard("sheath 20 % straighter", MOVES, "", ("bending value=0.8",), lie=True, released=True, open=_BLIND),
    # sensors
    Hazard("joint encoder jumps", MOVES, "", ("encoder_jump",), lie=True),
    Hazard("joint encoder wanders", MOVES, "", ("encoder_drift",), lie=True),
    Hazard("joint encoder noisy", MOVES, "", ("encoder_noise",), lie=True, open=_LOOSE),
    Hazard("joint encoder's coupling slips", MOVES, "", ("encoder_slip",), lie=True),
    Hazard("torque sensor stuck", OTHER, "", ("torque_sensor_stuck",), lie=True),
    Hazard("torque sensor's sign turned", OTHER, "", ("torque_sensor_gain",), lie=True),
    # two of a kind
    Hazard("two drives' ids exchanged", MOVES, "", act="exchange", lie=True, axes=2),
)  # fmt: skip
BY_NAME = {each.name: each for each in HAZARDS}
