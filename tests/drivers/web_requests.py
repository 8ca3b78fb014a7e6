"""The web server as a stranger's program meets it: raw requests, and connections as a page makes them."""

from __future__ import annotations

import socket
import zlib

import cv2
import numpy as np
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from labkit.drivers.web.display import WebDisplay

from .conftest import WAIT_S, Lab


def dial(lab: Lab) -> socket.socket:
    return socket.create_connection(("127.0.0.1", lab.server.port), timeout=WAIT_S)


def ask(
    lab: Lab, path: str, method: str = "GET", host: str | None = None, **headers: str
) -> tuple[int, bytes, bytes]:
    """(status, head, body) of one request, its path sent just as it is."""
    host = f"127.0.0.1:{lab.server.port}" if host is None else host
    lines = [f"{method} {path} HTTP/1.1", f"Host: {host}", "Connection: close"]
    lines += [f"{name}: {value}" for name, value in headers.items()]
    with dial(lab) as wire:
        wire.sendall("\r\n".join([*lines, "", ""]).encode("latin-1"))
        answer = b"".join(iter(lambda: wire.recv(65536), b""))
    head, _, body = answer.partition(b"\r\n\r\n")
    return int(head.split()[1]), head.lower(), body


def page(lab: Lab, name: str = "screen", origin: str | None = "") -> ClientConnection:
    """A page's connection, as a browser makes it; by default from our own origin."""
    here = f"127.0.0.1:{lab.server.port}"
    url = f"ws://{here}/{lab.server.token}/{name}/socket"
    whence = f"http://{here}" if origin == "" else origin
    return connect(
        url,
        origin=Origin(whence) if whence else None,
        open_timeout=WAIT_S,
        compression=None,
    )


GOOD = (
    '{"page": "0123456789abcdef", "pixels": [60, 80], "exact": true, "zoom": 1, "visible": true, '
    '"shown": null, "crc": null, "disturbed": 0, "asked": 0}'
)


def shows_still(lab: Lab, display: WebDisplay) -> bool:
    """Whether a picture goes through to a page, whose glass is what it fetches, and comes back confirmed."""
    with page(lab) as wire:
        wire.send(GOOD)
        order = display._screen.want(np.full((60, 80), 77, dtype=np.uint8))
        body = ask(lab, f"/{lab.server.token}/screen/picture?{order.number}")[2]
        crc = zlib.crc32(
            np.asarray(
                cv2.imdecode(np.frombuffer(body, np.uint8), cv2.IMREAD_GRAYSCALE)
            ).tobytes()
        )
        wire.send(
            GOOD.replace(
                '"shown": null, "crc": null', f'"shown": {order.number}, "crc": {crc}'
            )
        )
        display._hold(lambda: display._screen.confirms(order))
        return display._screen.confirms(order)
