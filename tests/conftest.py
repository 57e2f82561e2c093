"""Requirements of the tests: a vcan, a browser and measured data.

A test whose requirement is missing is skipped with a one-line reason.
"""

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
CLAIMS = "TSA_CLAIMS"  # folder in which two concurrent runs claim the tests that they share
GARBAGE = (100_000, 50, 100)  # thresholds of gc.set_threshold: garbage reaches tens of MB before a collection
SIOCGIFFLAGS, IFF_UP = 0x8913, 0x1  # linux/sockios.h, linux/if.h

gc.disable()  # until the tests are collected
hypothesis.settings.register_profile("local", deadline=None)
hypothesis.settings.register_profile("reproducible", deadline=None, derandomize=True, database=None)
hypothesis.settings.load_profile("reproducible" if os.environ.get("CI") == "true" else "local")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN and threading.current_thread() is threading.main_thread():
    signal.signal(signal.SIGINT, signal.default_int_handler)  # nohup ignores SIGINT, and children would inherit this


@pytest.hookimpl(tryfirst=True)  # pytest-xdist reads the groups in the same hook
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Assign tests to the workers of pytest-xdist and order them.

    Tests that use a bus share one worker, because two at once would receive each other's frames. Tests that share a
    fixture of their module also share a worker, so that the fixture is created once. pytest-xdist starts with the
    largest groups. Slow tests come next, so that no worker finishes long after the others. Two concurrent runs that
    share their tests (TSA_CLAIMS) also start with the slow tests.
    """
    for item in items:
        if item.get_closest_marker("hil"):
            item.add_marker(pytest.mark.xdist_group("bus"))
        elif item.get_closest_marker("xdist_group") is None and _shares_a_fixture(item):
            item.add_marker(pytest.mark.xdist_group(item.nodeid.partition("::")[0]))
    if CLAIMS in os.environ:
        items.reverse()  # the longest test, the campaign, is in one of the last files
    if hasattr(config, "workerinput") or CLAIMS in os.environ:
        items.sort(key=lambda item: item.get_closest_marker("slow") is None)


def pytest_collection_finish(session: pytest.Session) -> None:
    """Exclude the collected modules and tests from garbage collection.

    They exist until the end of the session, so scanning them again is wasted time. The collector is off during test
    collection. Afterwards it runs less often than by default, which would take about a tenth of the processor time.
    """
    gc.enable()
    gc.freeze()
    gc.set_threshold(*GARBAGE)


def pytest_sessionfinish(session: pytest.Session) -> None:
    gc.unfreeze()


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop(session: pytest.Session) -> bool | None:
    """Run each test that the other of two concurrent runs has not claimed.

    Each run has its own vcan and processor.
    """
    if CLAIMS not in os.environ or session.testsfailed or session.config.option.collectonly:
        return None
    for item in session.items:
        if claimed(Path(os.environ[CLAIMS]), item.nodeid):
            item.ihook.pytest_runtest_protocol(item=item, nextitem=None)  # the next test is not known yet
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
    """Return the name of the interface that tools/vcan created or found, for tests marked `vcan`."""
    return os.environ["TSA_VCAN"]


@pytest.fixture(scope="session")
def browser() -> str:
    """Return the path of a Chromium, for tests marked `browser`."""
    path = _browser()
    assert path is not None
    return path


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Return the folder of the measured data sets.

    It is TSA_DATA, else `shared/data` next to the project, else the folder of the downloaded data.
    """
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
    """Return the reason why no vcan is available, or None if one is up."""
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
    """Return True if this run is the first to claim the test `name` in the `folder` that both runs share."""
    try:
        (folder / hashlib.sha256(name.encode()).hexdigest()).mkdir()
    except FileExistsError:
        return False
    return True


def _shares_a_fixture(item: pytest.Item) -> bool:
    """Return True if the test uses a fixture with module scope."""
    if not isinstance(item, pytest.Function):
        return False
    found = (each for made in item._fixtureinfo.name2fixturedefs.values() for each in made)
    return any(each.scope == "module" for each in found)


def _browser() -> str | None:
    return next((path for name in BROWSERS if (path := shutil.which(name))), None)
