"""tests/conftest.py: what counts as a vcan for a test."""

from __future__ import annotations

import pytest

from tests.conftest import lack_of_vcan


@pytest.mark.parametrize(
    ("name", "lack"),
    [("", "no vcan: run under tools/vcan"), ("vcan9999", "no vcan: TSA_VCAN=vcan9999: No such device")],
)
def test_without_an_interface_the_reason_is_named(monkeypatch: pytest.MonkeyPatch, name: str, lack: str) -> None:
    monkeypatch.setenv("TSA_VCAN", name)
    assert lack_of_vcan() == lack
