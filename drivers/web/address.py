"""Web servers by address: one serves all pages of a host and port, and runs while any of them is open."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import closing, contextmanager
from urllib.parse import urlsplit

from labkit.devices.context import DeviceContext
from labkit.devices.shared import Lease
from labkit.drivers.web.monitor import Monitor
from labkit.drivers.web.server import WebServer
from labkit.errors import PlanError
from labkit.plan import Plan

DEFAULT_PORT = 8642
RESERVED_NAMES = ("monitor", "page")
ALLOWED_ADDRESSES = (
    "web://HOST:PORT or web://HOST:PORT/NAME, such as web://127.0.0.1:8642 (this machine) "
    "or web://0.0.0.0:8642 (all)"
)


def parse_address(address: str) -> tuple[str, int, str]:
    """Return (host, port, name) of web://HOST:PORT/NAME; without a host, of this machine alone. Raises
    PlanError.
    """
    try:
        parts = urlsplit(address)
        host = parts.hostname or "127.0.0.1"
        port = parts.port
        name = parts.path.strip("/") or "screen"
    except ValueError:
        raise PlanError(f'address "{address}": allowed is {ALLOWED_ADDRESSES}') from None
    plain = not (parts.query or parts.fragment or parts.username or parts.password)
    if (
        parts.scheme != "web"
        or not plain
        or not re.fullmatch(r"[a-z0-9-]{1,20}", name)
        or name in RESERVED_NAMES
    ):
        raise PlanError(f'address "{address}": allowed is {ALLOWED_ADDRESSES}')
    return host, DEFAULT_PORT if port is None else port, name


@contextmanager
def open_monitor(address: str, plan: Plan, context: DeviceContext) -> Iterator[Monitor]:
    """Serve the operator's page at an address until the end of the block.

    `web:` stands for the server of the plan's display, if this is a web display, and else
    for this machine alone. Raises PlanError, or DisplayError for a port in use.
    """
    if (
        address == "web:"
        and plan.display is not None
        and plan.display.address.startswith("web:")
    ):
        address = plan.display.address
    host, port, _ = parse_address(address)
    with closing(shared_server(host, port, context)) as lease:
        yield lease.part.monitor


def shared_server(host: str, port: int, context: DeviceContext) -> Lease[WebServer]:
    """Lease the server of a host and port in a context, started for its first user.

    Raises DisplayError for a port in use.
    """

    def start() -> WebServer:
        server = WebServer(host, port, Monitor(context.requests, context.operator))
        server.start()
        context.show_link("The operator's page", server.url("monitor"))
        return server

    return context.shared.lease(f"web://{host}:{port}", start, WebServer.close)
