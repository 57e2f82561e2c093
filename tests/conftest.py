"""What the tests need of the machine: a vcan, a browser, measured data. Absent, a test skips with one line."""

from __future__ import annotations

import fcntl
import os
import shutil
import signal
import socket
import struct
import threading
from pathlib import Path

import hypothesis
import pytest

ROOT = Path(__file__).resolve().parent.parent
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
SIOCGIFFLAGS, IFF_UP = 0x8913, 0x1  # linux/sockios.h, linux/if.h

hypothesis.settings.register_profile("local", deadline=None)
hypothesis.settings.register_profile("reproducible", deadline=None, derandomize=True, database=None)
hypothesis.settings.load_profile("reproducible" if os.environ.get("CI") == "true" else "local")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN and threading.current_thread() is threading.main_thread():
    signal.signal(signal.SIGINT, signal.default_int_handler)  # under nohup; what a test starts would ignore it, too


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """What shares a worker of pytest-xdist, and its order.

    Tests that talk on a bus share one: two at once would hear each other. So do those that share a fixture of their
    module: it is made once. Groups come first, the largest one at once, then what is slow: no worker ends alone.
    With TSA_HALF=1/2 or 2/2 only the modules of that half of the tests on a vcan: each has a vcan and a processor.
    """
    for item in items:
        if item.get_closest_marker("hil"):
            item.add_marker(pytest.mark.xdist_group("bus"))
        elif item.get_closest_marker("xdist_group") is None and _shares_a_fixture(item):
            item.add_marker(pytest.mark.xdist_group(item.nodeid.partition("::")[0]))
    if half := os.environ.get("TSA_HALF"):
        mine = set(_half([item for item in items if _in_real_time(item)], int(half[0])))
        config.hook.pytest_deselected(items=[item for item in items if item.nodeid.partition("::")[0] not in mine])
        items[:] = [item for item in items if item.nodeid.partition("::")[0] in mine]
    if hasattr(config, "workerinput"):
        items.sort(key=lambda item: item.get_closest_marker("slow") is None)


def pytest_runtest_setup(item: pytest.Item) -> None:
    if item.get_closest_marker("vcan") and (lack := lack_of_vcan()):
        if os.environ.get("TSA_REQUIRE_VCAN") == "1":
            pytest.fail(lack, pytrace=False)
        pytest.skip(lack)
    if item.get_closest_marker("browser") and _browser() is None:
        pytest.skip(f"no browser: none of {', '.join(BROWSERS)} is on PATH")


@pytest.fixture(scope="session")
def vcan() -> str:
    """Name of the interface that tools/vcan made or found; for tests marked `vcan`."""
    return os.environ["TSA_VCAN"]


@pytest.fixture(scope="session")
def browser() -> str:
    """Path of a Chromium; for tests marked `browser`."""
    path = _browser()
    assert path is not None
    return path


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of the measured data sets: TSA_DATA, else `shared/data` beside the project, else what was fetched."""
    from tsa_ctrl.published import catalogue

    places = [ROOT.parent / "shared" / "data", catalogue.folder()]
    if catalogue.VARIABLE in os.environ:
        places = places[1:]
    found = next((place for place in places if place.is_dir()), None)
    if found is None:
        pytest.skip(
            f"no measured data in {places[0]}: tsa data fetch davinci, or name its folder in {catalogue.VARIABLE}"
        )
    return found


def lack_of_vcan() -> str | None:
    """Why there is no vcan for this test; None when there is one."""
    name = os.environ.get("TSA_VCAN")
    if not name:
        return "no vcan: run under tools/vcan"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        try:
            answer = fcntl.ioctl(any_socket, SIOCGIFFLAGS, struct.pack("16sH14x", name.encode(), 0))
        except OSError as error:
            return f"no vcan: TSA_VCAN={name}: {error.strerror}"
    up = struct.unpack_from("16xH", answer)[0] & IFF_UP
    return None if up else f"no vcan: TSA_VCAN={name} is down"


def _shares_a_fixture(item: pytest.Item) -> bool:
    """Whether it asks for a fixture that its module makes once."""
    if not isinstance(item, pytest.Function):
        return False
    found = (each for made in item._fixtureinfo.name2fixturedefs.values() for each in made)
    return any(each.scope == "module" for each in found)


def _in_real_time(item: pytest.Item) -> bool:
    return bool(item.get_closest_marker("vcan")) and not item.get_closest_marker("soak")


def _half(items: list[pytest.Item], which: int) -> list[str]:
    """The modules of one half (1 or 2) of `items`: the largest first, each to the half that has less until then."""
    weights: dict[str, float] = {}
    for item in items:  # those marked slow run daemon and plant, ten seconds and more; the others take a tenth of one
        module = item.nodeid.partition("::")[0]
        weights[module] = weights.get(module, 0.0) + (1.0 if item.get_closest_marker("slow") else 0.01)
    halves: tuple[list[str], list[str]] = ([], [])
    loads = [0.0, 0.0]
    for module in sorted(weights, key=lambda module: (-weights[module], module)):
        less = loads.index(min(loads))
        halves[less].append(module)
        loads[less] += weights[module]
    return halves[which - 1]


def _browser() -> str | None:
    return next((path for name in BROWSERS if (path := shutil.which(name))), None)
