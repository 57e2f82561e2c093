"""Test the SDO server with literal frames of CiA 301."""

from __future__ import annotations

import pytest

from tsa_ctrl.plant.dictionary import Access, Entry, ObjectDictionary, Type
from tsa_ctrl.plant.node import SdoServer


@pytest.fixture
def server() -> SdoServer:
    return SdoServer(
        ObjectDictionary(
            (
                Entry(0x1000, 0, Type.U32, Access.CONST, 0x00020192),
                Entry(0x1008, 0, Type.TEXT, Access.CONST, "simulated drive"),
                Entry(0x1017, 0, Type.U16),
                Entry(0x2000, 0, Type.TEXT, Access.RW, ""),
                Entry(0x6040, 0, Type.U16, Access.WO),
                Entry(0x6060, 0, Type.I8, low=-1, high=10),
                Entry(0x6071, 0, Type.I16),
            )
        )
    )


@pytest.mark.parametrize(
    ("request_frame", "response"),
    [
        ("4000100000000000", "4300100092010200"),  # upload u32
        ("2b171000e8030000", "6017100000000000"),  # download u16
        ("2f6060000a000000", "6060600000000000"),  # download i8
        ("2271600018fc0000", "6071600000000000"),  # download without a size, which the object determines
        ("4000200100000000", "8000200111000906"),  # no such sub-index
        ("4001200000000000", "8001200000000206"),  # no such object
        ("2300100000000000", "8000100002000106"),  # read only
        ("4040600000000000", "8040600001000106"),  # write only
        ("2b6060000a000000", "8060600012000706"),  # too long
        ("2f71600005000000", "8071600013000706"),  # too short
        ("2f6060000b000000", "8060600031000906"),  # too high
        ("2f606000fe000000", "8060600032000906"),  # too low
        ("a000100000000000", "8000100001000405"),  # block transfer, which is optional
        ("6000000000000000", "8000000001000405"),  # a segment without a transfer
    ],
)
def test_one_request_has_one_response(server: SdoServer, request_frame: str, response: str) -> None:
    assert [answer.hex() for answer in server.handle(bytes.fromhex(request_frame))] == [response]


def test_a_text_is_uploaded_in_segments(server: SdoServer) -> None:
    requests = ("4008100000000000", "6000000000000000", "7000000000000000", "6000000000000000")
    answers = [server.handle(bytes.fromhex(request))[0].hex() for request in requests]
    assert answers == ["410810000f000000", "0073696d756c6174", "1065642064726976", "0d65000000000000"]


def test_a_text_is_downloaded_in_segments(server: SdoServer) -> None:
    start = server.handle(bytes.fromhex("2100200009000000"))
    first = server.handle(bytes.fromhex("0061626364656667"))
    last = server.handle(bytes.fromhex("1b68690000000000"))
    assert [answer.hex() for (answer,) in (start, first, last)] == [
        "6000200000000000",
        "2000000000000000",
        "3000000000000000",
    ]
    assert server.handle(bytes.fromhex("4000200000000000"))[0][4] == 9


def test_a_toggle_bit_that_stands_still_is_an_abort(server: SdoServer) -> None:
    server.handle(bytes.fromhex("4008100000000000"))
    server.handle(bytes.fromhex("6000000000000000"))
    assert server.handle(bytes.fromhex("6000000000000000"))[0].hex() == "8008100000000305"


def test_a_frame_of_other_length_or_an_abort_gets_no_answer(server: SdoServer) -> None:
    assert server.handle(b"\x40\x00\x10") == []
    assert server.handle(bytes.fromhex("8000100000000405")) == []


def test_a_refused_value_changes_nothing(server: SdoServer) -> None:
    server.handle(bytes.fromhex("2f6060000a000000"))
    server.handle(bytes.fromhex("2f6060000b000000"))
    assert server.handle(bytes.fromhex("4060600000000000"))[0].hex() == "4f6060000a000000"
