"""Serve the dashboard page on the loopback interface, with a token for every request.

GET / returns the page. GET /events streams the status (message) and the measurements of the newest cycle ("sample") as
server-sent events. POST /set {"name", "value"}, /stop and /recover are commands. The token is part of the page's
address and of each request. Requests whose Host or Origin is not this server are rejected.

Stop requests have separate threads. All pages share one poll of the daemon, and static files are sent from memory. A
new connection replaces the one that has been idle longest. As a result, a stop request is answered under any load of
other requests.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import mimetypes
import secrets
import socket
import threading
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, ClassVar

import msgspec
import uvicorn
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.ipc.client import Client, stop_daemon
from tsa_ctrl.ipc.protocol import STATUS_RATE, Measure, Recover, Set, Status
from tsa_ctrl.signals import BANDED, Kind, Place, signals_of

TIMEOUT = 2.0  # s for an answer
STOP_TIMEOUT = 0.5  # s; a working server answers within milliseconds, later the daemon gets SIGTERM


class Feed:
    """Pass the page's requests to the daemon over its local socket, which cannot delay the loop. Thread-safe.

    A lost connection is opened again at the next request.
    """

    def __init__(self, path: str) -> None:
        self.path = path
        self._client: Client | None = None
        self._lock = threading.Lock()

    def status(self) -> dict[str, Any]:
        """Return the daemon's status, or {"error": ...} if the daemon does not answer or rejects the request."""
        try:
            return self.ask(Status())
        except (BusError, UsageError) as error:
            return {"error": str(error)}

    def measure(self) -> dict[str, Any] | None:
        """Return the measurements of the newest cycle, or None without a cycle or without an answer."""
        try:
            sample = self.ask(Measure())
        except (BusError, UsageError):
            return None
        return sample if sample["cycle"] else None

    def stop(self) -> dict[str, Any]:
        """Ramp the torque to 0 and end the daemon, over a separate connection; see `Client.stop`.

        Raises:
            UsageError: This user may not stop the daemon.
            BusError: Neither the socket nor the process could be reached.
        """
        return stop_daemon(self.path, STOP_TIMEOUT)

    def close(self) -> None:
        with self._lock:
            self._drop()

    def ask(self, request: Status | Measure | Set | Recover) -> dict[str, Any]:
        """Return the daemon's answer. Raises UsageError if it rejects the request, BusError without an answer."""
        with self._lock:
            try:
                if self._client is None:
                    self._client = Client(self.path, TIMEOUT)
                return self._client.ask(request)
            except BusError:
                self._drop()
                raise

    def _drop(self) -> None:
        if self._client is not None:
            with contextlib.suppress(OSError):
                self._client.__exit__(None, None, None)
            self._client = None


STATIC = Path(__file__).parent / "static"
RATE = 100.0  # Hz of the measurements, twice the minimum for a plot of human motion
LOOPBACK = "127.0.0.1"
MOST_BODY = 1024  # bytes of a request
MOST = 64  # connections at once; a browser keeps six to one server
FRESH = 1.0  # s after its start in which a connection without a request is not replaced
CEILING = 256  # connections at once, including new ones
STOPPING = 8  # threads for stop requests
ASK_TIME = 5.0  # s within which a connection must send a request
HEADERS = {
    "Content-Security-Policy": (
        "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}


class Bounded(H11Protocol):
    """The protocol of uvicorn with a limited number of connections: a new one replaces the one idle longest.

    A connection that sends no request within ASK_TIME is closed. A connection is idle if none of its requests is being
    answered.
    """

    open: ClassVar[dict[Bounded, float]] = {}  # s, time of the last received data

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Register the connection, and close another one if there are too many."""
        super().connection_made(transport)
        now = self.loop.time()
        if len(self.open) >= MOST:
            idle = [one for one, since in self.open.items() if not one._answering() and one._spent(now - since)]
            oldest = min(
                idle or (self.open if len(self.open) >= CEILING else ()), key=self.open.__getitem__, default=None
            )
            if oldest is not None:
                del self.open[oldest]
                oldest.transport.abort()
        self.open[self] = now
        self.loop.call_later(ASK_TIME, self._give_up)

    def connection_lost(self, exc: Exception | None) -> None:
        """Release the connection's place."""
        self.open.pop(self, None)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Store the time at which data was received."""
        if self in self.open:
            self.open[self] = self.loop.time()
        super().data_received(data)

    def _answering(self) -> bool:
        """Return True while a request is being answered."""
        cycle = getattr(self, "cycle", None)
        return cycle is not None and not cycle.response_complete

    def _spent(self, age: float) -> bool:
        """Return True if the connection has sent a request, or is older than FRESH; `age` in s."""
        return getattr(self, "cycle", None) is not None or age > FRESH

    def _give_up(self) -> None:
        begun = getattr(self, "cycle", None) is not None  # the header of a request is complete
        if not begun and not self.transport.is_closing():
            self.transport.close()


class Guard:
    """Reject requests that do not come from this server's page with its token."""

    def __init__(self, app: ASGIApp, token: str, hosts: frozenset[str]) -> None:
        self._app = app
        self._token = token
        self._hosts = hosts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request = Request(scope)
        origin = request.headers.get("origin")
        if request.headers.get("host") not in self._hosts:
            refusal = "another host"
        elif origin is not None and origin.removeprefix("http://") not in self._hosts:
            refusal = "another page"
        elif not scope["path"].startswith("/static/") and not self._knows(request):
            refusal = "no token: open the address that `tsa dashboard` printed"
        else:
            await self._app(scope, receive, send)
            return
        await PlainTextResponse(refusal, 403, HEADERS)(scope, receive, send)

    def _knows(self, request: Request) -> bool:
        try:
            asked = "" if request.method == "POST" else request.query_params.get("token")
        except UnicodeDecodeError:  # no address of this server contains these bytes
            return False
        given = request.headers.get("x-token") or asked
        return secrets.compare_digest((given or "").encode(), self._token.encode())


def signals_shown() -> list[dict[str, Any]]:
    """Return the signals of an axis on the page, each with its chart and with True if it has a band."""
    ends = {f"{name}_{end}" for name in BANDED for end in ("low", "high")}
    return [
        {
            "name": signal.name,
            "unit": signal.unit,
            "doc": signal.doc,
            "chart": signal.chart,
            "band": signal.name in BANDED,
        }
        for signal in signals_of(Place.STATUS)
        if signal.kind is not Kind.AGE and signal.name not in ends
    ]


def application(feed: Feed, token: str, port: int) -> Starlette:
    """Return the application that serves the page and its requests."""

    files = {path.name: path.read_bytes() for path in STATIC.iterdir()}
    shown = json.dumps(signals_shown()).replace("<", "\\u003c").encode()
    home = files["index.html"].replace(b"SIGNALS", shown)
    poll = Poll(feed)

    async def page(request: Request) -> Response:
        return HTMLResponse(home, headers=HEADERS)

    async def static(request: Request) -> Response:
        name = request.path_params["name"]
        if name not in files:
            return PlainTextResponse("no such file", 404, HEADERS)
        return Response(files[name], media_type=mimetypes.guess_type(name)[0], headers=HEADERS)

    async def events(request: Request) -> Response:
        return StreamingResponse(_events(poll, request), media_type="text/event-stream", headers=HEADERS)

    async def change(request: Request) -> Response:
        try:
            wanted = await _change(request)
        except UsageError as error:
            return JSONResponse({"error": str(error)}, 400)
        return await _answered(run_in_threadpool(feed.ask, wanted), 400)

    stopping = ThreadPoolExecutor(STOPPING)

    async def stop(request: Request) -> Response:
        return await _answered(asyncio.get_running_loop().run_in_executor(stopping, feed.stop), 403)

    async def recover(request: Request) -> Response:
        return await _answered(run_in_threadpool(feed.ask, Recover()), 400)

    hosts = frozenset({f"{LOOPBACK}:{port}", f"localhost:{port}"})
    return Starlette(
        routes=[
            Route("/", page),
            Route("/events", events),
            Route("/set", change, methods=["POST"]),
            Route("/stop", stop, methods=["POST"]),
            Route("/recover", recover, methods=["POST"]),
            Route("/static/{name}", static),
        ],
        middleware=[Middleware(Guard, token=token, hosts=hosts)],
    )


async def _answered(asked: Awaitable[dict[str, Any]], rejected: int) -> Response:
    """Return the daemon's answer, or its error with the status `rejected`, or 503 without an answer."""
    try:
        return JSONResponse(await asked)
    except UsageError as error:
        return JSONResponse({"error": str(error)}, rejected)
    except BusError as error:
        return JSONResponse({"error": str(error)}, 503)


class _Change(msgspec.Struct):
    """Body of a request to change a parameter."""

    name: str
    value: float


async def _change(request: Request) -> Set:
    """Return the change that a request describes; raise UsageError if it is too long or describes none."""
    data = b""
    async for part in request.stream():
        data += part
        if len(data) > MOST_BODY:
            raise UsageError(f"the request is longer than {MOST_BODY} bytes")
    try:
        change = msgspec.json.decode(data, type=_Change)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise UsageError(f'not a change: {error}; send {{"name": "knee.compensation", "value": 0.9}}') from None
    return Set(change.name, change.value)


class Poll:
    """Newest measurements and status as server-sent events. All pages share the requests to the daemon."""

    def __init__(self, feed: Feed) -> None:
        self._feed = feed
        self._asking: asyncio.Task[None] | None = None
        self._asked = self._status_asked = -math.inf  # s, times of the last requests
        self._sample = self._status = ""
        self._number = 0  # number of the status

    async def newest(self, seen: int) -> tuple[str, int]:
        """Return the events and the number of their status; a status with a number up to `seen` is omitted.

        The measurements are at most 1 / RATE old, unless the daemon is slower.
        """
        now = time.monotonic()
        if self._asking is None or (self._asking.done() and now - self._asked >= 1.0 / RATE):
            self._asked = now
            self._asking = asyncio.ensure_future(run_in_threadpool(self._ask, now))
        await asyncio.shield(self._asking)
        return (self._status if self._number > seen else "") + self._sample, self._number

    def _ask(self, now: float) -> None:
        if now - self._status_asked >= 1.0 / STATUS_RATE - 0.5 / RATE:  # the poll nearest to the due time
            self._status_asked = now
            self._status = f"data: {json.dumps(self._feed.status(), allow_nan=False)}\n\n"
            self._number += 1
        sample = self._feed.measure()
        self._sample = f"event: sample\ndata: {json.dumps(sample, allow_nan=False)}\n\n" if sample else ""


async def _events(poll: Poll, request: Request) -> AsyncIterator[str]:
    """Yield the newest measurements and status until the page is closed."""
    seen = 0
    while not await request.is_disconnected():
        text, seen = await poll.newest(seen)
        if text:
            yield text
        await asyncio.sleep(1.0 / RATE)


def serve(path: str, port: int, say: Callable[[str], None]) -> None:
    """Serve until SIGINT or SIGTERM; `say` receives the address. Raises UsageError if the port is taken."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((LOOPBACK, port))
    except OSError as error:
        listener.close()
        raise UsageError(
            f"--port {port}: cannot listen there ({error.strerror}); leave it out for a free one"
        ) from None
    number = int(listener.getsockname()[1])
    token = secrets.token_urlsafe(24)
    feed = Feed(path)
    config = uvicorn.Config(
        application(feed, token, number),
        log_level="error",
        lifespan="off",
        timeout_graceful_shutdown=1,
        ws="none",
        http=Bounded,
    )
    server = uvicorn.Server(config)
    startup: Callable[..., Awaitable[None]] = server.startup

    async def started(sockets: list[socket.socket] | None = None) -> None:
        await startup(sockets=sockets)
        say(f"http://{LOOPBACK}:{number}/?token={token}")

    server.startup = started  # type: ignore[method-assign]
    try:
        server.run(sockets=[listener])
    finally:
        feed.close()
        listener.close()
