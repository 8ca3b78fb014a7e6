"""Access to the pages: the token, the Host and the Origin of every request, and silent connections.

A connection is unknown until it shows the token. Unknown connections are closed after a few
seconds, and the oldest at once when there are many, so a flood of them costs the bench's
own pages nothing.
"""

from __future__ import annotations

import asyncio
import hmac
import socket
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from labkit.storage.files import kept_secret

UNKNOWN_CONNECTION_S = 5.0
MOST_UNKNOWN_CONNECTIONS = 128
LET_IN = "labkit.let_in"

HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


def kept_token(folder: Path) -> str:
    """Return the token of this user on this machine: constant from run to run, so that open pages reconnect."""
    return kept_secret(folder / "web-token")


class Guard:
    """Passes a request to `app`, its path without the token, or answers that there is nothing."""

    def __init__(self, app: ASGIApp, token: str) -> None:
        self._app = app
        self._token = token.encode()
        name = socket.gethostname().lower()
        self._names = {name, f"{name}.local"}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle an ASGI connection."""
        if rest := self._admitted(scope):
            scope[LET_IN] = True
            await self._app({**scope, "path": rest}, receive, send)
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008})
        else:
            headers = [(b"content-length", b"0"), (b"connection", b"close")]
            await send({"type": "http.response.start", "status": 404, "headers": headers})
            await send({"type": "http.response.body", "body": b""})

    def _admitted(self, scope: Scope) -> str | None:
        """Return the path after the token for an admitted request, else None."""
        headers: dict[bytes, bytes] = dict(scope["headers"])
        host = headers.get(b"host", b"").decode("latin-1")
        origin = headers.get(b"origin")
        given, _, rest = scope["path"].removeprefix("/").partition("/")
        right = hmac.compare_digest(given.encode("utf-8", "surrogateescape"), self._token)
        if not right or not self._is_us(host, scope["server"]):
            return None
        # a browser names the page's origin with every WebSocket; a foreign page cannot claim another
        if (
            scope["type"] == "websocket" or origin is not None
        ) and origin != f"http://{host}".encode("latin-1"):
            return None
        return f"/{rest}"

    def _is_us(self, host: str, server: tuple[str, int | None]) -> bool:
        """Return whether a Host header names the address of this connection, unlike a rebound name."""
        try:
            parts = urlsplit(f"//{host}")
            name = (parts.hostname or "").lower()
            port = parts.port or 80
        except ValueError:
            return False
        loopback = server[0] == "::1" or server[0].startswith("127.")
        bare = parts.netloc == host and parts.username is None  # no path, no user
        return (
            bare
            and port == server[1]
            and (
                name == server[0]
                or name in self._names
                or (loopback and name == "localhost")
            )
        )


class Connection(H11Protocol):
    """A connection closed unless it shows the token soon."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Accept an unknown connection, and close the oldest if there are too many."""
        super().connection_made(transport)
        self.since = self.loop.time()
        unknowns = [
            other
            for other in self.connections
            if isinstance(other, Connection) and other.is_unknown
        ]
        if len(unknowns) > MOST_UNKNOWN_CONNECTIONS:
            min(unknowns, key=lambda unknown: unknown.since).transport.abort()
        self.loop.call_later(UNKNOWN_CONNECTION_S, self._show_out)

    @property
    def is_unknown(self) -> bool:
        """Return whether no request with the token has come over this open connection."""
        scope: dict[str, Any] | None = self.scope  # type: ignore[assignment]
        return not self.transport.is_closing() and (scope is None or LET_IN not in scope)

    def _show_out(self) -> None:
        if self.transport.get_protocol() is self and self.is_unknown:
            self.transport.abort()
