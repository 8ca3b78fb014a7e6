"""Web servers by their address: one serves all pages of a host and port, and lives as long as any of them is wanted."""

from __future__ import annotations

import re
from contextlib import AbstractContextManager
from types import TracebackType
from urllib.parse import urlsplit

from labkit.devices.context import DeviceContext
from labkit.drivers.web.server import WebServer
from labkit.errors import PlanError
from labkit.plan import Plan

DEFAULT_PORT = 8642
RESERVED = ("monitor", "page")
ALLOWED = (
    "web://HOST:PORT or web://HOST:PORT/NAME, such as web://127.0.0.1:8642 (this machine) or web://0.0.0.0:8642 (all)"
)


def parse_address(address: str) -> tuple[str, int, str]:
    """(host, port, name) of web://HOST:PORT/NAME; without a host, this machine alone. Raises PlanError."""
    try:
        parts = urlsplit(address)
        host, port, name = parts.hostname or "127.0.0.1", parts.port, parts.path.strip("/") or "screen"
    except ValueError:
        raise PlanError(f'address "{address}": allowed is {ALLOWED}') from None
    plain = not (parts.query or parts.fragment or parts.username or parts.password)
    if parts.scheme != "web" or not plain or not re.fullmatch(r"[a-z0-9-]{1,20}", name) or name in RESERVED:
        raise PlanError(f'address "{address}": allowed is {ALLOWED}')
    return host, DEFAULT_PORT if port is None else port, name


def open_monitor(address: str, plan: Plan, context: DeviceContext) -> AbstractContextManager[WebServer]:
    """The operator's page at an address, for as long as the context lasts.

    `web:` is where the plan's display is served, if it is a web display, and else this machine alone.
    Raises PlanError, or DisplayError for a port in use.
    """
    if address == "web:" and plan.display is not None and plan.display.address.startswith("web:"):
        address = plan.display.address
    host, port, _ = parse_address(address)
    return Serving(host, port, context)


class Serving(AbstractContextManager[WebServer]):
    """The context's server at a host and port, started by the first who enters and stopped by the last who leaves.

    Its operator's page looks on in the context, and answers questions. Raises DisplayError for a port in use.
    """

    def __init__(self, host: str, port: int, context: DeviceContext) -> None:
        self._host, self._port, self._room = host, port, context
        self._where = f"web://{host}:{port}"

    def __enter__(self) -> WebServer:
        context = self._room
        server: WebServer | None = context.shared.get(self._where)
        if server is None:
            server = WebServer(self._host, self._port, context)
            server.start()
            context.shared[self._where] = server
            context.observers.append(server.monitor)
            context.operator.attend(server.monitor)
            context.link("The operator's page", server.url("monitor"))
        server.users += 1
        return server

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        context = self._room
        server: WebServer = context.shared[self._where]
        server.users -= 1
        if not server.users:
            context.operator.leave(server.monitor)
            context.observers.remove(server.monitor)
            del context.shared[self._where]
            server.close()
