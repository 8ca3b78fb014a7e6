"""Questions of a capture on the operator's page in real Chromium: no web display, no motor, a lens cap to put on."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from labkit.acquisition.capture import run_plan
from labkit.devices.context import DeviceContext
from labkit.devices.protocols import Camera, CameraInfo, ExposureSettings, RawFrame
from labkit.devices.registry import observers_of, open_devices, open_display, open_monitor
from labkit.devices.shared import SharedParts
from labkit.errors import PlanError
from labkit.plan import Plan
from labkit.session.session import Session, begin

from .conftest import WAIT_S, Glass, reads, small_bench
from .test_web_monitor import PLAN

OpenGlass = Callable[..., Glass]

pytestmark = pytest.mark.timeout(300)  # of a machine that does much else

BENCH = "simulated:seed=7"
FRAMES = 9


class BareCamera:
    """A camera without a cap of its own."""

    def __init__(self, camera: Camera) -> None:
        self._camera = camera

    def identify(self) -> CameraInfo:
        return self._camera.identify()

    def configure(self, settings: ExposureSettings) -> None:
        self._camera.configure(settings)

    def expose(self, path: Path) -> RawFrame:
        return self._camera.expose(path)

    def close(self) -> None:
        self._camera.close()

    def __enter__(self) -> BareCamera:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Night:
    """A capture on a thread of its own, its operator's page in a browser."""

    def __init__(self, context: DeviceContext, glass: OpenGlass, folder: Path) -> None:
        self.context, self._glass, self.folder = context, glass, folder
        self.bench, self.server = context.shared.values()
        self.ended: list[BaseException | None] = []
        self.page = self.open()

    def open(self) -> Any:
        return self._glass(self.server.url("monitor"), 844, 390).page

    def begin(self, resume: bool = False) -> None:
        self._work = threading.Thread(target=self._capture, args=(resume,), daemon=True)
        self._work.start()

    def end(self) -> BaseException | None:
        self._work.join(WAIT_S)
        return self.ended.pop()

    def reads(self, element: str, words: str, page: Any = None) -> None:
        """Wait until a page says so."""
        reads(page or self.page, element, words)

    def asked(self, words: str) -> None:
        self.reads("asked", words)
        self.page.wait_for_selector("#question", state="visible")

    def types(self, words: str) -> None:
        self.page.fill("#reply", words)
        self.page.click("#send")

    def _capture(self, resume: bool) -> None:
        plan_file = self.folder / "plan.toml"
        try:
            with (
                begin(plan_file, self.folder / "s", resume) as session,
                open_devices(session.plan, context=self.context) as devices,
            ):

                def ask(words: str) -> None:
                    self.context.operator.ask(words, "done")
                    self.bench.covered = words.startswith("Put")

                run_plan(
                    session,
                    replace(devices, camera=BareCamera(devices.camera)),
                    ask=ask,
                    check=False,
                )
            self.ended.append(None)
        except BaseException as error:
            self.ended.append(error)


@pytest.fixture
def night(
    glass: OpenGlass, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Night]:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    (tmp_path / "plan.toml").write_text(
        PLAN.replace(
            '[rail]\naddress = "simulated:seed=7"', '[rail]\naddress = "manual:"'
        ).replace('"web:"', f'"{BENCH}"')
    )
    plan = Plan.load(tmp_path / "plan.toml")
    context = DeviceContext(shared=SharedParts({BENCH: small_bench(plan)}))
    with open_monitor("web://127.0.0.1:0", plan, context) as page:
        yield Night(replace(context, observers=(page,)), glass, tmp_path)
    assert len(context.shared.values()) == 1  # the bench
    assert not context.operator.present


def test_a_capture_is_led_from_the_page_alone(night: Night) -> None:
    night.begin()
    night.asked("Put the cap on the lens, then touch Done.")
    assert not night.page.is_visible("#reply")
    night.reads("phase", "Your turn")
    night.page.click("#send")
    night.asked("Take the cap off")
    night.page.click("#send")
    night.asked("Set the rail to 50.000 mm")
    for wrong in ("", "fifty", "5O", "1e999", "١٢", "NaN"):
        night.types(wrong)
        assert night.page.inner_text("#slip") == "Type a number, such as 150.25."
    night.types("15")
    night.asked("15 mm is more than 2 mm away. Set the rail to 50.000 mm")
    night.types(" 50,25 mm")
    night.asked("Set the rail to 100.500 mm")
    assert night.page.input_value("#reply") == ""
    night.page.fill("#reply", "100.5")
    night.page.press("#reply", "Enter")
    night.reads("phase", "Complete")
    assert night.end() is None
    assert not night.page.is_visible("#question")
    frames = Session.open(night.folder / "s").frames
    assert len(frames) == FRAMES
    assert {frame.meta.get("position_mm") for frame in frames} == {None, 50.25, 100.5}
    night.reads("log-list", "operator: 50,25 mm")
    night.reads("log-list", "operator: done")


def test_abort_ends_a_question_and_the_capture_is_resumed(night: Night) -> None:
    night.begin()
    night.asked("Put the cap on")
    night.page.click("#abort")
    night.page.click("#yes")
    night.reads("phase", "Interrupted")
    assert isinstance(night.end(), KeyboardInterrupt)
    assert not night.page.is_visible("#question")
    night.begin(resume=True)
    for words in ("Put", "Take", "Set the rail to 50", "Set the rail to 100.5"):
        night.asked(words)
        if words.startswith("Set"):
            night.page.fill("#reply", words.split()[-1])
        night.page.click("#send")
    night.reads("phase", "Complete")
    assert night.end() is None
    assert len(Session.open(night.folder / "s").frames) == FRAMES


def test_the_terminal_answers_and_the_page_knows(
    night: Night, monkeypatch: pytest.MonkeyPatch
) -> None:
    near, far = os.openpty()
    with os.fdopen(far, "r") as keyboard:
        monkeypatch.setattr("sys.stdin", keyboard)
        night.begin()
        for words, typed in (
            ("Put", b"\n"),
            ("Take", b"\n"),
            ("Set the rail to 50", b"50\n"),
        ):
            night.asked(words)
            os.write(near, typed)
        night.asked("Set the rail to 100")
        night.types("100.5")  # and the last on the page
        night.reads("phase", "Complete")
        assert night.end() is None
    os.close(near)


def test_what_is_typed_outlives_news_and_one_of_two_pages_answers(night: Night) -> None:
    other = night.open()
    night.begin()
    night.asked("Put")
    night.page.click("#send")
    night.asked("Take")
    night.reads(
        "asked", "Take", other
    )  # an answer to what a page still shows of before is none
    other.click("#send")
    night.asked("Set the rail to 50")
    night.page.fill("#reply", "50.1")
    night.server.monitor.noted("camera", model="news", serial="1")
    night.reads("device-list", "news")
    assert night.page.input_value("#reply") == "50.1"
    night.page.reload()  # asked again
    night.asked("Set the rail to 50")
    night.reads("asked", "Set the rail to 50", other)
    other.fill("#reply", "50.3")
    other.click("#send")
    night.asked("Set the rail to 100")
    night.types("100.5")
    assert night.end() is None
    frames = Session.open(night.folder / "s").frames
    assert 50.3 in {frame.meta.get("position_mm") for frame in frames}


def test_a_question_is_text_not_html(night: Night) -> None:
    evil = "<img src=x onerror=\"document.body.textContent='pwned'\">"
    asking = threading.Thread(target=night.context.operator.ask, args=(evil,), daemon=True)
    asking.start()
    night.asked(evil)
    assert night.page.locator("#question img").count() == 0
    night.types("1")
    asking.join(WAIT_S)
    assert not asking.is_alive()


def test_the_monitor_of_a_web_display_is_the_one_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    (tmp_path / "plan.toml").write_text(PLAN.replace('"web:"', '"web://127.0.0.1:0/left"'))
    plan, context = Plan.load(tmp_path / "plan.toml"), DeviceContext()
    assert plan.display is not None
    with open_monitor("web:", plan, context) as page:
        (server,) = context.shared.values()
        with open_display(plan.display.address, plan, context) as display:
            assert observers_of(replace(context, observers=(page,)), [display]) == (page,)
            assert context.shared.values() == (server,)
        assert context.operator.present
        assert context.shared.values() == (server,)
    assert context.shared.values() == ()


def test_a_monitor_listens_where_it_may(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    (tmp_path / "plan.toml").write_text(PLAN)
    plan, context = Plan.load(tmp_path / "plan.toml"), DeviceContext()
    with open_monitor("web://127.0.0.1:0", plan, context):
        (server,) = context.shared.values()
        assert server._socket.getsockname()[0] == "127.0.0.1"
    with (
        pytest.raises(PlanError, match="allowed is web://HOST:PORT"),
        open_monitor("web://h:x", plan, context),
    ):
        pass
