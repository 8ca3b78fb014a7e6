"""`labkit camera focus`: photographs one after another, how sharp each is, and where the target is in them."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from labkit.acquisition.camera_check import LoneCamera
from labkit.acquisition.focusing import FRAME_SOURCE, LIVE_VIEW_SOURCE, FocusReading, focus
from labkit.acquisition.sequence import picture_for
from labkit.cli import run
from labkit.cli.focus import bars, line
from labkit.devices.protocols import Camera
from labkit.devices.registry import open_devices
from labkit.drivers.simulated.dng import RawTags, write_raw
from labkit.finder.preview import Look
from labkit.plan import Plan

from .conftest import ContextMaker


class Watcher:
    """An observer that is shown photographs."""

    def __init__(self) -> None:
        self.looks: list[Look] = []
        self.events: list[str] = []

    def noted(self, event: str, **fields: object) -> None:
        self.events.append(event)

    def took(self, *_: object) -> None:
        """Nothing to do."""

    def may_go_on(self) -> None:
        """Lets it."""

    def saw(self, look: Look) -> None:
        self.looks.append(look)


def first(alone: LoneCamera, frames: int, watcher: Watcher) -> list[FocusReading]:
    """Watch until so many photographs were shown: each as it comes, and judged."""
    return list(focus(alone, [watcher], lambda: len(watcher.looks) < 2 * frames))


def edge(width: float) -> NDArray[np.float64]:
    """(200, 400), dark and light, with an edge that rises linearly over so many pixels."""
    return np.tile(np.clip((np.arange(400.0) - 200 + width / 2) / width, 0, 1), (200, 1))


def test_the_target_is_found_and_outlined_on_the_simulated_bench(
    plan_file: Path, make_context: ContextMaker
) -> None:
    watcher, plan = Watcher(), Plan.load(plan_file)
    with open_devices(plan, context=make_context(plan_file)) as devices:
        alone = LoneCamera(devices.camera, plan, planned=True)
        (dark,) = first(alone, 1, watcher)
        devices.rail.home()
        devices.rail.move_to(50.0)
        devices.display.show(picture_for(plan, devices).grey)
        (lit,) = first(alone, 2, watcher)
        visit = devices.camera._bench.truth.visits[-1]  # type: ignore[attr-defined]
    assert (dark.edge_px, dark.corners_px) == (None, None)
    assert dark.note.startswith("is black")
    assert lit.note == ""
    size = picture_for(plan, devices).size_mm[0]
    upper_left = np.array(visit.target_to_pixels) @ [-size / 2, -size / 2, 1]
    assert lit.corners_px is not None
    assert lit.corners_px[0] == pytest.approx(
        (upper_left[1] / upper_left[2], upper_left[0] / upper_left[2]), abs=0.5
    )
    unjudged, look = watcher.looks[2:]
    assert (unjudged.name, unjudged.corners_px, unjudged.note) == ("frame 1", None, "")
    assert (look.name, look.edge_px) == ("frame 1", lit.edge_px)
    assert look.corners_px is not None
    assert np.array_equal(np.array([lit.corners_px]), look.corners_px)
    assert set(watcher.events) == {"focusing"}


class LiveView:
    """A camera whose live view becomes sharper; without one it would have to expose."""

    def __init__(self, widths: list[float]) -> None:
        self._widths = widths

    def identify(self) -> None:
        """Nobody asks."""

    def expose(self, path: Path) -> None:
        raise AssertionError("a live view wears no shutter")

    def preview(self, path: Path) -> Path:
        grey = np.rint(255 * (0.02 + 0.9 * edge(self._widths.pop(0))) ** (1 / 2.2)).astype(
            np.uint8
        )
        made = path.with_suffix(".jpg")
        cv2.imwrite(str(made), np.repeat(grey[:, :, None], 3, axis=2))
        return made


def test_the_live_view_is_taken_where_there_is_one(plan_file: Path) -> None:
    camera: Camera = LiveView([20.0, 10.0, 5.0])  # type: ignore[assignment]
    readings = first(LoneCamera(camera, Plan.load(plan_file), planned=False), 3, Watcher())
    assert {reading.source for reading in readings} == {LIVE_VIEW_SOURCE}
    edges = [reading.edge_px or 0.0 for reading in readings]
    assert edges == sorted(edges, reverse=True)
    assert edges[0] > 2 * edges[2]


def test_a_line_says_how_sharp_it_is_beside_those_before() -> None:
    reading = FocusReading(
        1, FRAME_SOURCE, 6.0, 0.0, ((0, 0), (0, 9), (9, 9), (9, 0)), 2.0, 31.4, ""
    )
    history = [
        reading,
        replace(reading, number=2, edge_px=3.0),
        replace(reading, number=3, edge_px=4.0),
    ]
    assert line(history) == (
        "frame 3; edges rise over 4.0 px, best 3.0 █▁▃; clipped 0 %; target: blur 2.0 px, 31 px inside the frame"
    )
    dark = replace(reading, number=4, edge_px=None, corners_px=None, note="is black")
    assert line([*history, dark]) == "frame 4; clipped 0 %; is black"
    assert bars([5.0] * 30) == "▁" * 24


def test_ctrl_c_ends_it_and_names_the_sharpest(photograph: Path) -> None:
    pytest.importorskip("gphoto2")
    counts = 600 + 8000 * edge(8.0) + np.random.default_rng(1).normal(0, 10, (200, 400))
    tags = RawTags(black_level=600, white_level=16383, exposure_s=0.02, iso=200)
    write_raw(photograph, np.clip(counts, 0, 16383).astype(np.uint16), tags)
    command = [
        sys.executable,
        "-c",
        "from labkit.cli import main; main()",
        "camera",
        "focus",
    ]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, env=dict(os.environ)
    ) as running:
        try:
            assert running.stdout is not None
            lines = [running.stdout.readline() for _ in range(2)]
            running.send_signal(signal.SIGINT)
            rest = running.stdout.read()
            assert running.wait(timeout=100) == 0
        finally:
            running.kill()
    assert lines[1].startswith("frame 2; edges rise over ")
    assert rest.splitlines()[-1].startswith("sharpest: frame ")


def test_a_rail_is_moved_only_where_the_plan_has_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from labkit.cli import run
    from tests.plans import SMALL, plan_text

    plan = tmp_path / "plan.toml"
    plan.write_text(
        plan_text(SMALL, {"camera": {"address": "gphoto2:", "exposure_s": 0.02}})
    )
    assert run(["camera", "focus", str(plan), "--range", "2000", "--json"]) == 2
    told = capsys.readouterr()
    assert "--range 2000: to move a rail it takes a plan with [rail]" in told.err
    assert json.loads(told.out)["error"]["kind"] == "PlanError"


def test_a_range_beyond_the_rail_is_answered_with_those_that_it_reaches(
    plan_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["camera", "focus", str(plan_file), "--range", "3"]) == 2
    assert re.search(
        r"--range 3: the rail reaches [\d.]+ to [\d.]+ mm\n$", capsys.readouterr().err
    )
