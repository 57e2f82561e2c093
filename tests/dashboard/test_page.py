"""Test the page of `tsa dashboard` in a real browser."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.daemon.serving import until
from tests.dashboard.chromium import Page, chromium
from tests.dashboard.playing import Played, played
from tsa_ctrl.ipc.mailbox import RECOVER, Command
from tsa_ctrl.signals import SIGNALS

pytestmark = [pytest.mark.browser, pytest.mark.slow]

ROW = "document.querySelector('[data-parameter=\"knee.compensation\"]')"
DRAG = f"""(() => {{
    const slider = {ROW}.querySelector('input');
    slider.value = 0.5;
    slider.dispatchEvent(new Event('input', {{bubbles: true}}));
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


@pytest.fixture(scope="module")
def started(browser: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with chromium(browser, tmp_path_factory.mktemp("chromium")) as made:
        yield made


@pytest.fixture
def page(started: Page, address: str) -> Iterator[Page]:
    started.renew()
    started.open(address)
    started.until(f"!!{ROW}")
    yield started
    assert started.errors == []
    started.renew()


def test_shows_what_the_daemon_says(page: Page, tmp_path: Path) -> None:
    """The page shows name, phase, the charts of each axis and the timing, and it updates continuously."""
    page.until("document.getElementById('phase').textContent === 'running'")
    assert page.evaluate("document.getElementById('name').textContent") == "rig"
    titles = "[...document.querySelectorAll('article .title')].map((title) => title.textContent).join()"
    assert page.evaluate(titles) == "knee,hip"
    assert page.evaluate("document.querySelectorAll('article canvas').length") == 12
    assert "µs" in page.evaluate("document.getElementById('times').textContent")
    torque = "axes.get('knee').data['joint torque']"
    before = page.evaluate(f"{torque}[0].length")
    page.until(f"{torque}[0].length > {before + 5}")
    assert page.evaluate(f"{torque}[1].some((value) => value !== 0)")
    figures = page.evaluate("document.querySelector('article .figures').textContent")
    assert "state operation enabled" in figures
    assert "pretension 0.25 N" in figures
    assert not page.evaluate("!!document.querySelector('[data-parameter=\"knee.pretension\"]')")  # cannot be set
    page.picture(tmp_path / "page.png")
    assert (tmp_path / "page.png").stat().st_size > 10_000


def test_a_change_needs_a_confirmation_and_can_be_undone(page: Page, daemon: Played) -> None:
    """A slider alone sends no command. Apply sets the value, undo restores it, and cancel discards the change."""
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


@pytest.mark.parametrize(
    "how",
    ["document.getElementById('stop').click()", "dispatchEvent(new KeyboardEvent('keydown', {key: 'Escape'}))"],
)
def test_stop_is_one_press_or_one_key(page: Page, daemon: Played, how: str) -> None:
    """A stop takes effect without a confirmation, because the torque is on."""
    assert not daemon.serving.mailbox.stop_requested
    page.evaluate(how)
    assert until(lambda: daemon.serving.mailbox.stop_requested)
    page.until("document.getElementById('message').textContent.startsWith('stopping')")


def test_a_stop_that_did_not_arrive_is_said_in_red(page: Page, daemon: Played) -> None:
    """If the daemon has ended, the stop button shows an error message that nothing was stopped from this page."""
    daemon.end()
    page.errors.clear()
    page.evaluate("document.getElementById('stop').click()")
    page.until("document.getElementById('message').textContent.startsWith('NOT STOPPED from here')")
    assert page.evaluate("document.getElementById('message').classList.contains('error')")
    assert all("503" in text for text in page.errors)  # the browser logs the failed request
    page.errors.clear()


def test_a_fault_is_shown_with_its_cure_and_recovered_by_two_presses(page: Page, daemon: Played) -> None:
    """The page shows the fault and its remedy. A recovery turns the torque on, so it requires a second press."""
    assert page.evaluate("document.getElementById('faulted').hidden")
    daemon.fail("stale PDO: drive node 1: 3 cycles in a row")
    page.until("!document.getElementById('faulted').hidden && !document.getElementById('recover').disabled")
    said = page.evaluate("document.getElementById('faults').textContent")
    assert "1.250 s  knee: stale PDO: drive node 1" in said
    assert "remedy: look at the bus" in said
    page.evaluate("document.getElementById('recover').click()")
    assert daemon.taken == []
    page.evaluate("document.getElementById('recover').click()")
    assert until(lambda: daemon.taken == [Command(0, RECOVER, 0.0)])


def test_a_number_is_typed_with_round_steps(page: Page, daemon: Played) -> None:
    typed = f"{ROW}.querySelector('input[type=number]')"
    assert float(page.evaluate(f"{typed}.step")) == 0.01
    page.evaluate(f"{typed}.value = '0.7'; {typed}.dispatchEvent(new Event('input', {{bubbles: true}}))")
    page.evaluate(APPLY)
    assert until(lambda: daemon.taken == [Command(0, 0, 0.7)])


def test_the_newest_values_are_shown_without_a_pointer_over_a_chart(page: Page) -> None:
    """The legends show each value with its unit. The tracking error is the delivered minus the desired torque."""
    page.until("axes.get('knee').data['joint torque'][0].length > 3")
    cells = "document.querySelectorAll('[data-chart=\"{kind}\"] .u-legend .u-value')"
    legend = f"[...{cells}].map((cell) => cell.textContent)"
    torque, angle = (legend.format(kind=kind) for kind in ("joint torque", "joint angle"))
    shown = page.until(f"(() => {{ const all = {torque}; return all[1] !== '--' && all; }})()")
    assert all(value.endswith((" s", " N·m")) for value in shown)
    assert page.evaluate(angle)[1].endswith(" rad")
    torques, errors = page.evaluate("[axes.get('knee').data['joint torque'], axes.get('knee').data['tracking error']]")
    (_, delivered, desired, *_), (_, error) = torques, errors
    assert all(
        abs(e - (got - want)) < 1e-9 for want, got, e in zip(desired, delivered, error, strict=False) if got is not None
    )
    page.until("document.querySelector('.errors').textContent.includes('while sliding')")
    span = "(([t]) => Math.min(20, Math.round(t[t.length - 1] - t[0])))(axes.get('knee').data['tracking error'])"
    page.until(f"document.querySelector('.errors').textContent.includes(`of the last ${{{span}}} s:`)")


def test_a_switch_is_a_switch(page: Page, daemon: Played) -> None:
    """A parameter with two values is shown as a switch, which requires a confirmation like a slider."""
    switch = "{value: 1, low: 0, high: 1, unit: '1', switch: true, doc: ''}"
    page.evaluate(f"addAxis({{name: 'ankle', omega_j: null, parameters: {{use_estimate: {switch}}}}})")
    row = "document.querySelector('[data-parameter=\"ankle.use_estimate\"]')"
    assert page.evaluate(f"{row}.querySelector('[role=switch]').checked")
    assert not page.evaluate(f"!!{row}.querySelector('input[type=range]')")
    page.errors.clear()
    page.evaluate(f"{row}.querySelector('[role=switch]').click()")
    assert page.evaluate(f"{row}.classList.contains('pending')")
    page.evaluate(CLICK.format(row=row, place=0))
    page.until("document.getElementById('message').textContent.includes(\"no axis 'ankle'\")")
    assert daemon.taken == []
    assert all("400" in text for text in page.errors)  # the browser logs the rejected request
    page.errors.clear()


def test_nothing_is_wider_than_the_screen(page: Page) -> None:
    for width in (360, 400, 768, 1100):
        page.resize(width)
        page.until(f"innerWidth === {width} && document.documentElement.scrollWidth <= {width}")
        assert page.evaluate("document.getElementById('stop').getBoundingClientRect().height") >= 44.0, width


def test_the_torque_by_stretch_has_its_band(page: Page) -> None:
    """The chart fills the area between the lower and the upper bound, and the value lies between them."""
    data, chart = "axes.get('knee').data['joint torque']", "axes.get('knee').charts['joint torque']"
    page.until(f"{data}[0].length > 3")
    labels = page.evaluate(f"{chart}.series.map((line) => line.label)")
    upper, lower = labels.index("tau_j_stretch, upper"), labels.index("tau_j_stretch, lower")
    assert [upper, lower] in page.evaluate(f"{chart}.bands.map((band) => band.series)")
    by_stretch = labels.index(SIGNALS["tau_j_stretch"].doc)
    low, value, high = (f"{data}[{place}].at(-1)" for place in (lower, by_stretch, upper))
    assert page.evaluate(f"{low} < {high} && {low} <= {value} && {value} <= {high}")


def test_daemon_that_is_gone_is_seen(page: Page, daemon: Played) -> None:
    """When the daemon ends, the page shows the phase "no daemon" and a message that no daemon answers."""
    daemon.end()
    page.until("document.getElementById('phase').textContent === 'no daemon'")
    page.until("document.getElementById('news').textContent.includes('no daemon answers')")
