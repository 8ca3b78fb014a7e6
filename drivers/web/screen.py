"""One screen of a web page: its ordered picture, its page's reports, and their faults.

The capture's thread orders pictures and waits; the server's thread brings the page's
reports, all under one lock.
"""

from __future__ import annotations

import threading
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from labkit.devices.protocols import PanelInfo
from labkit.errors import DisplayError

SILENT_S = 4.0
"""Longest silence of a page, which reports every second, before the page counts as lost."""

SCALED_ALIKE = 0.005
"""Both sides off by the same factor, within this, mean that the picture is scaled."""

Pixels = Annotated[int, Field(ge=0, le=100_000)]
Counter = Annotated[int, Field(ge=0, le=2**53)]


class Report(BaseModel):
    """A page's report of its own state.

    pixels: measured (height, width) of its canvas on the glass; exact: whether these are
    whole device pixels; zoom: of the fingers; shown: number of the picture drawn two frames
    ago, and crc, of the grey values read back from the canvas; disturbed: number of times
    when the picture was not whole; asked: the last request answered.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    page: Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]
    pixels: Annotated[list[Pixels], Field(min_length=2, max_length=2)]
    exact: bool
    zoom: Annotated[float, Field(ge=0, le=1000)]
    visible: bool
    shown: Counter | None
    crc: Counter | None
    disturbed: Counter
    asked: Counter


@dataclass(frozen=True, slots=True, eq=False)
class Order:
    """A picture wanted on the glass: all of the panel as PNG, and the CRC-32 of its grey values, row by row."""

    number: int
    png: bytes
    crc: int

    def picture(self) -> NDArray[np.uint8]:
        """Return the picture's grey values, (height, width), as the page decodes them."""
        return np.asarray(
            cv2.imdecode(np.frombuffer(self.png, np.uint8), cv2.IMREAD_GRAYSCALE),
            dtype=np.uint8,
        )


class Screen:
    """A named screen. `name` is the last part of its page's address."""

    def __init__(
        self,
        name: str,
        panel: PanelInfo,
        url: str,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self.name = name
        self.panel = panel
        self.url = url
        self.changed = threading.Condition()
        self.order: Order | None = None
        self.asked = 0
        self._now = now
        self._report: Report | None = None
        self._heard = -np.inf
        self._page: object | None = None
        self._wake: Callable[[], None] = lambda: None

    def want(self, grey: NDArray[np.uint8]) -> Order:
        """Order a picture: grey values of panel pixels, centred, black around them. Raises DisplayError if too large."""
        rows, cols = self.panel.pixels
        if (
            grey.ndim != 2
            or grey.dtype != np.uint8
            or grey.shape[0] > rows
            or grey.shape[1] > cols
        ):
            raise DisplayError(
                f"a picture of {grey.shape} {grey.dtype}; allowed is uint8, at most {rows} × {cols} pixels"
            )
        whole = np.zeros((rows, cols), dtype=np.uint8)
        top = (rows - grey.shape[0]) // 2
        left = (cols - grey.shape[1]) // 2
        whole[top : top + grey.shape[0], left : left + grey.shape[1]] = grey
        done, png = cv2.imencode(".png", whole)
        if not done:
            raise DisplayError("OpenCV could not write the picture as PNG")
        number = self.order.number + 1 if self.order else 1
        with self.changed:
            self.order = Order(number, png.tobytes(), zlib.crc32(whole.tobytes()))
        self._wake()
        return self.order

    def request_report(self) -> int:
        """Request a fresh report from the page; return the number of its answer."""
        with self.changed:
            self.asked += 1
        self._wake()
        return self.asked

    def open(self, page: object, wake: Callable[[], None]) -> None:
        """Connect a page in place of any earlier page; `wake` is called, from any thread, after changes."""
        with self.changed:
            previous = self._wake
            self._page = page
            self._wake = wake
            self._report = None
            self.changed.notify_all()
        previous()

    def dismiss(self) -> None:
        """Let its page go."""
        with self.changed:
            wake = self._wake
            self._page = None
            self._report = None
            self.changed.notify_all()
        wake()

    def holds(self, page: object) -> bool:
        """Return whether a connection is the screen's latest."""
        return self._page is page

    def leave(self, page: object) -> None:
        """Disconnect a page."""
        with self.changed:
            if self._page is page:
                self._page = None
                self._report = None
                self._wake = lambda: None
                self.changed.notify_all()

    def hear(self, page: object, report: Report) -> None:
        """Receive a page's report."""
        with self.changed:
            if self._page is page:
                self._report, self._heard = report, self._now()
                self.changed.notify_all()

    @property
    def report(self) -> Report | None:
        """The page's last report, unless the page is lost."""
        return self._report if self._now() - self._heard <= SILENT_S else None

    @property
    def problem(self) -> str | None:
        """Reason why this screen can show nothing, and the remedy; None if it can."""
        report = self.report
        if report is None:
            return "no page answers: open its address on the display"
        if not report.visible:
            return "its page is hidden or the display asleep: wake it, bring the page to the front, set Auto-Lock to never"
        if report.zoom != 1:
            return f"its page is zoomed ×{report.zoom:.3g}: zoom out with two fingers"
        if not report.exact:
            return "its page has no whole number of pixels: set the browser's zoom and the system's scaling to 100 %"
        if wrong := size_problem((report.pixels[0], report.pixels[1]), self.panel):
            return wrong
        if (
            self.order
            and report.shown == self.order.number
            and report.crc != self.order.crc
        ):
            return "its browser alters the picture: switch off its privacy protection for canvases, or take another browser"
        return None

    def confirms(self, order: Order) -> bool:
        """Return whether the page has reported this picture on the glass without fault."""
        report = self.report
        return (
            report is not None
            and self.problem is None
            and (report.shown, report.crc) == (order.number, order.crc)
        )


def size_problem(pixels: tuple[int, int], panel: PanelInfo) -> str | None:
    """Describe how a page of (height, width) pixels does not fit a panel; None if it fits."""
    if pixels == panel.pixels:
        return None
    has = f"its page is {pixels[1]} × {pixels[0]} pixels, the panel {panel.pixels[1]} × {panel.pixels[0]}"
    if pixels == panel.pixels[::-1]:
        return f"{has}: the display is turned, turn it back and lock its rotation"
    down, across = (have / want for have, want in zip(pixels, panel.pixels, strict=True))
    if down and abs(across / down - 1) < SCALED_ALIKE:
        return f"{has}: it is scaled ×{down:.3g}, set the system's display zoom or scaling to its default"
    if down > 1 or across > 1:
        return f"{has}: this is another panel, or a scaled one; give its true pixels in [display]"
    return f'{has}: make it full screen by its button "Fill the screen"'
