"""The display page in real Chromium: pixel by pixel, and through what happens to a tablet in a night."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from labkit.devices.test_patterns import PATTERNS, pattern
from labkit.drivers.web.display import WebDisplay
from labkit.drivers.web.server import NOT_UNDERSTOOD, TOO_LONG
from labkit.errors import DisplayError
from labkit.panel.picture import panel_picture
from labkit.plan import TargetSpec
from labkit.target.target import open_target

from .conftest import Glass, Lab, until

OpenGlass = Callable[..., Glass]

pytestmark = pytest.mark.timeout(300)  # of a machine that does much else


def noise(height: int, width: int) -> NDArray[np.uint8]:
    return np.random.default_rng(5).integers(0, 256, (height, width), dtype=np.uint8)


def browsing_until(glass: Glass, good: Callable[[], bool]) -> None:
    """Let the browser work until a condition holds."""
    until(good, lambda: glass.page.wait_for_timeout(50))


def drop_connections(lab: Lab) -> None:
    """Cut every connection without a goodbye."""
    for one in list(lab.server._server.server_state.connections):
        one.loop.call_soon_threadsafe(one.transport.abort)


@pytest.mark.parametrize("scale", [1, 1.25, 1.5, 2])
def test_what_is_on_the_glass_is_the_picture_pixel_by_pixel(
    scale: float, lab: Lab, glass: OpenGlass
) -> None:
    height, width = round(600 * scale), round(800 * scale)
    display = lab.display(height, width)
    tab = glass(display.url, 600, 800, scale)
    carpet = panel_picture(
        open_target(TargetSpec(kind="sierpinski", order=4, size_mm=40.5)), display.panel
    ).grey
    pictures = [
        carpet,
        noise(height, width),
        *(pattern(name, display.panel) for name in PATTERNS),
    ]
    for picture in pictures:
        assert display.show(picture).pixels == picture.shape
        whole = np.zeros((height, width), dtype=np.uint8)
        top, left = (height - picture.shape[0]) // 2, (width - picture.shape[1]) // 2
        whole[top : top + picture.shape[0], left : left + picture.shape[1]] = picture
        assert np.array_equal(tab.seen(), np.repeat(whole[:, :, None], 3, axis=2))
    assert display.undisturbed()


def test_odd_sizes_at_a_fractional_scale_are_exact_too(lab: Lab, glass: OpenGlass) -> None:
    size = 601, 803
    probe = lab.display(1, 1, "probe")
    tab = glass(probe.url, *size, 1.25)
    browsing_until(tab, lambda: probe._screen.report is not None)
    assert probe._screen.report is not None
    height, width = probe._screen.report.pixels
    assert abs(height - 751.25) < 1
    display = lab.display(height, width)
    tab = glass(display.url, *size, 1.25)
    display.show(noise(height, width))
    assert np.array_equal(tab.seen()[:height, :width, 1], noise(height, width))


def problem_of(display: WebDisplay) -> str:
    display.hold_s = 0.5
    with pytest.raises(DisplayError) as caught:
        display.show("white")
    assert "\n" not in str(caught.value)
    assert display.url in str(caught.value)
    return str(caught.value)


def test_without_a_page_it_says_what_to_open(lab: Lab) -> None:
    assert "no page answers: open its address" in problem_of(lab.display(600, 800))


@pytest.mark.parametrize(
    ("panel", "words"),
    [
        ((750, 1000), r"scaled ×0\.8"),
        ((800, 600), "the display is turned"),
        ((700, 800), "make it full screen"),
        ((500, 800), "another panel"),
    ],
)
def test_a_page_of_the_wrong_size_shows_nothing_and_says_why(
    panel: tuple[int, int], words: str, lab: Lab, glass: OpenGlass
) -> None:
    display = lab.display(*panel)
    tab = glass(display.url)
    browsing_until(tab, lambda: re.search(words, display._screen.problem or "") is not None)
    found = problem_of(display)
    assert re.search(words, found)
    assert tab.page.is_visible("#problem")
    assert (tab.page.text_content("#problem") or "nothing") in found


def test_a_turned_display_holds_the_capture_and_goes_on_by_itself(
    lab: Lab, glass: OpenGlass
) -> None:
    display = lab.display(600, 800)
    tab = glass(display.url)
    picture = noise(600, 800)
    display.show(picture)
    tab.resize(800, 600)
    browsing_until(tab, lambda: "turned" in (display._screen.problem or ""))
    assert tab.seen().shape == (800, 600, 3)
    tab.resize(600, 800)
    assert not display.undisturbed()
    browsing_until(
        tab, lambda: np.array_equal(tab.seen()[:, :, 0], picture)
    )  # back on the glass unasked
    display.show(picture)
    assert display.undisturbed()


def test_a_reload_is_noticed_and_the_picture_comes_back(lab: Lab, glass: OpenGlass) -> None:
    display = lab.display(600, 800)
    tab = glass(display.url)
    picture = noise(600, 800)
    display.show(picture)
    tab.page.reload()
    assert not display.undisturbed()
    browsing_until(tab, lambda: np.array_equal(tab.seen()[:, :, 0], picture))
    display.show(picture)
    assert display.undisturbed()


def test_a_page_in_the_background_is_no_display(lab: Lab, glass: OpenGlass) -> None:
    display = lab.display(600, 800)
    tab = glass(display.url)
    display.show("white")
    hide = (
        "state => { Object.defineProperty(document, 'visibilityState', {value: state, configurable: true});"
        "document.dispatchEvent(new Event('visibilitychange')); }"
    )
    tab.page.evaluate(hide, "hidden")
    browsing_until(tab, lambda: "hidden" in (display._screen.problem or ""))
    tab.page.evaluate(hide, "visible")
    assert not display.undisturbed()
    display.show("white")
    assert display.undisturbed()


def test_a_sleeping_page_is_lost_and_is_back_when_it_wakes(
    lab: Lab, glass: OpenGlass
) -> None:
    display = lab.display(600, 800)
    tab = glass(display.url, sleep=True)
    display.show("white")
    tab.cdp.send("Debugger.enable")
    tab.cdp.send("Debugger.pause")  # no script runs, as when a tablet sleeps
    # the browser's own waiting would wait for the page
    until(lambda: "no page answers" in (display._screen.problem or ""))
    tab.cdp.send("Debugger.resume")
    assert not display.undisturbed()
    display.show("black")
    assert display.undisturbed()


def test_a_zoomed_page_is_noticed(lab: Lab, glass: OpenGlass) -> None:
    display = lab.display(600, 800)
    tab = glass(display.url)
    display.show("white")
    tab.cdp.send("Emulation.setPageScaleFactor", {"pageScaleFactor": 2})
    browsing_until(tab, lambda: "zoomed ×2" in (display._screen.problem or ""))
    tab.cdp.send("Emulation.setPageScaleFactor", {"pageScaleFactor": 1})
    assert not display.undisturbed()
    display.show("white")


def test_a_lost_network_leaves_the_picture_and_disturbs_nothing(
    lab: Lab, glass: OpenGlass
) -> None:
    display = lab.display(600, 800)
    tab = glass(display.url)
    picture = noise(600, 800)
    display.show(picture)
    for _ in range(3):
        drop_connections(lab)
        assert np.array_equal(tab.seen()[:, :, 0], picture)
        assert display.undisturbed()  # waits until the page has found back
    assert np.array_equal(tab.seen()[:, :, 0], picture)


def test_a_page_that_hears_nothing_dials_again(lab: Lab, glass: OpenGlass) -> None:
    display = lab.display(600, 800)
    tab = glass(display.url)
    display.show("white")
    before = display._screen._page
    tab.page.evaluate("heard = 0")
    browsing_until(tab, lambda: display._screen._page not in (before, None))
    assert display.undisturbed()


SEND = """text => new Promise((done) => {
  const send = () => {
    if (socket === null || socket.readyState !== WebSocket.OPEN) { setTimeout(send, 20); return; }
    socket.addEventListener("close", (event) => done(event.code));
    socket.send(text);
  };
  send();
})"""
"""Sends by the page's connection once it is open; the code by which the server then ends that connection."""


@pytest.mark.parametrize(
    "slower", [1, 30]
)  # a page that is slow is still connecting when the server has accepted it
def test_a_message_of_the_wrong_kind_ends_the_connection_not_the_display(
    slower: int, lab: Lab, glass: OpenGlass
) -> None:
    display = lab.display(60, 80)
    tab = glass(display.url, 60, 80)
    display.show("white")
    tab.cdp.send("Emulation.setCPUThrottlingRate", {"rate": slower})
    messages = ("{}", "[1", "x" * 5000, '{"page": "<script>"}')
    assert [tab.page.evaluate(SEND, text) for text in messages] == [
        NOT_UNDERSTOOD,
        NOT_UNDERSTOOD,
        TOO_LONG,
        NOT_UNDERSTOOD,
    ]
    tab.cdp.send("Emulation.setCPUThrottlingRate", {"rate": 1})
    display.show("white")
    assert display.undisturbed()
    assert np.all(tab.seen() == 255)


def test_two_displays_show_two_pictures(lab: Lab, glass: OpenGlass) -> None:
    left, right = lab.display(600, 800, "left"), lab.display(450, 600, "right")
    tabs = glass(left.url, 600, 800), glass(right.url, 300, 400, 1.5)
    pictures = noise(600, 800), 255 - noise(450, 600)
    for display, picture in zip((left, right), pictures, strict=True):
        display.show(picture)
    for tab, picture in zip(tabs, pictures, strict=True):
        assert np.array_equal(tab.seen()[:, :, 2], picture)
    right.close()
    browsing_until(
        tabs[1], lambda: "Waiting for labkit" in tabs[1].page.inner_text("#state")
    )
    assert tabs[1].seen()[:5, :5].max() == 0
    assert left.undisturbed()


def test_the_newest_page_of_a_screen_has_it(lab: Lab, glass: OpenGlass) -> None:
    display = lab.display(600, 800)
    first = glass(display.url)
    display.show("white")
    second = glass(display.url)
    browsing_until(first, lambda: "Another page" in first.page.inner_text("#state"))
    display.show(noise(600, 800))
    assert np.array_equal(second.seen()[:, :, 0], noise(600, 800))
    first.page.click("#fill")
    browsing_until(first, lambda: "Another page" in second.page.inner_text("#state"))


def test_a_browser_that_alters_the_picture_is_found_out(lab: Lab, glass: OpenGlass) -> None:
    display = lab.display(600, 800)
    script = """const read = CanvasRenderingContext2D.prototype.getImageData;
        CanvasRenderingContext2D.prototype.getImageData = function (...a) {
          const got = read.apply(this, a); got.data[400] ^= 1; return got; };"""
    tab = glass(display.url, script=script)
    order = display._screen.want(noise(600, 800))
    browsing_until(tab, lambda: "alters the picture" in (display._screen.problem or ""))
    assert not display._screen.confirms(order)


def test_after_the_end_the_page_is_black_and_waits(lab: Lab, glass: OpenGlass) -> None:
    display = lab.display(600, 800)
    tab = glass(display.url)
    display.show("white")
    display.close()
    display.close()
    browsing_until(tab, lambda: "Waiting for labkit" in tab.page.inner_text("#state"))
    assert tab.seen()[:5, :5].max() == 0
