"""Serving a target: what is picked is shown, the latest pick before any older one."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from labkit.devices import serve_target as serving
from labkit.devices.context import DeviceContext
from labkit.devices.protocols import PanelInfo, Picture, Shown
from labkit.devices.serve_target import keep_showing
from labkit.errors import DisplayError, LabkitError
from labkit.plan import TargetSpec
from labkit.target.target import open_target


class Slow:
    """A display that fails as often as it is told to; each show waits for leave."""

    def __init__(self, fails: int) -> None:
        self.panel = PanelInfo((40, 40), 0.5)
        self._fails = fails
        self.leave = threading.Semaphore(0)
        self.begun = threading.Semaphore(0)
        self.shown: list[float] = []

    def show(self, picture: Picture) -> Shown:
        assert not isinstance(picture, str)
        self.begun.release()
        assert self.leave.acquire(timeout=10)
        if self._fails:
            self._fails -= 1
            raise DisplayError("its page is turned")
        self.shown.append(float(np.mean(picture)))
        return Shown((40, 40))

    def close(self) -> None:
        """Nothing to let go."""

    def __enter__(self) -> Slow:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing to let go."""


def serve(display: Slow, context: DeviceContext, act: Callable[[], None]) -> None:
    target = open_target(TargetSpec(kind="sierpinski", order=1, size_mm=9.0))
    ended = threading.Event()
    work = threading.Thread(
        target=keep_showing, args=(target, [display], context, lambda: not ended.is_set())
    )
    work.start()
    try:
        act()
    finally:
        ended.set()
        work.join(10)
    assert not work.is_alive()


def test_a_later_pick_is_not_undone_by_one_that_failed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(serving, "RETRY_S", 0.0)
    warned: list[str] = []
    display, context = Slow(fails=1), DeviceContext(warn=warned.append)

    def act() -> None:
        assert display.begun.acquire(timeout=10)  # the target, which will fail
        context.requests.put("white")
        while not context.requests.empty():
            time.sleep(0.01)
        time.sleep(0.3)  # for the request to reach the display's queue
        display.leave.release()
        assert display.begun.acquire(timeout=10)
        display.leave.release()
        assert not display.begun.acquire(timeout=0.5)  # and nothing after it

    serve(display, context, act)
    assert display.shown == [255]
    assert warned == ["its page is turned"]


def test_a_picture_is_tried_until_it_is_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serving, "RETRY_S", 0.0)
    display, context = Slow(fails=3), DeviceContext()

    def act() -> None:
        for _ in range(4):
            assert display.begun.acquire(timeout=10)
            display.leave.release()
        assert not display.begun.acquire(timeout=0.5)

    serve(display, context, act)
    assert len(display.shown) == 1


def test_a_request_that_is_no_picture_changes_nothing() -> None:
    display, context = Slow(fails=0), DeviceContext()

    def act() -> None:
        assert display.begun.acquire(timeout=10)  # the target
        for request in ("no such picture", "black"):
            context.requests.put(request)
        display.leave.release()
        assert display.begun.acquire(timeout=10)
        display.leave.release()
        assert not display.begun.acquire(timeout=0.5)

    serve(display, context, act)
    assert len(display.shown) == 2
    assert display.shown[-1] == 0


@pytest.mark.parametrize("fault", ["too large", "port in use", "unknown target"])
def test_what_is_refused_is_refused_before_an_address_is_printed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, fault: str
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    links: list[str] = []
    context = DeviceContext(show_link=lambda what, url: links.append(url))
    spec = {
        "too large": "sierpinski:order=3,size_mm=4680",
        "unknown target": "sierpinksi:order=3",
    }.get(fault, "sierpinski:order=3,size_mm=46.8")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1] if fault == "port in use" else 0
        with pytest.raises(LabkitError):
            serving.serve_target(
                spec, ["ipad-9.7-retina"] * 2, f"127.0.0.1:{port}", context=context
            )
    assert links == []


def test_addresses_are_printed_once_all_displays_are_open(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    links: list[str] = []
    context = DeviceContext(show_link=lambda what, url: links.append(what))
    spec = "sierpinski:order=3,size_mm=46.8"
    panels = ["ipad-9.7-retina"] * 2
    serving.serve_target(spec, panels, "127.0.0.1:0", context=context, going=lambda: False)
    assert len(links) == 3
    assert links[0] == "The operator's page"
