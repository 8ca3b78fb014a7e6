"""Serves the pages of screens and of the operator, on a thread of its own. Nothing but these pages' files is served."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import json
import os
import socket
import threading
import time
from collections.abc import Awaitable, Callable
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any

import uvicorn
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    StringConstraints,
    TypeAdapter,
    ValidationError,
)
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from labkit.devices.protocols import PanelInfo
from labkit.drivers.web.access import HEADERS, Connection, Guard, kept_token
from labkit.drivers.web.monitor import Monitor
from labkit.drivers.web.open_pages import note
from labkit.drivers.web.screen import Report, Screen
from labkit.errors import DisplayError, PlanError
from labkit.storage.files import state_folder

SERVER_START_S = SERVER_STOP_S = 10.0
SEND_S = PONG_S = 10.0
"""Longest time for a page to accept a message or answer a ping; then its connection is closed, and the page reconnects."""

PING_S = 5.0

MOST_MESSAGE_BYTES = 2048
"""Of a message from a page, and (eight times as many) of a request's head."""

MOST_REFUSED_BYTES = 32 * MOST_MESSAGE_BYTES
"""Of a message refused: past this, uvicorn drops the connection before a page can have read why."""

MOST_MONITORS = 32
AT_MOST_EVERY_S, AT_LEAST_EVERY_S = 0.2, 2.0
"""Intervals of updates to the operator's page, and of heartbeats to every page."""

TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
}
SERVER_GONE = 4000
TAKEN_OVER = 4001
CROWDED = 4002
NOT_UNDERSTOOD = 4003
TOO_LONG = 1009
"""RFC 6455, section 7.4.1."""


class Press(BaseModel):
    """A button of the operator's page."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    do: Annotated[str, StringConstraints(max_length=40)]


class Answer(BaseModel):
    """An answer to the question of a number, limited to text that a terminal would take."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    answer: Annotated[int, Field(ge=0, le=2**53)]
    text: Annotated[str, StringConstraints(pattern=r"^[ -~]{0,24}$")]


PRESS_OR_ANSWER: TypeAdapter[Press | Answer] = TypeAdapter(Press | Answer)


@cache
def page_files() -> dict[str, bytes]:
    """Return every served file, by name."""
    return {
        entry.name: entry.read_bytes()
        for entry in (files("labkit.targets") / "web").iterdir()
    }


class WebServer:
    """Listens on one address: screens, which come and go, and the operator's page of `monitor`."""

    def __init__(self, host: str, port: int, monitor: Monitor) -> None:
        """Bind the address. Raises DisplayError if this fails."""
        self._socket = _listen(host, port)
        self._host, self.port = host, self._socket.getsockname()[1]
        self.token = kept_token(state_folder())
        self.screens: dict[str, Screen] = {}
        self.monitor = monitor
        self._monitors = 0
        self._noted: Path | None = None
        self._server = uvicorn.Server(
            uvicorn.Config(
                Guard(self._app(), self.token),
                loop="asyncio",
                http=Connection,
                ws="websockets-sansio",
                ws_max_size=MOST_REFUSED_BYTES,
                ws_ping_interval=PING_S,
                ws_ping_timeout=PONG_S,
                ws_per_message_deflate=False,
                lifespan="off",
                log_config=None,
                log_level="critical",
                access_log=False,
                proxy_headers=False,
                server_header=False,
                h11_max_incomplete_event_size=8 * MOST_MESSAGE_BYTES,
                timeout_keep_alive=5,
                timeout_graceful_shutdown=1,
            )
        )
        self._thread = threading.Thread(target=self._run, name="labkit-web", daemon=True)

    def start(self) -> None:
        """Serve. Raises DisplayError if the server does not start."""
        self._thread.start()
        deadline = time.monotonic() + SERVER_START_S
        while not self._server.started:
            if time.monotonic() > deadline or not self._thread.is_alive():
                self.close()
                raise DisplayError(
                    f"the web server on port {self.port} did not start within {SERVER_START_S:g} s"
                )
            time.sleep(0.01)
        self._noted = note(self.url("monitor"), f"web://{self._host}:{self.port}")

    def close(self) -> None:
        """Stop serving; pages go black and wait for the next time."""
        if self._monitors:
            time.sleep(2 * AT_MOST_EVERY_S)  # for the last news to get out
        if self._noted is not None:
            with contextlib.suppress(OSError):
                self._noted.unlink()
        self._server.should_exit = True
        if self._thread.is_alive():
            self._thread.join(SERVER_STOP_S)
        self._socket.close()

    def url(self, page: str) -> str:
        """Return the address of a page for other machines."""
        return f"http://{reachable(self._host)}:{self.port}/{self.token}/{page}"

    def add_screen(self, name: str, panel: PanelInfo) -> Screen:
        """Add a screen of a name. Raises PlanError if the name exists."""
        if name in self.screens:
            raise PlanError(
                f'two displays are called "{name}": end their addresses in different names'
            )
        self.screens[name] = Screen(name, panel, self.url(name))
        return self.screens[name]

    def remove_screen(self, name: str) -> None:
        """Take a screen away; its page goes black."""
        self.screens.pop(name).dismiss()

    def _run(self) -> None:
        self._server.run(sockets=[self._socket])

    def _app(self) -> Starlette:
        app = Starlette(
            routes=[
                Route("/page/{file}", self._file, methods=["GET"]),
                Route("/monitor", self._monitor_page, methods=["GET"]),
                Route("/monitor/frame", self._frame, methods=["GET"]),
                WebSocketRoute("/monitor/socket", self._monitor_socket),
                Route("/{screen}", self._screen_page, methods=["GET"]),
                Route("/{screen}/picture", self._picture, methods=["GET"]),
                WebSocketRoute("/{screen}/socket", self._screen_socket),
            ],
        )
        app.router.redirect_slashes = False
        return app

    async def _file(self, request: Request) -> Response:
        name = request.path_params["file"]
        return _answer(page_files().get(name), TYPES.get(Path(name).suffix, ""))

    async def _monitor_page(self, request: Request) -> Response:
        return _answer(page_files()["monitor.html"], TYPES[".html"])

    async def _frame(self, request: Request) -> Response:
        return _answer(self.monitor.preview or None, "image/jpeg")

    async def _screen_page(self, request: Request) -> Response:
        known = request.path_params["screen"] in self.screens
        return _answer(page_files()["display.html"] if known else None, TYPES[".html"])

    async def _picture(self, request: Request) -> Response:
        screen = self.screens.get(request.path_params["screen"])
        order = screen.order if screen else None
        return _answer(order.png if order else None, "image/png")

    async def _screen_socket(self, socket: WebSocket) -> None:
        screen = self.screens.get(socket.path_params["screen"])
        if screen is None:
            await socket.close()
            return
        await socket.accept()
        wake = _Alarm()
        screen.open(socket, wake.ring)

        def hear(text: str) -> None:
            screen.hear(socket, Report.model_validate_json(text))

        def message() -> dict[str, Any] | int:
            if screen.holds(socket):
                return _message(screen)
            return TAKEN_OVER if self.screens.get(screen.name) is screen else SERVER_GONE

        try:
            await _converse(socket, hear, message, wake, 0.0)
        finally:
            screen.leave(socket)

    async def _monitor_socket(self, socket: WebSocket) -> None:
        await socket.accept()
        if self._monitors >= MOST_MONITORS:
            await socket.close(CROWDED)
            return
        self._monitors += 1
        wake = _Alarm()
        self.monitor.listen(socket, wake.ring)

        def hear(text: str) -> None:
            match PRESS_OR_ANSWER.validate_json(text):
                case Press(do=what):
                    self.monitor.act(what)
                case Answer(answer=number, text=words):
                    self.monitor.answer(number, words)

        try:
            await _converse(socket, hear, self._overview, wake, AT_MOST_EVERY_S)
        finally:
            self.monitor.unlisten(socket)
            self._monitors -= 1

    def _overview(self) -> dict[str, Any]:
        displays = [
            {
                "name": name,
                "url": screen.url,
                "problem": screen.problem,
                "pixels": list(screen.panel.pixels),
            }
            for name, screen in tuple(self.screens.items())
        ]
        return {**self.monitor.snapshot(), "displays": displays}


class _Alarm:
    """Wakes one task of the server's loop, from any thread."""

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._event = asyncio.Event()

    def ring(self) -> None:
        with contextlib.suppress(RuntimeError):  # the server has stopped
            self._loop.call_soon_threadsafe(self._event.set)

    async def wait(self, at_most_s: float) -> None:
        try:
            async with asyncio.timeout(at_most_s):
                await self._event.wait()
        except TimeoutError:
            pass
        self._event.clear()


async def _converse(
    socket: WebSocket,
    hear: Callable[[str], None],
    message: Callable[[], dict[str, Any] | int],
    wake: _Alarm,
    pause_s: float,
) -> None:
    """Receive a page's messages and send changes, until it leaves, or `message` gives a closing code."""
    listener = asyncio.create_task(_listen_to(socket, hear))
    sent: dict[str, Any] | None = None
    sent_at = 0.0
    try:
        while not listener.done():
            news = message()
            if isinstance(news, int):
                await _within(socket.close(news))
                return
            if news != sent or time.monotonic() - sent_at > AT_LEAST_EVERY_S:
                await _within(socket.send_text(json.dumps(news)))
                sent = news
                sent_at = time.monotonic()
                await asyncio.sleep(pause_s)
            await wake.wait(0.5)
    except (WebSocketDisconnect, TimeoutError, RuntimeError):
        pass  # gone, or too slow
    finally:
        listener.cancel()


async def _listen_to(socket: WebSocket, hear: Callable[[str], None]) -> None:
    try:
        while len(text := await socket.receive_text()) <= MOST_MESSAGE_BYTES:
            hear(text)
        await _within(socket.close(TOO_LONG))
    except (ValidationError, KeyError):
        await _within(socket.close(NOT_UNDERSTOOD))
    except (WebSocketDisconnect, TimeoutError, RuntimeError):
        pass


async def _within(step: Awaitable[None]) -> None:
    await asyncio.wait_for(step, SEND_S)


def _message(screen: Screen) -> dict[str, Any]:
    """Return the message to a screen's page."""
    return {
        "name": screen.name,
        "panel": list(screen.panel.pixels),
        "picture": screen.order.number if screen.order else None,
        "problem": screen.problem if screen.report else None,
        "ask": screen.asked,
    }


def _answer(content: bytes | None, kind: str) -> Response:
    if content is None:
        return Response(status_code=404, headers=HEADERS)
    return Response(content, media_type=kind, headers=HEADERS)


def _listen(host: str, port: int) -> socket.socket:
    try:
        family, _, _, _, where = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        listener = socket.create_server(where[:2], family=family, backlog=256)
    except OSError as error:
        elsewhere = isinstance(error, socket.gaierror) or error.errno == errno.EADDRNOTAVAIL
        why = (
            os.strerror(error.errno)
            if error.errno and error.errno in errno.errorcode
            else error
        )
        do = (
            "this machine has no such address: give 0.0.0.0 for all that it has"
            if elsewhere
            else "give another port"
        )
        raise DisplayError(f"cannot listen on {host} port {port}: {why}; {do}") from error
    listener.setblocking(False)
    return listener


def reachable(host: str) -> str:
    """Return an address for a URL; for a server on all addresses, the one that other machines reach."""
    if host not in ("0.0.0.0", "::", ""):
        return f"[{host}]" if ":" in host else host
    six = host == "::"
    with socket.socket(
        socket.AF_INET6 if six else socket.AF_INET, socket.SOCK_DGRAM
    ) as probe:
        try:
            # sends nothing: only the route is looked up (test addresses of RFC 3849 and 5737)
            probe.connect(("2001:db8::1" if six else "192.0.2.1", 9))
            address = str(probe.getsockname()[0])
            return f"[{address}]" if six else address
        except OSError:
            return socket.gethostname()
