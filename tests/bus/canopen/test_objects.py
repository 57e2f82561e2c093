"""Test the encoding of objects, and the object table."""

from __future__ import annotations

import pytest

from tsa_ctrl.bus.canopen import objects
from tsa_ctrl.bus.canopen.objects import Type
from tsa_ctrl.errors import UsageError


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
