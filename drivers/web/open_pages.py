"""List labkit's pages on this machine: each server of this user records its address, and answers for its pages."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from websockets.exceptions import WebSocketException
from websockets.sync.client import connect
from websockets.typing import Origin

from labkit.storage.files import state_folder, write_private
from labkit.storage.reading import MOST_NOTE_BYTES, read_private

PAGE_ANSWER_S = 2.0


def note(url: str, address: str) -> Path:
    """Record a served operator's page, for this user alone; return the file to remove at its end."""
    file = state_folder() / "pages" / f"{os.getpid()}-{urlsplit(url).port}.json"
    with contextlib.suppress(Exception):  # a page that is not listed is served all the same
        write_private(file, json.dumps({"url": url, "address": address}).encode())
    return file


def find_pages() -> list[tuple[str, str, str]]:
    """Return (address for a plan, URL, state) of each page served now: the operator's, and each display's."""
    return [
        page
        for file in sorted((state_folder() / "pages").glob("*.json"))
        for page in _pages(file)
    ]


def _pages(file: Path) -> Iterator[tuple[str, str, str]]:
    try:
        noted = json.loads(read_private(file, MOST_NOTE_BYTES))
        url = str(noted["url"])
        address = str(noted["address"])
        state = _state(url)
    except (OSError, ValueError, KeyError, TypeError, WebSocketException):
        with contextlib.suppress(OSError):
            file.unlink()  # of a server that was killed
        return
    yield "", url, f"the operator's page: {state['phase']}"
    for display in state["displays"]:
        name = "" if display["name"] == "screen" else f"/{display['name']}"
        height, width = display["pixels"]
        problem = display["problem"] or "ready"
        yield (
            f"{address}{name}",
            str(display["url"]),
            f"display of {width} × {height} pixels: {problem}",
        )


def _state(url: str) -> dict[str, Any]:
    """Return the first message to the operator's page."""
    origin = Origin(f"http://{urlsplit(url).netloc}")
    with connect(
        f"ws{url.removeprefix('http')}/socket", origin=origin, open_timeout=PAGE_ANSWER_S
    ) as wire:
        state: dict[str, Any] = json.loads(wire.recv(timeout=PAGE_ANSWER_S))
    return state
