"""What the tests need of the machine: a vcan, a browser, measured data. Absent, a test skips with one line."""

from __future__ import annotations

import fcntl
import gc
import hashlib
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
CLAIMS = "TSA_CLAIMS"  # folder of two runs that share their tests: in it stands what one of them has begun
GARBAGE = (100_000, 50, 100)  # objects, and rounds, after which garbage is looked for: it is tens of MB then
SIOCGIFFLAGS, IFF_UP = 0x8913, 0x1  # linux/sockios.h, linux/if.h

gc.disable()  # until the tests are read
hypothesis.settings.register_profile("local", deadline=None)
hypothesis.settings.register_profile("reproducible", deadline=None, derandomize=True, database=None)
hypothesis.settings.load_profile("reproducible" if os.environ.get("CI") == "true" else "local")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN and threading.current_thread() is threading.main_thread():
    signal.signal(signal.SIGINT, signal.default_int_handler)  # under nohup; what a test starts would ignore it, too


@pytest.hookimpl(tryfirst=True)  # pytest-xdist reads the groups in the same hook
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """What shares a worker of pytest-xdist, and its order.

    Tests that talk on a bus share one: two at once would hear each other. So do those that share a fixture of their
    module: it is made once. Groups come first, the largest one at once, then what is slow: no worker ends alone.
    Of two runs at once that share their tests (TSA_CLAIMS) each comes to the longest ones first, too.
    """
    for item in items:
        if item.get_closest_marker("hil"):
            item.add_marker(pytest.mark.xdist_group("bus"))
        elif item.get_closest_marker("xdist_group") is None and _shares_a_fixture(item):
            item.add_marker(pytest.mark.xdist_group(item.nodeid.partition("::")[0]))
    if CLAIMS in os.environ:
        items.reverse()  # the campaign, the longest one, is in one of the last files
    if hasattr(config, "workerinput") or CLAIMS in os.environ:
        items.sort(key=lambda item: item.get_closest_marker("slow") is None)


def pytest_collection_finish(session: pytest.Session) -> None:
    """Modules and tests that were read stay to the end: to look through them for garbage again and again is in vain.

    Nor is it looked for while they are read, and later less often than by default: a tenth of the processor's time.
    """
    gc.enable()
    gc.freeze()
    gc.set_threshold(*GARBAGE)


def pytest_sessionfinish(session: pytest.Session) -> None:
    gc.unfreeze()


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop(session: pytest.Session) -> bool | None:
    """Of two runs at once, each on a vcan and a processor of its own, the one that comes first to a test runs it."""
    if CLAIMS not in os.environ or session.testsfailed or session.config.option.collectonly:
        return None
    for item in session.items:
        if claimed(Path(os.environ[CLAIMS]), item.nodeid):
            item.ihook.pytest_runtest_protocol(item=item, nextitem=None)  # which test is the next is not known yet
        if session.shouldstop:
            raise session.Interrupted(session.shouldstop)
    return True


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
    if name.startswith("datagram:"):
        return f"no vcan: TSA_VCAN={name}: local sockets are no interface of the kernel"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        try:
            answer = fcntl.ioctl(any_socket, SIOCGIFFLAGS, struct.pack("16sH14x", name.encode(), 0))
        except OSError as error:
            return f"no vcan: TSA_VCAN={name}: {error.strerror}"
    up = struct.unpack_from("16xH", answer)[0] & IFF_UP
    return None if up else f"no vcan: TSA_VCAN={name} is down"


def claimed(folder: Path, name: str) -> bool:
    """Whether this run is the first one to ask for the test `name`: `folder` is that of both."""
    try:
        (folder / hashlib.sha256(name.encode()).hexdigest()).mkdir()
    except FileExistsError:
        return False
    return True


def _shares_a_fixture(item: pytest.Item) -> bool:
    """Whether it asks for a fixture that its module makes once."""
    if not isinstance(item, pytest.Function):
        return False
    found = (each for made in item._fixtureinfo.name2fixturedefs.values() for each in made)
    return any(each.scope == "module" for each in found)


def _browser() -> str | None:
    return next((path for name in BROWSERS if (path := shutil.which(name))), None)
