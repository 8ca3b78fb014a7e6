"""A web display on localhost, and real Chromium to open it in."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from playwright.sync_api import Browser, Page, Playwright, Route, sync_playwright

from labkit.devices.context import DeviceContext
from labkit.drivers.simulated.bench import Bench
from labkit.drivers.simulated.setup import settings_for
from labkit.drivers.web.display import WebDisplay, open_display
from labkit.drivers.web.server import WebServer
from labkit.plan import DisplaySettings, Plan

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)

Launch = Callable[[float], Browser]

ASLEEP = "ASLEEP_MS = 3000"  # in the display's page

WAIT_S = 100.0
"""What comes in a moment on an idle machine is awaited for as long as this on a loaded one, then the test fails."""


def until(
    condition: Callable[[], bool], between: Callable[[], object] = lambda: None
) -> None:
    """Wait until a condition holds, calling `between` meanwhile."""
    deadline_s = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline_s, "the condition does not come true"
        between()
        time.sleep(0.01)


def small_bench(plan: Plan) -> Bench:
    """The simulated bench of a plan, with a halo cut short: a photograph of it takes a moment."""
    return Bench(replace(settings_for(plan, 7), halo_um=100.0))


def reads(page: Page, element: str, text: str) -> None:
    """Wait until an element of a page holds a text."""
    page.wait_for_function(
        "([id, text]) => document.getElementById(id).textContent.includes(text)",
        arg=[element, text],
        timeout=1000 * WAIT_S,
    )


def plan_for(height: int, width: int) -> Plan:
    """As much of a plan as a display needs."""
    settings = DisplaySettings(address="web:", pixel_pitch_mm=0.1, pixels=(height, width))
    return Plan.model_construct(display=settings)


@dataclass
class Lab:
    """A context with web displays in it, and their warnings and links."""

    context: DeviceContext
    warned: list[str]
    links: dict[str, str]
    opened: ExitStack

    def display(
        self, height: int, width: int, name: str = "screen", hold_s: float = WAIT_S
    ) -> WebDisplay:
        """On one server, at a port that the system chose."""
        display = open_display(
            f"web://127.0.0.1:0/{name}", plan_for(height, width), self.context
        )
        display.hold_s = hold_s
        return self.opened.enter_context(display)

    def ask(self, text: str) -> str:
        """Ask the operator, who can answer on the page."""
        with self.context.operator.reached_by(self.server.monitor):
            return self.context.operator.ask(text)

    @property
    def server(self) -> WebServer:
        (server,) = self.context.shared.values()
        assert isinstance(server, WebServer)
        return server


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Lab]:
    """Displays opened in it are closed with it."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    warned: list[str] = []
    links: dict[str, str] = {}
    context = DeviceContext(warn=warned.append, show_link=links.__setitem__)
    with ExitStack() as opened:
        yield Lab(context, warned, links, opened)
    assert context.shared.values() == ()


@pytest.fixture
def display(lab: Lab) -> WebDisplay:
    """A small one."""
    return lab.display(60, 80)


@pytest.fixture(scope="session")
def playwright() -> Iterator[Playwright]:
    if CHROMIUM is None:
        pytest.skip("Chromium is not installed (Debian: apt-get install chromium)")
    with sync_playwright() as started:
        yield started


@pytest.fixture(scope="session")
def launch(playwright: Playwright) -> Iterator[Launch]:
    """Chromium at a device scale, started once for each."""
    browsers: dict[float, Browser] = {}

    def get(scale: float) -> Browser:
        if scale not in browsers:
            flags = ["--no-sandbox", f"--force-device-scale-factor={scale:g}"]
            browsers[scale] = playwright.chromium.launch(
                executable_path=CHROMIUM, args=flags
            )
        return browsers[scale]

    yield get
    for browser in browsers.values():
        browser.close()


@dataclass
class Glass:
    """A browser tab of so many CSS pixels at a device scale, as a screen."""

    page: Page
    errors: list[str]

    def __post_init__(self) -> None:
        self.cdp = self.page.context.new_cdp_session(self.page)
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))

    def resize(self, height: int, width: int) -> None:
        # scale 0 keeps the browser's own: an emulated one does not reach the canvas
        metrics: dict[str, Any] = {
            "width": width,
            "height": height,
            "deviceScaleFactor": 0,
            "mobile": False,
        }
        self.cdp.send("Emulation.setDeviceMetricsOverride", metrics)

    def seen(self) -> NDArray[np.uint8]:
        """(height, width, 3) of what is on the glass, in device pixels."""
        decoded = cv2.imdecode(
            np.frombuffer(self.page.screenshot(scale="device"), np.uint8), cv2.IMREAD_COLOR
        )
        return np.asarray(decoded, dtype=np.uint8)

    def reads(self, picture: NDArray[Any]) -> None:
        """Wait until the glass shows these grey values, and nothing else."""
        deadline_s = time.monotonic() + WAIT_S
        while time.monotonic() < deadline_s:
            seen = self.seen()
            if np.array_equal(seen, np.repeat(picture[:, :, None], 3, axis=2)):
                return
            self.page.wait_for_timeout(50)
        raise AssertionError(
            f"the glass shows a mean grey of {seen.mean():g}, not {picture.mean():g}, or another picture"
        )


@pytest.fixture
def glass(launch: Launch) -> Iterator[Callable[..., Glass]]:
    """Makes a tab: glass(url, height, width, scale). No script of a page may fail.

    A browser that gets no processor for three seconds is taken for asleep, as it should be; on a loaded machine that happens,
    so a tab waits for WAIT_S unless it may `sleep`.
    """
    made: list[Glass] = []

    def patient(route: Route) -> None:
        body = route.fetch().text()
        assert ASLEEP in body
        route.fulfill(
            content_type="text/javascript",
            body=body.replace(ASLEEP, f"ASLEEP_MS = {1000 * WAIT_S:g}"),
        )

    def make(
        url: str,
        height: int = 600,
        width: int = 800,
        scale: float = 1,
        script: str = "",
        sleep: bool = False,
    ) -> Glass:
        page = launch(scale).new_context(no_viewport=True).new_page()
        page.set_default_timeout(1000 * WAIT_S)
        one = Glass(page, [])
        made.append(one)
        one.resize(height, width)
        if script:
            page.add_init_script(script)
        if not sleep:
            page.route("**/page/display.js", patient)
        page.goto(url)
        return one

    yield make
    for one in made:
        one.page.context.close()
    assert [one.errors for one in made if one.errors] == []
