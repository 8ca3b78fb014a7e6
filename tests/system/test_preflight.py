"""Looking round before the first frame: whatever is wrong is said, all at once, and nothing is photographed for good."""

from __future__ import annotations

import re
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from labkit.acquisition.capture import run_plan
from labkit.acquisition.sequence import picture_for
from labkit.devices.context import Devices
from labkit.devices.protocols import Check, ExposureSettings, Picture, Shown
from labkit.devices.registry import open_devices
from labkit.drivers.simulated.world import Fault
from labkit.errors import DataError, DeviceError, InputError, LabkitError, TargetError
from labkit.finder.find_target import find_target
from labkit.finder.picture import grey_image
from labkit.finder.preview import Look
from labkit.finder.sharpness import blur_px, edge_px
from labkit.optics.lens import ThinLens, circle_of_confusion_mm
from labkit.photographs.decoding import read_photograph
from labkit.plan import Plan
from labkit.session.session import Session, begin
from labkit.session.verify import remarks, verify
from labkit.target.target import open_target
from tests.plans import IPAD, PORTRAIT, plan_text, simulated

from .conftest import ContextMaker


class Display:
    """The simulated display with other pictures on its glass than it says."""

    def __init__(self, devices: Devices, turned: int) -> None:
        self._display = devices.display
        self._turned = turned
        self.panel = self._display.panel
        self.close = self._display.close

    def show(self, picture: Picture) -> Shown:
        if isinstance(picture, str):
            return self._display.show(picture)
        return self._display.show(np.roll(picture, self._turned, axis=1))


def problems_of(
    plan_file: Path,
    folder: Path,
    make_context: ContextMaker,
    faults: Sequence[Fault] = (),
    light: float = 1.0,
    turned: int = 0,
    check: Check | None = None,
) -> LabkitError:
    """What a capture with those faults says before its first frame."""
    context = make_context(plan_file, faults, light)
    with (
        begin(plan_file, folder, resume=False) as session,
        open_devices(session.plan, context=context) as devices,
    ):
        if check is not None:
            monitored = SimpleNamespace(check=lambda frames: check)
            for name in ("identify", "configure", "expose", "cover", "close"):
                setattr(monitored, name, getattr(devices.camera, name))
            devices = Devices(monitored, devices.rail, devices.display, devices.wait)
        display = Display(devices, turned)
        devices = Devices(devices.camera, devices.rail, display, devices.wait)  # type: ignore[arg-type]
        with pytest.raises(LabkitError) as caught:
            run_plan(session, devices)
    assert Session.open(folder).frames == ()
    assert "\n" not in str(caught.value)
    return caught.value


def test_what_is_right_is_noted_with_blur_margin_and_room(
    plan_file: Path, tmp_path: Path, make_context: ContextMaker
) -> None:
    said: list[str] = []
    with (
        begin(plan_file, tmp_path / "s", resume=False) as session,
        open_devices(session.plan, context=make_context(plan_file)) as devices,
    ):
        run_plan(session, devices, warn=said.append)
    (noted,) = [event for event in session.events if event["event"] == "preflight"]
    assert noted["problems"] == []
    assert said == []
    assert set(noted["measured"]) == {
        "2000 mm",
        "2050.5 mm",
        "exposure",
        "frame_bytes",
        "free_bytes",
    }
    assert noted["measured"]["2000 mm"]["margin_px"] > 0
    assert not (tmp_path / "s" / "rejected").exists()


def test_a_target_that_whole_pixels_make_smaller_is_said_to_be(
    plan_file: Path, tmp_path: Path, make_context: ContextMaker
) -> None:
    plan, said = Plan.load(plan_file), list[str]()
    larger = plan.replace(
        target={"size_mm": 1.001 * plan.target.size_mm}, rail={"ranges_mm": [2000]}
    )
    with (
        begin(larger, tmp_path / "s", resume=False) as session,
        open_devices(session.plan, context=make_context(plan_file)) as devices,
    ):
        run_plan(session, devices, warn=said.append, check=False)
    drawn, asked = f"{plan.target.size_mm:.5g} mm", f"{larger.target.size_mm:.5g}"
    assert said == [
        f"in whole pixels the target is {drawn} high instead of {asked}; a fit uses what was shown"
    ]


def test_a_stop_that_the_preflight_ends_at_is_not_driven_to_again(
    plan_file: Path, tmp_path: Path, make_context: ContextMaker
) -> None:
    with (
        begin(plan_file, tmp_path / "s", resume=False) as session,
        open_devices(session.plan, context=make_context(plan_file)) as devices,
    ):
        run_plan(session, devices)
    moves = [event["range_mm"] for event in session.events if event["event"] == "moved"]
    assert moves == [2050.5, 2000, 2050.5]


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (Fault("camera", "card_full", 1, 99), "card is full"),
        (Fault("camera", "timeout", 1, 99), "no picture came"),
        (Fault("camera", "unplug", 3, 99), "dropped off USB"),
        (Fault("rail", "stall", 1, 99), "still not there after 60 s"),
        (Fault("rail", "limit", 2, 99), "ran onto a limit switch"),
        (Fault("display", "sleep", 1, 99), "went to sleep"),
        (Fault("display", "sleep", 4, 99), "went to sleep"),
    ],
)
def test_a_device_that_fails_is_said_before_the_first_frame(
    fault: Fault, words: str, plan_file: Path, tmp_path: Path, make_context: ContextMaker
) -> None:
    error = problems_of(plan_file, tmp_path / "s", make_context, [fault])
    assert isinstance(error, DeviceError)
    assert words in str(error)


@pytest.mark.parametrize(("light", "words"), [(2.5, "is overexposed"), (0.002, "is black")])
def test_wrong_light_is_said(
    light: float, words: str, plan_file: Path, tmp_path: Path, make_context: ContextMaker
) -> None:
    assert words in str(problems_of(plan_file, tmp_path / "s", make_context, light=light))


def test_a_target_that_leaves_the_frame_is_said_of_both_ends(
    plan_file: Path, tmp_path: Path, make_context: ContextMaker
) -> None:
    # half of the picture's 90 panel pixels go round to its other side: there is no carpet to be found
    error = problems_of(plan_file, tmp_path / "s", make_context, turned=45)
    assert isinstance(error, DataError)
    assert str(error).startswith("2 things are not right: (1) at 2050.5 mm: ")
    assert "; (2) at 2000 mm: " in str(error)


def test_everything_that_is_wrong_is_said_at_once(
    plan_file: Path,
    tmp_path: Path,
    make_context: ContextMaker,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: SimpleNamespace(free=10_000))
    battery = Check(("the camera's battery is at 9 %: charge it",), ("manual focus",))
    faults = [Fault("rail", "stall", 1, 3)]
    error = problems_of(
        plan_file, tmp_path / "s", make_context, faults, light=2.5, turned=45, check=battery
    )
    assert isinstance(error, DeviceError)
    for words in (
        "5 things",
        "battery is at 9 %",
        "still not there",
        "is overexposed",
        "at 2000 mm: ",
        "11 photographs take",
    ):
        assert words in str(error)


def test_too_little_room_for_the_whole_plan_is_said(
    plan_file: Path,
    tmp_path: Path,
    make_context: ContextMaker,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: SimpleNamespace(free=50_000))
    error = problems_of(plan_file, tmp_path / "s", make_context)
    assert isinstance(error, InputError)
    assert "11 photographs take" in str(error)


def test_passing_trouble_is_got_over(
    plan_file: Path, tmp_path: Path, make_context: ContextMaker
) -> None:
    faults = [
        Fault("camera", "timeout", 2),
        Fault("rail", "stall", 1),
        Fault("display", "sleep", 2),
    ]
    with (
        begin(plan_file, tmp_path / "s", resume=False) as session,
        open_devices(session.plan, context=make_context(plan_file, faults)) as devices,
    ):
        run_plan(session, devices)
    assert len(session.frames) == 11


SHARP = plan_text(PORTRAIT, simulated([2600, 3000, 3400], 2400.0), {"display": IPAD})


def test_blur_is_the_circle_of_confusion_and_edges_rise_over_as_much(
    tmp_path: Path,
) -> None:
    path = tmp_path / "plan.toml"
    path.write_text(SHARP)
    plan = Plan.load(path)
    target = open_target(plan.target)
    lens = ThinLens(plan.lens.focal_length_mm, plan.lens.f_number)
    with open_devices(plan) as devices:
        devices.camera.configure(ExposureSettings(0.02, 100))
        devices.rail.home()
        devices.display.show(picture_for(plan, devices).grey)
        truth = devices.camera._bench.truth  # type: ignore[attr-defined]
        edges = []
        for range_mm in (2600.0, 3400.0):
            devices.rail.move_to(range_mm - 2400)
            mosaic = read_photograph(
                devices.camera.expose(tmp_path / f"{range_mm:g}").path, plan.sensor
            )
            true_px = (
                float(circle_of_confusion_mm(lens, range_mm, truth.best_focus_mm["G"]))
                / 4.78e-3
            )
            assert true_px > 4  # well above what lens and pixels do by themselves
            assert blur_px(mosaic, target, find_target(mosaic, target)) == pytest.approx(
                true_px, rel=0.33
            )
            grey = grey_image(mosaic.light, mosaic.pattern)
            edges.append((true_px, edge_px(grey)))
    (_, few), (_, many) = sorted(edges)
    assert few < many


class Viewer:
    """An observer that keeps what it is shown."""

    def __init__(self) -> None:
        self.looks: list[Look] = []

    def noted(self, event: str, **fields: object) -> None:
        """Nothing to do."""

    def may_go_on(self) -> None:
        """Lets it."""

    def took(self, *_: object) -> None:
        """Nothing to do."""

    def saw(self, look: Look) -> None:
        self.looks.append(look)


def test_the_photographs_are_kept_beside_the_frames_and_shown_with_the_targets_outline(
    plan_file: Path, tmp_path: Path, make_context: ContextMaker
) -> None:
    viewer = Viewer()
    with (
        begin(plan_file, tmp_path / "s", resume=False) as session,
        open_devices(session.plan, context=make_context(plan_file)) as devices,
    ):
        run_plan(session, replace(devices, observers=[viewer]))
    names = [
        f"preflight_{r}_{what}" for r in ("2050.5", "2000") for what in ("white", "target")
    ]
    assert [look.name for look in viewer.looks] == names
    kept = {path.name for path in (tmp_path / "s" / "preflight").iterdir()}
    assert kept == {f"{name}.dng" for name in names} | {
        f"{name}_seen.jpg" for name in names
    }
    assert verify(Session.open(tmp_path / "s")) == []
    assert remarks(Session.open(tmp_path / "s")) == []
    tiles = viewer.looks[3].corners_px
    assert tiles is not None
    (corners,) = tiles
    seen = cv2.imread(str(tmp_path / "s" / "preflight" / "preflight_2000_target_seen.jpg"))
    assert seen is not None
    # two frame pixels are one of the picture; the outline is the only thing in it that has a colour
    coloured = np.argwhere(np.ptp(seen.astype(int), axis=2) > 60)
    assert coloured.min(axis=0) == pytest.approx(corners.min(axis=0) / 2, abs=2.5)
    assert coloured.max(axis=0) == pytest.approx(corners.max(axis=0) / 2, abs=2.5)


def test_a_photograph_in_which_no_target_was_found_is_kept_shown_and_named(
    plan_file: Path, tmp_path: Path, make_context: ContextMaker
) -> None:
    plan_file.write_text(plan_file.read_text().replace("[2000, 2050.5]", "[2000]"))
    error = problems_of(plan_file, tmp_path / "s", make_context, turned=45)
    (named,) = re.findall(r"see (\S+)$", str(error))
    assert Path(named) == tmp_path / "s" / "preflight" / "preflight_2000_target_seen.jpg"
    assert cv2.imread(named) is not None
    # the next preflight takes the place of this one
    assert len(list((tmp_path / "s" / "preflight").iterdir())) == 4


def test_no_target_at_all_is_an_error_of_the_target(
    plan_file: Path, tmp_path: Path, make_context: ContextMaker
) -> None:
    plan_file.write_text(plan_file.read_text().replace("[2000, 2050.5]", "[2000]"))
    assert isinstance(
        problems_of(plan_file, tmp_path / "s", make_context, turned=45), TargetError
    )


def test_of_a_grid_the_field_that_it_covers_is_told(
    plan_file: Path, tmp_path: Path, make_context: ContextMaker
) -> None:
    grid = {"grid": [2, 3], "pitch_mm": 13.5}
    plan = Plan.load(plan_file).replace(target=grid)
    plan_file.write_text(plan.to_toml())
    said: list[str] = []
    with (
        begin(plan_file, tmp_path / "s", resume=False) as session,
        open_devices(session.plan, context=make_context(plan_file)) as devices,
    ):
        run_plan(session, devices, warn=said.append)
    events = {event["event"]: event for event in session.events}
    assert events["began"]["shown_size_mm"] == pytest.approx([9.0, 9.0])
    assert events["began"]["shown_pitch_mm"] == pytest.approx(13.5)
    assert events["preflight"]["measured"]["2000 mm"]["targets"] == 6
    (words,) = said
    cover = re.search(
        r"at 2000 mm 6 of the grid's 6 .*cover (\d+)% of its width and (\d+)% of its height",
        words,
    )
    assert cover is not None
    # 22.5 × 36 mm through a thin lens of 50 mm, on pixels of 6 um
    rows, cols = read_photograph(session.frames[-1].path, plan.sensor).shape
    side = 50 / 1950 / 6e-3
    assert [int(percent) for percent in cover.groups()] == pytest.approx(
        [100 * 36 * side / cols, 100 * 22.5 * side / rows], abs=4
    )
