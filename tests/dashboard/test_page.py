"""The page in a real browser, served by `tsa dashboard` itself."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.daemon.serving import until
from tests.dashboard.chromium import Page, chromium
from tests.dashboard.playing import Played, played
from tsa_ctrl.ipc.mailbox import Command

pytestmark = [pytest.mark.browser, pytest.mark.slow]

ROW = "document.querySelector('[data-parameter=\"knee.compensation\"]')"
DRAG = f"""(() => {{
    const slider = {ROW}.querySelector('input');
    slider.value = 0.5;
    slider.dispatchEvent(new Event('input'));
}})()"""
CLICK = "{row}.querySelectorAll('button')[{place}].click()"
APPLY, CANCEL = CLICK.format(row=ROW, place=0), CLICK.format(row=ROW, place=1)
NOW = f"{ROW}.querySelector('.number').textContent"


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[Played]:
    with played(tmp_path / "tsa.sock") as made:
        yield made


@pytest.fixture
def address(daemon: Played) -> Iterator[str]:
    command = [sys.executable, "-m", "tsa_ctrl", "dashboard", "--socket", daemon.path]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    line = process.stdout.readline()
    assert line.startswith("dashboard: http://127.0.0.1:"), line
    yield line.removeprefix("dashboard: ").strip()
    process.terminate()
    assert "Traceback" not in process.communicate(timeout=30)[1]


@pytest.fixture
def page(browser: str, address: str, tmp_path: Path) -> Iterator[Page]:
    with chromium(browser, tmp_path) as made:
        made.open(address)
        made.until(f"!!{ROW}")
        yield made
        assert made.errors == []


def test_shows_what_the_daemon_says(page: Page, tmp_path: Path) -> None:
    """Name, phase, each axis with its charts, lateness; live."""
    page.until("document.getElementById('phase').textContent === 'running'")
    assert page.evaluate("document.getElementById('name').textContent") == "rig"
    titles = "[...document.querySelectorAll('article .title')].map((title) => title.textContent).join()"
    assert page.evaluate(titles) == "knee,hip"
    assert page.evaluate("document.querySelectorAll('article canvas').length") == 4
    assert "µs" in page.evaluate("document.getElementById('times').textContent")
    before = page.evaluate("axes.get('knee').data.torque[0].length")
    page.until(f"axes.get('knee').data.torque[0].length > {before + 5}")
    assert page.evaluate("axes.get('knee').data.torque[1].some((value) => value !== 0)")
    assert not page.evaluate("!!document.querySelector('[data-parameter=\"knee.pretension\"]')")  # cannot be set
    page.picture(tmp_path / "page.png")
    assert (tmp_path / "page.png").stat().st_size > 10_000


def test_a_change_needs_a_confirmation_and_can_be_undone(page: Page, daemon: Played) -> None:
    """A slider alone asks for nothing; apply sets, undo sets back, cancel forgets."""
    page.evaluate(DRAG)
    assert page.evaluate(f"{ROW}.classList.contains('pending')")
    page.evaluate(CANCEL)
    assert not page.evaluate(f"{ROW}.classList.contains('pending')")
    assert daemon.taken == []
    page.evaluate(DRAG)
    page.evaluate(APPLY)
    assert until(lambda: daemon.taken == [Command(0, 0, 0.5)])
    page.until(f"{NOW} === '0.5'")
    assert "0.95" in page.until("!document.getElementById('changes').hidden && document.body.textContent")
    page.evaluate("document.getElementById('undo').click()")
    assert until(lambda: daemon.taken == [Command(0, 0, 0.5), Command(0, 0, 0.95)])
    page.until(f"{NOW} === '0.95' && document.getElementById('changes').hidden")


def test_stop_needs_two_clicks(page: Page, daemon: Played) -> None:
    """The first one asks whether it is meant."""
    page.evaluate("document.getElementById('stop').click()")
    assert page.evaluate("document.getElementById('stop').textContent") == "really stop?"
    assert not daemon.serving.mailbox.stop_requested
    page.evaluate("document.getElementById('stop').click()")
    assert until(lambda: daemon.serving.mailbox.stop_requested)


def test_daemon_that_is_gone_is_seen(page: Page, daemon: Played) -> None:
    """In red, and what to do."""
    daemon.end()
    page.until("document.getElementById('phase').textContent === 'no daemon'")
    page.until("document.getElementById('news').textContent.includes('no daemon answers')")
