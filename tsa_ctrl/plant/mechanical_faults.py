"""Faults of parts that still answer: a motor that gives another torque, a supply that fails, a sensor that wanders."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from tsa_ctrl.errors import UsageError
from tsa_ctrl.plant.fault_kind import FaultKind, Target, Undo, parameter, swap
from tsa_ctrl.plant.sensors import EncoderFaults, TorqueSensor

FLAP = 0.1  # s, of which a stage that flaps is off for half
_FRAYED = 0.05  # of the pretension: the last wires hold so much
_STEP = 1e-3  # s between two steps of what changes slowly


def _all(*undos: Undo) -> Undo:
    def undo(now: float) -> None:
        for each in reversed(undos):
            each(now)

    return undo


def _repeated(target: Target, period: float, action: Callable[[float], None]) -> Undo:
    """Call `action` every `period` s from now on, until it is undone."""
    on = True

    def again(now: float) -> None:
        if on:
            action(now)
            target.rig.later(now + period, again)

    def end(now: float) -> None:
        nonlocal on
        on = False

    again(target.now)
    return end


def _fraying(target: Target) -> Undo:
    """The pretension goes down by `value` of it a second."""
    back = parameter(target, "pretension_factor", target.axis.parameters["pretension_factor"][0].item())

    def step(now: float) -> None:
        target.axis.parameters["pretension_factor"] = max(_FRAYED, 1.0 - target.value * (now - target.now))

    return _all(back, _repeated(target, _STEP, step))


def _flapping(target: Target) -> Undo:
    faults = target.drive.faults
    back = swap(faults, "dead_stage", False)

    def turn(now: float) -> None:
        faults.dead_stage = not faults.dead_stage

    return _all(back, _repeated(target, FLAP / 2.0, turn))


def _torque_off(target: Target) -> Undo:
    back = swap(target.drive.faults, "torque_off", True)
    target.drive.power_off()
    return back


def _watchdogs_lost(target: Target) -> Undo:
    """As by a tool on another port of the drive: the bus carries nothing of it."""
    values = target.drive.values
    keys = [key for key in ((0x1400, 5), (0x1016, 1)) if key in values]
    before = {key: values[key] for key in keys}
    values.update(dict.fromkeys(keys, 0))

    def undo(now: float) -> None:
        values.update(before)

    return undo


def _polarity(target: Target) -> Undo:
    faults = target.drive.faults
    return _all(swap(faults, "torque_sign", -faults.torque_sign), swap(faults, "turned", -faults.turned))


def _encoder(target: Target) -> EncoderFaults:
    if target.encoder is None:
        raise UsageError(f"axis '{target.axis.name}' has no encoder; choose another fault")
    return target.encoder.faults


def _sensor(target: Target) -> TorqueSensor:
    if target.torque_sensor is None:
        raise UsageError(f"axis '{target.axis.name}' has no torque sensor; choose another fault")
    return target.torque_sensor


def _encoder_drift(target: Target) -> Undo:
    faults = _encoder(target)
    return _all(swap(faults, "since", target.now), swap(faults, "drift", target.value))


def _encoder_slip(target: Target) -> Undo:
    faults = _encoder(target)
    return _all(swap(faults, "pivot", target.axis.readings.joint_angle), swap(faults, "gain", target.value))


def _object(target: Target, distorted: Callable[[int], int], index: int) -> Undo:
    """Distort what the drive reports in this object."""
    distortions = target.drive.faults.distortions
    distortions[index, 0] = distorted

    def undo(now: float) -> None:
        distortions.pop((index, 0), None)

    return undo


def _scaled(target: Target, index: int) -> Undo:
    """Multiply an object by the fault's value, a position from its present value on."""
    start = target.drive.values[index, 0] if index == 0x6064 else 0
    return _object(target, lambda value: start + round(target.value * (value - start)), index)


def _stuck(target: Target, index: int) -> Undo:
    """Hold an object at its present value."""
    held = target.drive.values[index, 0]
    return _object(target, lambda _: held, index)


def _reported_offset(target: Target) -> Undo:
    settings = target.drive.settings
    rated = settings.rated_torque * settings.gear_ratio * settings.torque_sign
    offset = round(target.value / rated * target.drive.emulation.torque_digits)
    return _object(target, lambda value: value + offset, 0x6077)


def _motor_encoder_stuck(target: Target) -> Undo:
    """Hold the position; the velocity that the drive derives of it is 0."""
    return _all(_stuck(target, 0x6064), _object(target, lambda _: 0, 0x606C))


def _encoder_stuck(target: Target) -> Undo:
    faults, held = _encoder(target), list[int]()

    def first(counts: int) -> int:
        if not held:
            held.append(counts)
        return held[0]

    return swap(faults, "distorted", first)


def _encoder_bit(target: Target) -> Undo:
    mask = 1 << int(target.value)
    return swap(_encoder(target), "distorted", lambda counts: counts | mask)


def _forged(target: Target) -> Undo:
    """Send a TPDO of the node once more, every millisecond, with the content of another moment."""
    identifiers = [tpdo.cob_id for tpdo in target.node.tpdos if tpdo.valid]
    last = {tpdo.cob_id: tpdo.last for tpdo in target.node.tpdos if tpdo.valid}

    def send(now: float) -> None:
        for can_id in identifiers:
            target.rig.inject(can_id, last[can_id])

    return _repeated(target, target.value, send)


MECHANICAL_FAULTS: Mapping[str, FaultKind] = {
    "position_stuck": FaultKind("0x6064 repeats its last value", lambda t: _stuck(t, 0x6064)),
    "velocity_stuck": FaultKind("0x606C repeats its last value", lambda t: _stuck(t, 0x606C)),
    "position_gain": FaultKind(
        "0x6064 counts wrongly", lambda t: _scaled(t, 0x6064), 2.0, "of what the motor turns", -10, 10
    ),
    "velocity_gain": FaultKind("0x606C is wrong by a factor", lambda t: _scaled(t, 0x606C), 2.0, "1", -10, 10),
    "motor_encoder_stuck": FaultKind("the motor's encoder rests: 0x6064 is held, 0x606C is 0", _motor_encoder_stuck),
    "reported_gain": FaultKind("0x6077 is wrong by a factor", lambda t: _scaled(t, 0x6077), 0.5, "1", -10, 10),
    "reported_offset": FaultKind("0x6077 is wrong by an offset", _reported_offset, 0.2, "N*m", -100, 100),
    "reported_stuck": FaultKind("0x6077 repeats its last value", lambda t: _stuck(t, 0x6077)),
    "encoder_stuck": FaultKind("the joint encoder repeats its last value", _encoder_stuck),
    "encoder_bit": FaultKind("a bit of the joint encoder is stuck at 1", _encoder_bit, 12, "bit", 0, 31),
    "forged_tpdo": FaultKind(
        "another node sends old TPDOs under the identifiers of this one", _forged, 1e-3, "s between two", 1e-4, 1.0
    ),
    "fraying": FaultKind("the tendons fray: the pretension goes down", _fraying, 2.0, "of it a second", 0, 100),
    "dead_stage": FaultKind(
        "the power stage loses its voltage: no torque, bit 4 low, still enabled",
        lambda t: swap(t.drive.faults, "dead_stage", True),
    ),
    "flapping_stage": FaultKind("the power stage is off for half of each 0.1 s", _flapping),
    "torque_off": FaultKind("safe torque off; after the duration its input is closed again", _torque_off),
    "derating": FaultKind(
        "the drive is too hot and gives less: bit 11",
        lambda t: swap(t.drive.faults, "most_torque", t.value),
        0.2, "of rated torque", 0, 10,
    ),
    "polarity": FaultKind("0x607E is turned: torque, position and velocity the other way", _polarity),
    "encoder_drift": FaultKind("the joint encoder wanders", _encoder_drift, 0.5, "rad/s", -100, 100),
    "encoder_noise": FaultKind(
        "the joint encoder is noisy", lambda t: swap(_encoder(t), "noise", t.value), 1e-3, "rad RMS", 0, 10
    ),
    "encoder_slip": FaultKind(
        "the joint encoder's coupling slips", _encoder_slip, 0.5, "of what the joint moves", -10, 10
    ),
    "torque_sensor_gain": FaultKind(
        "the joint torque sensor is wrong by a factor",
        lambda t: swap(_sensor(t).faults, "gain", t.value),
        -1.0, "of what is there", -10, 10,
    ),
    "watchdogs_lost": FaultKind("the drive's time-outs are gone, and no frame says so", _watchdogs_lost),
    "sparse_rpdo": FaultKind(
        "so many commands in a row do not reach the node, then one does",
        lambda t: swap(t.node, "lost_in_a_row", int(t.value)), 2, "RPDOs", 0, 1000,
    ),
    "deaf": FaultKind("a broken wire: the node sends, but hears nothing", lambda t: swap(t.node, "unhearing", True)),
}  # fmt: skip
