"""Test the server of the page: its answers and its access control."""

from __future__ import annotations

import asyncio
import contextlib
import http.client
import queue
import signal
import socket
import subprocess
import sys
import threading
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import cast

import pytest
from starlette.testclient import TestClient

from tests.daemon.serving import until
from tests.dashboard.playing import Played, played
from tsa_ctrl.dashboard import server
from tsa_ctrl.dashboard.server import Feed, application, serve
from tsa_ctrl.errors import UsageError
from tsa_ctrl.ipc import server_process
from tsa_ctrl.ipc.client import Client
from tsa_ctrl.ipc.connection import CLIENTS
from tsa_ctrl.ipc.mailbox import RECOVER, Command

TOKEN, PORT = "secret-of-the-test", 8402
ALLOWED = {"x-token": TOKEN}


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[Played]:
    with played(tmp_path / "tsa.sock") as made:
        yield made


@pytest.fixture
def client(daemon: Played) -> Iterator[TestClient]:
    feed = Feed(daemon.path)
    yield TestClient(application(feed, TOKEN, PORT), base_url=f"http://127.0.0.1:{PORT}")
    feed.close()


def test_page_needs_its_token(client: TestClient) -> None:
    """The server returns the page with the right token, and status 403 without a token or with a wrong one."""
    assert "<title>tsa</title>" in client.get("/", params={"token": TOKEN}).text
    for given in ({}, {"token": ""}, {"token": TOKEN + "x"}, {"token": "ä"}):
        assert client.get("/", params=given).status_code == 403


def test_requests_need_the_token_in_their_head_and_the_host_and_origin_of_the_page(
    client: TestClient, daemon: Played
) -> None:
    """A token in the address is not sufficient for a request, because a form of another page could send it.

    A request with a foreign host name (DNS rebinding) or origin is rejected, even with the right token.
    """
    body = {"name": "knee.compensation", "value": 0.5}
    for path in ("/set", "/stop", "/recover"):
        assert client.post(path, json=body).status_code == 403
        assert client.post(path, json=body, params={"token": TOKEN}).status_code == 403
        for head in (
            {"host": "evil.example"},
            {"host": "127.0.0.1:1"},
            {"origin": "http://evil.example"},
            {"origin": "null"},
        ):
            assert client.post(path, json=body, headers=ALLOWED | head).status_code == 403
    assert (daemon.taken, daemon.serving.mailbox.stop_requested) == ([], False)


def test_set_and_stop_reach_the_daemon(client: TestClient, daemon: Played) -> None:
    """The answer contains the previous value. A stop request sets the stop flag in the mailbox, like `tsa stop`."""
    answer = client.post("/set", json={"name": "knee.compensation", "value": 0.5}, headers=ALLOWED)
    assert (answer.status_code, answer.json()["before"], answer.json()["value"]) == (200, 0.95, 0.5)
    assert daemon.taken == [Command(0, 0, 0.5)]
    assert client.post("/stop", headers=ALLOWED).status_code == 200
    assert daemon.serving.mailbox.stop_requested


NONSENSE = [
    (b'{"name":"knee.compensation","value":7}', "out of bounds; allowed is 0 to 1.2"),
    (b'{"name":"knee.nothing","value":1}', "no parameter"),
    (b'{"name":"recover","value":1}', "give the axis"),
    (b'{"name":"knee.compensation","value":true}', "not a change"),
    (b'{"name":"knee.compensation","value":NaN}', "not a change"),
    (b'{"name":"knee.compensation","value":' + b"9" * 400 + b"}", "not a change"),
    (b'{"name":7,"value":1}', "not a change"),
    (b"x" * 2000, "longer"),
    (b"\xff", "not a change"),
    (b'{"x":' + b"[" * 1000, "not a change"),
]


def test_nonsense_is_refused_in_words(client: TestClient, daemon: Played) -> None:
    """An invalid request gets status 400 and a message. No command reaches the loop."""
    for body, words in NONSENSE:
        answer = client.post("/set", content=body, headers=ALLOWED)
        assert (answer.status_code, words in answer.json()["error"]) == (400, True), body
    assert daemon.taken == []


def test_recover_reaches_the_daemon(client: TestClient, daemon: Played) -> None:
    assert client.post("/recover").status_code == 403
    assert "no fault is latched" in client.post("/recover", headers=ALLOWED).json()["error"]
    daemon.fail("stale PDO")
    assert until(lambda: bool(Feed(daemon.path).status()["phase"] == "faulted"))
    assert client.post("/recover", headers=ALLOWED).status_code == 200
    assert daemon.taken == [Command(0, RECOVER, 0.0)]


def test_stop_ends_a_daemon_whose_socket_does_not_answer(tmp_path: Path) -> None:
    """The daemon is stopped by a signal to its process. Without a known process the request fails with status 503."""
    path = str(tmp_path / "tsa.sock")
    client = TestClient(application(Feed(path), TOKEN, PORT), base_url=f"http://127.0.0.1:{PORT}")
    assert client.post("/stop", headers=ALLOWED).status_code == 503
    process = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    server_process.write(path, process.pid)
    answer = client.post("/stop", headers=ALLOWED).json()
    assert (answer["signalled"], "no daemon answers there" in answer["reason"]) == (process.pid, True)
    assert process.wait(30) == -signal.SIGTERM


def test_a_stop_that_the_daemon_rejects_is_an_answer_and_not_a_failure(
    client: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    def rejected(path: str, timeout: float) -> None:
        raise UsageError("daemon: stop: user 12345 may only watch here")

    monkeypatch.setattr("tsa_ctrl.dashboard.server.stop_daemon", rejected)
    answer = client.post("/stop", headers=ALLOWED)
    assert (answer.status_code, "may only watch" in answer.json()["error"]) == (403, True)


class Counting:
    """A daemon that counts its requests and answers each measurement request with the next cycle number."""

    def __init__(self) -> None:
        self.asked = [0, 0]  # numbers of requests for status and measurements

    def status(self) -> dict[str, object]:
        self.asked[0] += 1
        return {"schema": 1}

    def measure(self) -> dict[str, object]:
        self.asked[1] += 1
        return {"cycle": self.asked[1]}


def test_pages_share_one_request_to_the_daemon() -> None:
    """Forty simultaneous pages cause only one status request and one measurement request to the daemon."""
    daemon = Counting()

    async def ask() -> list[tuple[str, int]]:
        poll = server.Poll(cast(Feed, daemon))
        return await asyncio.gather(*(poll.newest(0) for _ in range(40)))

    text = 'data: {"schema": 1}\n\nevent: sample\ndata: {"cycle": 1}\n\n'
    assert set(asyncio.run(ask())) == {(text, 1)}
    assert daemon.asked == [1, 1]


def test_each_event_of_a_page_has_a_new_measurement_and_each_status_comes_once() -> None:
    daemon = Counting()

    async def follow() -> list[str]:
        poll, seen, texts = server.Poll(cast(Feed, daemon)), 0, []
        for _ in range(60):
            text, seen = await poll.newest(seen)
            texts.append(text)
            await asyncio.sleep(1.0 / server.RATE)
        return texts

    texts = asyncio.run(follow())
    assert server.RATE >= 50.0
    assert len({text.rpartition("data: ")[2] for text in texts}) > 50
    assert sum('"schema"' in text for text in texts) == daemon.asked[0] > 20


@pytest.mark.slow
def test_stop_is_answered_while_forty_clients_fetch_files(daemon: Played) -> None:
    """Half of the clients connect for each request, the others keep the connection. Some read the status stream."""
    address = served(daemon.path)
    port, token = int(address.split(":")[2].split("/")[0]), address.split("token=")[1]
    done = threading.Event()

    def fetch(number: int) -> None:
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
        while not done.is_set():
            with contextlib.suppress(OSError, http.client.HTTPException):
                if number % 8 == 0:
                    connection.request("GET", f"/events?token={token}")
                    connection.getresponse().read(4096)
                else:
                    connection.request("GET", "/static/uPlot.iife.min.js")
                    connection.getresponse().read()
            if number % 2 == 0:
                connection.close()
        connection.close()

    clients = [threading.Thread(target=fetch, args=(number,)) for number in range(40)]
    for one in clients:
        one.start()
    statuses = []
    for _ in range(18):
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
        connection.request("POST", "/stop", headers=ALLOWED | {"x-token": token})
        statuses.append(connection.getresponse().status)
        connection.close()
    done.set()
    for one in clients:
        one.join()
    assert statuses == [200] * 18
    assert daemon.serving.mailbox.stop_requested


def test_a_daemon_that_ends_is_said(client: TestClient, daemon: Played) -> None:
    """After the daemon has ended, requests get status 503, and the page server continues."""
    daemon.end()
    answer = client.post("/set", json={"name": "knee.compensation", "value": 0.5}, headers=ALLOWED)
    assert (answer.status_code, "daemon" in answer.json()["error"]) == (503, True)
    assert "error" in Feed(daemon.path).status()


def test_a_rejected_status_request_is_an_error_of_the_page(daemon: Played) -> None:
    """The daemon closes the connection that has been silent longest, with a rejection. The page connects again."""
    feed = Feed(daemon.path)
    assert feed.status()["schema"] == 1
    with contextlib.ExitStack() as others:
        for _ in range(CLIENTS):
            others.enter_context(Client(daemon.path)).measure()
        assert "others are open" in feed.status()["error"]
        assert until(lambda: feed.status().get("schema") == 1)
    feed.close()


def test_what_is_served_asks_for_nothing_from_elsewhere(client: TestClient) -> None:
    """The content security policy allows only the server itself, and no served file contains a foreign address.

    A path outside the folder of static files is rejected.
    """
    head = client.get("/", params={"token": TOKEN}).headers
    assert head["content-security-policy"].startswith("default-src 'self'")
    for name in ("app.js", "style.css", "uPlot.iife.min.js", "uPlot.min.css"):
        text = client.get(f"/static/{name}").text
        assert "http://" not in text.replace("http://www.w3.org", "")
    assert client.get("/static/../server.py").status_code in (403, 404)
    assert client.get("/static/%2e%2e/server.py").status_code == 404


def served(path: str) -> str:
    """Serve the page in a thread, and return its address."""
    addresses: queue.Queue[str] = queue.Queue()
    threading.Thread(target=serve, args=(path, 0, addresses.put), daemon=True).start()
    return addresses.get(timeout=30)


def test_half_open_connections_are_bounded_and_closed(daemon: Played, monkeypatch: pytest.MonkeyPatch) -> None:
    """With four hundred silent connections the page is soon served again, and the server closes all of them."""
    monkeypatch.setattr(server, "ASK_TIME", 0.3)
    address = served(daemon.path)
    port = int(address.split(":")[2].split("/")[0])
    silent = [socket.create_connection(("127.0.0.1", port)) for _ in range(400)]
    assert until(lambda: _answers(address))
    for connection in silent:
        connection.settimeout(30)
        with contextlib.suppress(ConnectionResetError):
            assert connection.recv(1) == b""  # closed by the server
        connection.close()


def _answers(address: str) -> bool:
    try:
        with urllib.request.urlopen(address, timeout=5) as answer:
            return b"<title>tsa</title>" in answer.read()
    except OSError:
        return False


def test_port_that_is_taken_is_one_line() -> None:
    """The error for a port in use includes the remedy."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(UsageError, match="leave it out for a free one"):
            serve("/nowhere", taken.getsockname()[1], print)
