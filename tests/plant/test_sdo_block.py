"""SDO block transfers, asked for by python-canopen's client."""

from __future__ import annotations

from typing import Any

import canopen
import pytest
from canopen.sdo import SdoClient
from canopen.sdo.exceptions import SdoAbortedError

from tsa_ctrl.plant.dictionary import Access, Entry, ObjectDictionary, Type
from tsa_ctrl.plant.sdo import SdoServer

LONG = "a name that does not fit into one block of segments " * 40


class Wire:
    """python-canopen's network, with one server at the other end."""

    def __init__(self) -> None:
        self.server = SdoServer(
            ObjectDictionary(
                (
                    Entry(0x1000, 0, Type.U32, Access.CONST, 0x00020192),
                    Entry(0x1008, 0, Type.TEXT, Access.CONST, LONG),
                    Entry(0x2000, 0, Type.TEXT, Access.RW, ""),
                )
            )
        )
        self.client = SdoClient(0x601, 0x581, canopen.ObjectDictionary())
        self.client.network = self

    def send_message(self, can_id: int, data: Any, remote: bool = False) -> None:
        for answer in self.server.handle(bytes(data)):
            self.client.on_response(0x581, bytearray(answer), 0.0)


@pytest.mark.parametrize(("index", "data"), [(0x1008, LONG.encode()), (0x1000, b"\x92\x01\x02\x00")])
def test_block_upload(index: int, data: bytes) -> None:
    with Wire().client.open(index, 0, "rb", block_transfer=True) as file:
        assert file.read() == data


@pytest.mark.parametrize("length", [1, 7, 8, 889, 890, 2000])
def test_block_download(length: int) -> None:
    wire = Wire()
    data = bytes(ord("a") + place % 26 for place in range(length))
    with wire.client.open(0x2000, 0, "wb", size=length, block_transfer=True) as file:
        file.write(data)
    assert wire.client.upload(0x2000, 0) == data


def test_a_refused_block_download_is_aborted() -> None:
    wire = Wire()
    with (
        pytest.raises(SdoAbortedError, match="0x06010002"),
        wire.client.open(0x1008, 0, "wb", size=9, block_transfer=True) as file,
    ):
        file.write(b"read only")


def test_a_wrong_check_sum_is_aborted() -> None:
    server = Wire().server
    server.handle(bytes.fromhex("c600200002000000"))
    server.handle(bytes.fromhex("8161620000000000"))
    assert [answer.hex() for answer in server.handle(bytes.fromhex("d5ffff0000000000"))] == ["8000200004000405"]
