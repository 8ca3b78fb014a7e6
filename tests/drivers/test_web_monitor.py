"""The operator's page in real Chromium, clicked through while simulated captures run; a capture through the glass."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from labkit.acquisition.capture import run_plan
from labkit.devices.context import DeviceContext, Devices
from labkit.devices.operator import Operator
from labkit.devices.protocols import Picture, Shown
from labkit.devices.registry import open_camera, open_rail
from labkit.devices.serve_target import CHOICES, keep_showing
from labkit.devices.shared import SharedParts
from labkit.drivers.simulated.bench import Bench
from labkit.drivers.web.display import WebDisplay
from labkit.drivers.web.monitor import Monitor
from labkit.drivers.web.preview import HISTOGRAM_BINS, exposure, histogram
from labkit.finder.preview import Look
from labkit.finder.sharpness import sharpest_edge_px
from labkit.panel.picture import panel_picture
from labkit.photographs.decoding import read_photograph
from labkit.photographs.photograph import Photograph
from labkit.plan import Plan, TargetSpec
from labkit.session.session import Session, begin
from labkit.target.target import open_target

from .conftest import WAIT_S, Glass, Lab, reads, small_bench

OpenGlass = Callable[..., Glass]

pytestmark = pytest.mark.timeout(300)  # of a machine that does much else

PLAN = """
[lens]
focal_length_mm = 50.0
f_number = 8.0
[sensor]
pixel_pitch_um = 6.0
[[channel]]
name = "G"
wavelength_nm = 550.0
[target]
kind = "sierpinski"
order = 2
size_mm = 9.0
[camera]
address = "simulated:seed=7"
exposure_s = 0.02
frames_per_range = 2
flats_per_range = 2
darks = 1
[rail]
address = "simulated:seed=7"
ranges_mm = [2000, 2050.5]
range_at_zero_mm = 1950.0
[display]
address = "web:"
pixel_pitch_mm = 0.1
pixels = [400, 400]
"""


class LitDisplay:
    """The web display, whose glass lights the simulated bench: what Chromium shows is what is photographed."""

    def __init__(self, web: WebDisplay, tab: Glass, bench: Bench) -> None:
        self._web, self._tab, self._bench = web, tab, bench
        self.panel, self.close, self.shows = web.panel, web.close, 0

    def show(self, picture: Picture) -> Shown:
        shown = self._web.show(picture)
        self.shows += 1
        self._bench.light(self._tab.seen()[:, :, 0])
        return shown

    def undisturbed(self) -> bool:
        return self._web.undisturbed()

    def __enter__(self) -> LitDisplay:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Table:
    """A bench whose target is in a browser, and an operator's page."""

    def __init__(self, lab: Lab, glass: OpenGlass, folder: Path) -> None:
        self.plan_file = folder / "plan.toml"
        self.plan_file.write_text(PLAN)
        plan = Plan.load(self.plan_file)
        bench = small_bench(plan)
        self.context = DeviceContext(shared=SharedParts({"simulated:seed=7": bench}))
        web = lab.display(400, 400)
        self.tab = glass(web.url, 400, 400)
        self.display = LitDisplay(web, self.tab, bench)
        self.monitor = lab.server.monitor
        camera = open_camera("simulated:seed=7", plan, self.context)
        rail = open_rail("simulated:seed=7", plan, self.context)
        self.devices = Devices(camera, rail, self.display, bench.wait, [self.monitor, self])
        self.operator = glass(lab.server.url("monitor"), 800, 1280)
        self.on_step: dict[str, Callable[[], Any]] = {}

    def noted(self, event: str, **fields: Any) -> None:
        """An observer too: does to the bench what the test asks at a step."""
        if event == "doing" and fields["what"] in self.on_step:
            self.on_step.pop(fields["what"])()

    def took(self, *_: Any) -> None:
        """Nothing to do."""

    def may_go_on(self) -> None:
        """Lets it."""

    def capture(self, folder: Path, resume: bool = False) -> Session:
        with begin(self.plan_file, folder, resume) as session:
            run_plan(session, self.devices, check=False)
        return session

    def reads(self, element: str, words: str) -> None:
        """Wait until the operator's page says so."""
        reads(self.operator.page, element, words)


@pytest.fixture
def table(lab: Lab, glass: OpenGlass, tmp_path: Path) -> Table:
    return Table(lab, glass, tmp_path)


def test_a_capture_through_the_glass_is_seen_by_the_operator(
    table: Table, tmp_path: Path
) -> None:
    session = table.capture(tmp_path / "s")
    assert len(session.frames) == 9
    table.reads("phase", "Complete")
    table.reads("count", "9 of 9")
    table.reads("frame-name", "target_2050.5_1 · 2050.5 mm")
    page = table.operator.page
    sharpest = sharpest_edge_px(
        read_photograph(session.frames[-1].path, session.plan.sensor)
    )
    assert page.inner_text("#sharpness") == f"{sharpest:.1f} px"
    assert page.inner_text("#clipped").endswith("%")
    width = read_photograph(session.frames[-1].path, session.plan.sensor).counts.shape[1]
    assert page.evaluate("document.getElementById('preview').naturalWidth") == width // 2
    assert page.locator("#histogram rect").count() == HISTOGRAM_BINS
    assert "simulated" in page.inner_text("#log-list")
    assert "at 2050" in page.inner_text("#device-list")
    assert not page.is_visible("#actions")


def test_a_photograph_taken_while_the_page_was_reloaded_is_taken_again(
    table: Table, tmp_path: Path
) -> None:
    table.on_step["taking target_2000_1"] = table.tab.page.reload

    def turn() -> None:
        table.tab.resize(300, 400)
        table.tab.page.wait_for_function("document.getElementById('glass').height === 300")
        table.tab.resize(400, 400)

    table.on_step["taking flat_2050.5_0"] = turn
    session = table.capture(tmp_path / "s")
    assert len(session.frames) == 9
    lost = [event["error"] for event in session.events if event["event"] == "trouble"]
    assert lost == [
        "lost its picture during target_2000_1",
        "lost its picture during flat_2050.5_0",
    ]
    assert table.display.shows == 5 + 2
    table.reads("log-list", "lost its picture during target_2000_1")


def test_pause_holds_the_capture_and_go_on_lets_it(table: Table, tmp_path: Path) -> None:
    page = table.operator.page

    def pause() -> None:
        page.click("#pause")
        table.reads("phase", "Paused")
        # clicked by the page itself, for this thread is held from now on
        page.evaluate("setTimeout(() => document.getElementById('pause').click(), 300)")

    table.on_step["taking flat_2000_1"] = pause
    session = table.capture(tmp_path / "s")
    assert len(session.frames) == 9
    table.reads("log-list", "operator: pause")
    table.reads("log-list", "operator: resume")
    table.reads("phase", "Complete")


def test_abort_asks_once_more_and_leaves_a_session_to_resume(
    table: Table, tmp_path: Path
) -> None:
    page = table.operator.page

    def abort() -> None:
        page.click("#abort")
        page.click("#no")
        assert not page.is_visible("#sure")
        page.click("#abort")
        page.click("#yes")
        table.reads("log-list", "operator: abort")

    table.on_step["taking target_2000_0"] = abort
    with pytest.raises(KeyboardInterrupt):
        table.capture(tmp_path / "s")
    table.reads("phase", "Interrupted")
    assert len(Session.open(tmp_path / "s").frames) == 3
    assert len(table.capture(tmp_path / "s", resume=True).frames) == 9
    table.reads("phase", "Complete")


def test_what_a_device_says_is_text_not_html(table: Table) -> None:
    evil = "<img src=x onerror=\"document.body.textContent='pwned'\">"
    table.monitor.noted("doing", what=evil)
    table.monitor.noted("camera", model=evil, serial="</script><script>alert(1)</script>")
    table.monitor.noted("trouble", device=evil, attempt=1, error=evil)
    table.monitor.noted(evil, words=evil)
    for element in ("doing", "device-list", "log-list"):
        table.reads(element, evil)
    assert table.operator.page.locator("main img:not(#preview)").count() == 0


@pytest.mark.parametrize("width", [320, 390, 1280])
def test_nothing_stands_out_of_the_page(width: int, lab: Lab, glass: OpenGlass) -> None:
    display = lab.display(400, 400)
    server, long = lab.server, "x" * 200
    page = glass(server.url("monitor"), 800, width).page
    asking = threading.Thread(target=lab.ask, args=(f"Set the rail {long}",), daemon=True)
    asking.start()
    server.monitor.noted("began", missing=9999, total=9999)
    server.monitor.noted("doing", what=long)
    server.monitor.noted("trouble", device=long, attempt=1, error=long)
    server.monitor.took(
        long, "target", 2000.123456, mosaic(np.full((80, 80), 100)), 1, 9999
    )
    page.wait_for_selector("#question", state="visible")
    page.wait_for_selector("#preview", state="visible")
    page.click("#abort")
    assert page.evaluate("document.documentElement.scrollWidth") == width
    page.fill("#reply", "1")
    page.click("#send")
    asking.join(WAIT_S)
    assert not asking.is_alive()
    display.close()


def test_the_page_says_when_labkit_is_gone(table: Table, lab: Lab) -> None:
    table.reads("phase", "Ready")
    table.display.close()
    table.reads("phase", "No connection")
    assert table.operator.page.inner_text("#phase") == "No connection"
    assert table.operator.page.is_hidden("#actions")


def test_a_simulated_camera_sees_what_the_page_was_sent(lab: Lab, glass: OpenGlass) -> None:
    seen: list[Picture] = []
    lab.context.glass.watched_by(seen.append)
    display = lab.display(400, 400)
    tab = glass(display.url, 400, 400)
    display.show(np.random.default_rng(1).integers(0, 256, (300, 200)).astype(np.uint8))
    (picture,) = seen
    assert not isinstance(picture, str)
    assert np.array_equal(picture, tab.seen()[:, :, 0])


def test_a_display_that_shows_nothing_is_not_said_to_show(
    lab: Lab, glass: OpenGlass
) -> None:
    display = lab.display(400, 400)
    lab.server.monitor.noted("serving", choices=["target"], picked="target")
    page = glass(lab.server.url("monitor"), 800, 400).page
    reads(page, "phase", "Not shown yet")
    assert not page.is_visible("#frame")
    assert not page.is_visible("#numbers")
    glass(display.url, 400, 400)
    reads(page, "phase", "Showing")


def test_the_sharpness_line_falls_as_the_number_does(lab: Lab, glass: OpenGlass) -> None:
    lab.display(400, 400)
    page = glass(lab.server.url("monitor"), 800, 1280).page
    for edge_px in (9.0, 6.0, 3.0):
        lab.server.monitor.saw(
            Look("a", 2000.0, mosaic(np.full((80, 80), 100)), None, edge_px)
        )
    reads(page, "sharpness", "3.0 px")
    page.wait_for_selector("#trend path", state="attached")
    heights = [
        float(y)
        for y in re.findall(r",([0-9.]+)", page.get_attribute("#trend path", "d") or "")
    ]
    assert heights == sorted(heights)  # in a picture, down is more
    assert len(heights) == 3


def test_served_targets_are_picked_on_the_page(lab: Lab, glass: OpenGlass) -> None:
    display = lab.display(400, 400)
    tab = glass(display.url, 400, 400)
    target = open_target(TargetSpec(kind="sierpinski", order=2, size_mm=9.0))
    ended = threading.Event()
    server = lab.server
    work = threading.Thread(
        target=keep_showing,
        args=(target, [display], lab.context, lambda: not ended.is_set()),
    )
    work.start()
    try:
        operator = glass(server.url("monitor"), 800, 400)
        grey = round(255 * 0.5 ** (1 / display.panel.gamma))  # half the light of white
        carpet = panel_picture(target, display.panel).grey
        even = {
            name: np.full((400, 400), value)
            for name, value in (("white", 255), ("black", 0), ("grey", grey))
        }
        for name, picture in {
            **even,
            "target": np.pad(carpet, (400 - carpet.shape[0]) // 2),
        }.items():
            operator.page.get_by_role("button", name=name, exact=True).click()
            tab.reads(picture)
        assert operator.page.locator("#choices button").count() == len(CHOICES)
    finally:
        ended.set()
        work.join(WAIT_S)


# ---- numbers


def mosaic(counts: Any, black: float = 100, white: float = 1100) -> Photograph:
    return Photograph(
        np.asarray(counts, dtype=np.uint16), np.full((2, 2), black), white, ("RG", "GB")
    )


def test_the_histogram_counts_every_pixel_once() -> None:
    counts = np.full((40, 50), 100)
    counts[:10] = 600
    counts[0, :5] = 1100
    shares = histogram(mosaic(counts))
    assert sum(shares) == pytest.approx(1)
    assert shares[0] == 30 / 40
    assert shares[HISTOGRAM_BINS // 2] == pytest.approx((500 - 5) / 2000)
    assert shares[-1] == 5 / 2000
    clipped, middle = exposure(mosaic(counts))
    assert clipped == pytest.approx(100 * 5 / 2000)
    assert middle == 0


def test_a_photograph_of_the_preflight_is_shown_with_what_is_wrong() -> None:
    monitor = Monitor(DeviceContext().requests, Operator())
    counts = np.full((80, 120), 100)
    corners = np.array([[20.0, 30.0], [20.0, 90.0], [60.0, 90.0], [60.0, 30.0]])
    monitor.saw(
        Look(
            "preflight_2000_target",
            2000.0,
            mosaic(counts),
            corners[None],
            4.2,
            "out of focus",
        )
    )
    shown = monitor.snapshot()
    assert (shown["frame"]["note"], shown["sharpness"]) == (
        "out of focus",
        [{"name": "preflight_2000_target", "edge_px": 4.2}],
    )
    seen = cv2.imdecode(np.frombuffer(monitor.preview, np.uint8), cv2.IMREAD_COLOR)
    assert seen is not None
    assert seen.shape == (40, 60, 3)
    assert (
        np.ptp(seen[10, 30].astype(int)) > 60
    )  # on the upper edge of the outline, which has a colour
    assert np.ptp(seen[20, 30].astype(int)) < 20


def test_times_in_the_log_have_their_zone() -> None:
    monitor = Monitor(DeviceContext().requests, Operator())
    monitor.noted("moved", measured_range_mm=2000.0, position_mm=50.0)
    logged = datetime.fromisoformat(monitor.snapshot()["log"][0]["time"])
    assert logged.utcoffset() is not None
    assert abs(logged - datetime.now(UTC)) < timedelta(minutes=10)


def test_times_in_the_log_are_those_of_the_reader_with_their_zone(table: Table) -> None:
    page = table.operator.page
    page.context.new_cdp_session(page).send(
        "Emulation.setTimezoneOverride", {"timezoneId": "Asia/Kathmandu"}
    )
    shown = page.evaluate("clock('2026-11-24T21:40:05+00:00')")
    assert shown == "03:25:05 GMT+5:45"


def test_a_capture_that_is_complete_names_the_next_command(table: Table) -> None:
    table.monitor.noted("began", missing=1, total=1)
    table.monitor.noted("complete")
    table.monitor.noted("next", command="labkit fit 'night 3'")
    table.reads("phase", "Complete")
    table.reads("doing", "next: labkit fit 'night 3'")
    assert table.monitor.snapshot()["phase"] == "complete"


def test_a_photograph_in_the_session_ends_the_trouble_before_it() -> None:
    monitor = Monitor(DeviceContext().requests, Operator())
    monitor.noted("trouble", device="rail", attempt=1, error="stalled")
    assert monitor.snapshot()["devices"] == [
        {"device": "rail", "state": "bad", "text": "stalled"}
    ]
    assert monitor.snapshot()["log"][-1]["text"] == "trouble with the rail, try 1: stalled"
    monitor.took("d", "dark", None, mosaic(np.full((8, 8), 100)), 1, 10)
    assert {device["state"] for device in monitor.snapshot()["devices"]} == {"good"}


def test_time_left_is_the_pace_so_far_without_the_pauses() -> None:
    clock = [0.0]
    monitor = Monitor(DeviceContext().requests, Operator(), now=lambda: clock[0])

    def left_s() -> Any:
        return monitor.snapshot()["left_s"]

    def take(done: int) -> None:
        monitor.took("d", "dark", None, mosaic(np.full((8, 8), 100)), done, 10)

    monitor.noted("doing", what="x")
    monitor.noted("began", missing=8, total=10)
    assert (monitor.snapshot()["done"], monitor.snapshot()["total"]) == (2, 10)
    clock[0] = 100.0  # a look round
    take(3)
    assert left_s() is None
    clock[0] += 2.0
    take(4)
    assert left_s() == 12
    clock[0] += 1.0
    assert left_s() == 11
    clock[0] += 60.0
    assert left_s() == 10  # one photograph takes long: the five after it are left at least
    clock[0] -= 60.0
    monitor.act("pause")
    assert left_s() is None

    def wait_then_go_on() -> None:
        clock[0] += 50.0
        monitor.act("resume")

    timer = threading.Timer(0.2, wait_then_go_on)
    timer.start()
    monitor.may_go_on()
    clock[0] += 1.0
    take(5)
    assert left_s() == 10
