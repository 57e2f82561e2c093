"""Test `tsa status`, `tsa set` and `tsa stop` with a socket server. The test takes the place of the loop."""

from __future__ import annotations

import io
import json
import os
import pty
import re
import select
import subprocess
import termios
import threading
from collections import deque
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from rich.console import Console

from tests.daemon.serving import PATIENCE, Serving, description, loop_taking
from tsa_ctrl.cli import cli, running
from tsa_ctrl.daemon.build import LoopPhase
from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.ipc.mailbox import RECOVER, Command, Mailbox
from tsa_ctrl.ipc.page import Page, sparkline
from tsa_ctrl.ipc.protocol import Recover, Set
from tsa_ctrl.ipc.report import status_report
from tsa_ctrl.system.process_supervisor import tsa

AXES = ["knee"]


def call(serving: Serving, *arguments: str) -> Result:
    return CliRunner().invoke(cli, [*arguments, "--socket", serving.path])


def test_status_is_one_json_object_or_a_page(serving: Serving) -> None:
    """The object has the documented keys. The page shows values, parameters and histograms."""
    status = json.loads(call(serving, "status", "--json").output)
    assert (status["schema"], status["faults"]) == (1, [])
    (knee,) = status["axes"]
    assert {"name", "state", "tau_j_des", "tau_m_cmd", "tau_m", "omega_j"} <= set(knee)
    assert (knee["state"], knee["tau_j"], knee["tau_j_model"]) == ("operation_enabled", None, None)
    assert knee["tau_j_stretch"] == {"value": 0.25, "low": 0.25, "high": 0.25, "unit": "N*m"}
    output = call(serving, "status").output
    for words in ("rig: running", "knee: operation_enabled", "tau_j_des", "compensation", "lateness", "p99"):
        assert words in output


def test_status_follows_with_an_object_on_each_line(serving: Serving) -> None:
    """With `--follow`, the command prints one JSON object per line until it is terminated."""
    arguments = ["status", "--json", "--follow", "--socket", serving.path]
    with subprocess.Popen(tsa(*arguments), stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        lines = [json.loads(process.stdout.readline()) for _ in range(3)]
        process.terminate()
    assert [line["schema"] for line in lines] == [1, 1, 1]
    assert lines[0]["age"] < lines[2]["age"]


def test_set_says_from_where_to_where(serving: Serving) -> None:
    """The command prints the old and the new value. The loop gets one command."""
    with loop_taking(serving) as taken:
        result = call(serving, "set", "compensation", "0.5")
        again = call(serving, "set", "knee.compensation=0.5")
    assert result.output == "knee.compensation: 0.95 -> 0.5\n"
    assert again.output.endswith(" -> 0.5\n")
    assert taken == [Command(0, 0, 0.5), Command(0, 0, 0.5)]


REJECTED = [  # arguments after the value 0.5, and the reason
    (("--against", "1.3"), "compensation 1.3 is out of bounds; allowed is 0 to 1.2"),
    (("--against", "0.5"), "A and B are the same"),
    (("--against", "0.9", "--with", "compensation=0.1,0.2"), "give each parameter once"),
    (("--against", "0.9", "--with", "slew=60"), "write NAME=A,B"),
    (("--against", "0.9", "--with", "slew=60,nan"), "write NAME=A,B"),
    (("--against", "0.9", "--with", "pretension=40,50"), "cannot be set"),
    (("--with", "slew=60,90"), "also give --against"),
]


def test_a_change_that_cannot_be_made_is_refused(serving: Serving) -> None:
    """The command is rejected with the reason. The only values set are the first one and the original one."""
    with loop_taking(serving) as taken:
        for arguments, words in REJECTED:
            result = call(serving, "set", "compensation", "0.5", *arguments)
            assert isinstance(result.exception, UsageError)
            assert words in str(result.exception)
        for given in (("nan",), ("inf",), ("0.5", "--against", "nan")):
            assert "is not a finite number" in call(serving, "set", "compensation", *given).output
        negative = call(serving, "set", "compensation", "-0.5")  # a value, not an option
        assert "out of bounds; allowed is 0 to 1.2" in str(negative.exception)
    assert {command.value for command in taken} <= {0.5, 0.95}  # set, then restored


def test_set_recover(serving: Serving, monkeypatch: pytest.MonkeyPatch) -> None:
    """`tsa set recover 1` requests a recovery if a fault is latched. Any other value is rejected."""
    monkeypatch.setattr(running, "HELD", 0.0)
    result = call(serving, "set", "recover", "1")
    assert "no fault is latched, the phase is running" in str(result.exception)
    serving.publish(LoopPhase.FAULTED)
    with loop_taking(serving) as taken:
        assert call(serving, "set", "recover", "1").exit_code == 0
    assert taken == [Command(0, RECOVER, 0.0)]
    assert isinstance(call(serving, "set", "recover", "0").exception, UsageError)


class Phases:
    """A client whose daemon reports these phases, one per answer. The last phase is repeated."""

    def __init__(self, *phases: str, failed: int = 0) -> None:
        self._phases = list(phases)
        self._failed = failed

    def __enter__(self) -> Phases:
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def ask(self, request: object) -> dict[str, object]:
        if isinstance(request, Recover):
            return {}
        failed = self._failed if len(self._phases) == 1 else 0
        phase = self._phases.pop(0) if len(self._phases) > 1 else self._phases[0]
        return {
            "phase": phase,
            "faults": [{"number": 0, "text": "over-speed"}],
            "events": [],
            "recovery": {"failed": failed},
        }


@pytest.mark.parametrize(
    ("phases", "failed", "seconds", "words"),
    [
        ("faulted starting running running faulted", 0, 60.0, "but stopped again, phase faulted: over-speed; remove"),
        ("faulted", 0, 0.3, "not recovered after 0.3 s, phase faulted: over-speed; remove the cause"),
        ("faulted resetting faulted", 1, 60.0, "the recovery failed, phase faulted: over-speed"),
    ],
)
def test_a_recovery_that_fails_or_does_not_last_is_told(
    phases: str, failed: int, seconds: float, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A rig with a torn tendon starts, but stops when it moves. The command waits for this and reports an error."""
    monkeypatch.setattr(running, "RECOVERY", seconds)
    monkeypatch.setattr(running, "Client", lambda path: Phases(*phases.split(), failed=failed))
    result = CliRunner().invoke(cli, ["set", "recover", "1"])
    assert isinstance(result.exception, BusError)
    assert words in str(result.exception)


def test_stop_asks_once_and_says_when_the_daemon_stays(serving: Serving) -> None:
    """A wrong waiting time is rejected before the request. A daemon that does not end in time is an error."""
    for wait in ("nan", "-1", "inf", "soon"):
        assert call(serving, "stop", "--wait", wait).exit_code == 2
    assert not serving.mailbox.stop_requested
    result = call(serving, "stop", "--wait", "0.2")
    assert serving.mailbox.stop_requested
    assert isinstance(result.exception, BusError)
    assert "still runs" in str(result.exception)
    assert call(serving, "stop", "--wait", "0").exit_code == 0


def test_stop_and_status_report_the_stage_of_the_startup(serving: Serving) -> None:
    """Before the first stage is published, the page shows a wait for the first cycle and not a hang."""
    stage = "waiting for the boot-up of axis 'knee' drive node 1, 60 s at most"
    serving.mailbox.publish_stage(0.0, stage)
    assert stage in " ".join(call(serving, "status").output.split())
    assert call(serving, "stop", "--wait", "0").output == f"stop requested; it was in startup: {stage}\n"
    fresh = Mailbox(1, 2)
    page = Page()
    page.take(status_report(fresh, description(Path(serving.path), ["knee"]), 1e6))
    console = Console(width=200, record=True, file=io.StringIO())
    console.print(page.render())
    text = console.export_text()
    assert "since 0.0 s: the first cycle" in text
    assert "no news" not in text
    fresh.close()


@pytest.mark.parametrize("verb", [["status", "--json"], ["set", "compensation", "1"], ["stop"]])
def test_without_a_daemon_exit_code_1(tmp_path: Path, verb: list[str]) -> None:
    """Without a daemon, the command ends with a BusError (exit code 1) and an empty stdout."""
    result = CliRunner().invoke(cli, [*verb, "--socket", str(tmp_path / "none.sock")])
    assert isinstance(result.exception, BusError)
    assert result.exception.exit_code == 1
    assert result.output == ""


def test_page_keys_move_the_chosen_parameter(serving: Serving) -> None:
    """The keys + and - change the value by a fiftieth of the range and stop at the bounds.

    Only parameters that can be set are listed. Where the range spans decades, a key changes the value by a tenth,
    because a fiftieth of the range would be larger than the value.
    """
    status = json.loads(call(serving, "status", "--json").output)
    page = Page()
    page.take(status)
    assert [name for _, name, _ in page.parameters()] == ["compensation"]
    assert page.key("j") is None
    assert page.key("-") == Set("knee.compensation", pytest.approx(0.926))
    status["axes"][0]["parameters"]["compensation"]["value"] = 1.2
    page.take(status)
    assert page.key("+") == Set("knee.compensation", 1.2)
    for low, high, value in ((1.0, 10_000.0, 120.0), (0.002, 10.0, 0.05)):
        status["axes"][0]["parameters"] = {"slew": {"value": value, "low": low, "high": high, "unit": "1"}}
        page.take(status)
        assert page.key("+") == Set("knee.slew", pytest.approx(1.1 * value))
        assert page.key("-") == Set("knee.slew", pytest.approx(0.9 * value))


def test_the_live_page_takes_keys_and_gives_the_terminal_back(serving: Serving) -> None:
    """On a pseudo-terminal, + changes the parameter and q ends the page. The terminal settings are then restored."""
    master, slave = pty.openpty()
    before = termios.tcgetattr(slave)
    shown = b""
    with loop_taking(serving) as taken:
        command = tsa("status", "--socket", serving.path)
        process = subprocess.Popen(command, stdin=slave, stdout=slave, env={**os.environ, "TERM": "xterm"})
        for words, key in ((b"q: leave", b"+"), (b"compensation: 0.95 -> 0.974", b"q")):
            while words not in shown:
                readable, _, _ = select.select([master], [], [], PATIENCE)
                assert readable, shown
                shown += os.read(master, 65536)
            os.write(master, key)
        drained = threading.Thread(target=_drain, args=(master, process), daemon=True)
        drained.start()
        assert process.wait(PATIENCE) == 0
        drained.join()
    assert taken == [Command(0, 0, pytest.approx(0.974))]  # type: ignore[arg-type]
    assert termios.tcgetattr(slave) == before
    os.close(master)
    os.close(slave)


def _drain(master: int, process: subprocess.Popen[bytes]) -> None:
    while process.poll() is None:
        if select.select([master], [], [], 0.05)[0]:
            os.read(master, 65536)


def test_sparkline_spans_the_extremes() -> None:
    """The lowest and the highest value get the lowest and the highest bar, and a missing value leaves a gap."""
    assert sparkline(deque([0.0, 1.0, float("nan"), 0.5])) == "▁█ ▅"
    assert sparkline(deque([float("nan")])) == ""


def test_a_narrow_terminal_shows_every_name_and_no_empty_past(
    serving: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Names and values are not truncated, with any number of parameters. Only a wide terminal shows the past."""
    status = json.loads(call(serving, "status", "--json").output)
    (axis,) = status["axes"]
    axis["omega_j"] = -12.3456
    figures = {"value": 1e4, "low": 1.0, "high": 1e6, "unit": "N*m/s"}
    axis["parameters"] |= dict.fromkeys(("slew", "direction_zone", "torque_limit"), figures)
    page = Page()
    page.take(status)
    for columns, past in ((60, False), (80, False), (120, True)):
        monkeypatch.setenv("COLUMNS", str(columns))
        console = Console(width=columns, record=True, file=io.StringIO())
        console.print(page.render())
        output = console.export_text()
        for word in ("tau_j_stretch", "friction_angle", "compensation", "direction_zone", "-12.3456", "1e+04 N*m/s"):
            assert word in output, columns
        assert ("past" in output) == past
        assert "…" not in output
        assert max(len(line) for line in output.splitlines() if "│" in line) <= columns
        assert not re.search(r"[\d.] +1 ", output), "a pure number's unit"
