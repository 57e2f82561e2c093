"""What mends a refusal: for each object that a node does not take, the line of which file to write."""

from __future__ import annotations

from tsa_ctrl.bus.canopen import objects
from tsa_ctrl.bus.canopen.cia402 import OFFSETS
from tsa_ctrl.bus.canopen.objects import Object
from tsa_ctrl.bus.drive.profile import DriveProfile
from tsa_ctrl.bus.settings import DriveSettings, NodeSettings

_NO_OBJECT = frozenset({0x06020000, 0x06090011})
_READ_ONLY = frozenset({0x06010000, 0x06010002})
_STATE = frozenset({0x08000022, 0x08000021, 0x08000020, 0x06060000})
_NOT_MAPPABLE = frozenset({0x06040041, 0x06040042})
_COUNTED_RPDOS = 4  # at most by rpdo_count of a profile

_REACTIONS = {
    objects.QUICK_STOP_OPTION.key: "quick_stop",
    objects.SHUTDOWN_OPTION.key: "shutdown",
    objects.DISABLE_OPTION.key: "disable_operation",
    objects.HALT_OPTION.key: "halt",
    objects.FAULT_REACTION_OPTION.key: "fault",
    objects.ERROR_BEHAVIOUR.key: "communication_error",
}
_SETTINGS = {  # what an object's value comes from, in the controller's file
    objects.HEARTBEAT_PRODUCER.key: "heartbeat_period in [axis.drive]",
    objects.HEARTBEAT_CONSUMER.key: "host_timeout in [axis.drive]",
    objects.LIFE_TIME_FACTOR.key: "host_timeout in [axis.drive]",
    objects.GUARD_TIME.key: "host_heartbeat_period in [bus]",
    objects.RPDO_EVENT_TIMER.key: "rpdo_timeout in [axis.drive]",
    objects.CONNECTION_LOSS.key: "connection_loss in [axis.drive]",
    objects.INTERPOLATION_PERIOD.key: "rate in [controller]",
    objects.INTERPOLATION_EXPONENT.key: "rate in [controller]",
    objects.MAX_TORQUE.key: "max_torque in [axis.drive]",
    objects.POLARITY.key: "polarity in [axis.drive]",
    objects.MAX_MOTOR_SPEED.key: "max_speed in [axis.drive], or [units] max_speed in {profile}",
}
_SPECIAL = {  # objects for which `absent` alone is not enough
    objects.HEARTBEAT_PRODUCER.key: 'write supervision = "guarding" in {profile}, if it knows node guarding alone',
    **dict.fromkeys(
        (entry.key for entry in OFFSETS),
        "allowed is 0, because the drive adds this object to the command and the motor would turn at command 0; set it "
        "to 0 and store it with the maker's tool, and remove it from the drive's own PDOs and programs",
    ),
    objects.VELOCITY_UNIT.key: 'write absent = ["SI unit velocity"] and the unit of its 0x606C as [units] velocity in '
    '{profile}, or velocity_source = "position" in [axis.drive]',
    objects.MAX_TORQUE.key: 'write absent = ["max torque"] and [torque_clamp] in {profile}: the object that limits the '
    "torque instead, and the one that holds its value at rated torque",
    objects.MODE.key: "set up its motor and sensors for torque with the maker's tool, or use another drive: this one "
    "takes no cyclic synchronous torque mode (10) as it is",
    objects.INTERPOLATION_PERIOD.key: "choose a rate in [controller] whose period it takes, or write absent = "
    '["interpolation period", "interpolation period exponent"] in {profile}, if it needs none for torque',
    objects.INTERPOLATION_EXPONENT.key: "choose a rate in [controller] whose period is whole milliseconds (1000, 500, "
    '250, 200, 125, 100 Hz), or write absent = ["interpolation period", "interpolation period exponent"] in {profile}',
}


def profile_of(drive: DriveSettings) -> str:
    """The file that a line for the drive's profile goes to."""
    if drive.profile == "generic":
        return "a profile of its own (tsa drive probe writes one; named by profile in [axis.drive])"
    return drive.profile if drive.profile.endswith(".toml") else f"drives/{drive.profile}.toml"


def cure(entry: Object, node: NodeSettings, profile: DriveProfile, code: int | None = None) -> str:
    """What to do about an object that a node refused with this abort code, or (None) took and did not keep."""
    if not isinstance(node, DriveSettings):
        return "check that this is the sensor that the configuration means: node_id, vendor_id, product_code"
    plain = entry.of(2 - node.slot) if node.slot > 1 else entry
    text = _advice(plain, node, profile, code).format(profile=profile_of(node))
    if code in _STATE:
        return (
            "end the maker's tool, unlock it, power it off and on (it does not take that in its present state); if "
            f"that does not help, {text}"
        )
    return text


def _advice(entry: Object, node: DriveSettings, profile: DriveProfile, code: int | None) -> str:
    key = entry.key
    if entry.index in range(0x1400, 0x1C00):
        return _of_a_pdo(entry, code)
    if key in _REACTIONS:
        return f'write {_REACTIONS[key]} = "keep", or a value that it takes, under [reactions] in {{profile}}'
    special, setting = _SPECIAL.get(key), _SETTINGS.get(key)
    if setting is not None and code not in _NO_OBJECT and code not in _READ_ONLY:
        return f"correct {setting}: it does not take this value" + ("" if special is None else f"; or {special}")
    return special or _absent(entry)


def _of_a_pdo(entry: Object, code: int | None) -> str:
    received = entry.index in range(0x1400, 0x1800)
    number = entry.index % 0x40 + 1
    if received and number > _COUNTED_RPDOS:
        return "switch this RPDO off and store that with the maker's tool: only this controller may command torque"
    if number > (1 if received else 2):
        name = "rpdo_count" if received else "tpdo_count"
        return f"write {name} = {number - 1} in {{profile}}: this PDO is not used, and was only to be switched off"
    if entry.subindex == 5 and received:
        name = objects.RPDO_EVENT_TIMER.name
        return f'correct rpdo_timeout in [axis.drive], or write absent = ["{name}"] in {{profile}}'
    if "mapped object" in entry.name and code in _NOT_MAPPABLE | _NO_OBJECT and not received and number == 2:
        return (
            f'write absent = ["{objects.ERROR_CODE.name}"] in {{profile}}, if it has no 0x603F; else look for another '
            "firmware: it cannot map what this controller needs into one PDO"
        )
    if code in _NOT_MAPPABLE:
        return "look for another firmware: it cannot map what this controller needs into one PDO"
    return (
        "map this PDO so with the maker's tool, store it there, and start again: what is as wanted is left alone, and "
        "this drive does not let it be changed"
    )


def _absent(entry: Object) -> str:
    known = {known.key: known.name for known in objects.TABLE}
    name = known.get(entry.key)
    if name is None:
        return f"correct or remove the [[extra]] '{entry.name}' in {{profile}}"
    return f'write absent = ["{name}"] in {{profile}}'
