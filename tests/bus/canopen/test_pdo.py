"""Compare layout and mapping entries of the PDO plan with the numbers of the standard."""

from __future__ import annotations

import pytest

from tsa_ctrl.bus.canopen import objects, pdo
from tsa_ctrl.bus.canopen.objects import Type
from tsa_ctrl.errors import UsageError


@pytest.mark.parametrize(
    ("layout", "cob_id", "length"),
    [
        (pdo.COMMAND, 0x201, 4),
        (pdo.MOTION, 0x181, 8),
        (pdo.POSITION, 0x281, 7),
        (pdo.ENCODER, 0x181, 4),
        (pdo.TORQUE_SENSOR, 0x181, 4),
    ],
)
def test_cob_id_and_length(layout: pdo.Pdo, cob_id: int, length: int) -> None:
    assert (layout.cob_id(1), layout.length) == (cob_id, length)


def test_command_as_bytes() -> None:
    assert pdo.COMMAND.struct.pack(0x000F, -2) == b"\x0f\x00\xfe\xff"


def test_motion_from_bytes() -> None:
    assert pdo.MOTION.struct.unpack(b"\x37\x16\x9c\xff\x00\x00\x00\x80") == (0x1637, -100, -(1 << 31))


def test_position_from_bytes() -> None:
    assert pdo.POSITION.struct.unpack(b"\x01\x00\x00\x00\x0a\x10\x32") == (1, 10, 0x3210)


def test_mapping_entries() -> None:
    assert [entry.mapping for entry in (*pdo.COMMAND.objects, *pdo.MOTION.objects, *pdo.POSITION.objects)] == [
        0x60400010,
        0x60710010,
        0x60410010,
        0x60770010,
        0x606C0020,
        0x60640020,
        0x60610008,
        0x603F0010,
    ]


def test_parameters_of_a_pdo_by_number() -> None:
    assert pdo.POSITION.communication(1, Type.U32, "COB-ID").key == (0x1801, 1)
    assert (pdo.POSITION.mapping(0).key, pdo.COMMAND.mapping(2).key) == ((0x1A01, 0), (0x1600, 2))


@pytest.mark.parametrize("type_", list(Type))
def test_values_survive_encoding_at_their_bounds(type_: Type) -> None:
    entry = objects.Object(0x2000, 1, type_, "x")
    for value in (type_.low, -1 if type_.low else 0, 0, 1, type_.high):
        assert entry.decode(entry.encode(value)) == value


def test_value_beyond_its_type_is_refused_by_name() -> None:
    with pytest.raises(UsageError, match=r"0x6072:0 max torque: value 65536 does not fit u16 \(0 to 65535\)"):
        objects.MAX_TORQUE.encode(65536)


def test_longer_answer_is_truncated_and_shorter_extended() -> None:
    assert objects.MODE_DISPLAY.decode(b"\x0a\x00\x00\x00") == 10
    assert objects.MODE_DISPLAY.decode(b"\xff\x00") == -1
    assert objects.RATED_TORQUE.decode(b"\xe8\x03") == 1000


def test_no_object_is_listed_twice() -> None:
    assert len({entry.key for entry in objects.TABLE}) == len(objects.TABLE)
    assert len({entry.name for entry in objects.TABLE}) == len(objects.TABLE)
