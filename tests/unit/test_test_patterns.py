"""Pictures to set a bench up by: seen as a camera or a ruler would."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from labkit.cli.console import Console
from labkit.devices.protocols import PanelInfo
from labkit.devices.serve_target import panel_plans
from labkit.devices.test_patterns import PATTERNS, pattern
from labkit.errors import PlanError
from labkit.panel.panels import PANELS


@pytest.mark.parametrize("name", PATTERNS)
@pytest.mark.parametrize("pixels", [(1, 1), (7, 300), (601, 803), (1536, 2048)])
def test_every_pattern_fills_every_panel(name: str, pixels: tuple[int, int]) -> None:
    made = pattern(name, PanelInfo(pixels, 0.1))
    assert made.shape == pixels
    assert made.dtype == np.uint8


def test_grey_is_half_the_light_of_white() -> None:
    level = float(pattern("grey", PanelInfo((2, 2), 0.1, gamma=2.2))[0, 0])
    assert (level / 255) ** 2.2 == pytest.approx(
        0.5, abs=0.5 * 2.2 / level + 1e-3
    )  # half a step of grey


def test_opencv_finds_the_alignment_marks_in_their_corners() -> None:
    made = pattern("alignment", PANELS["ipad-9.7-retina"])
    detector = cv2.aruco.ArucoDetector(
        cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    )
    corners, found, _ = detector.detectMarkers(made)
    assert found is not None
    assert sorted(found.ravel()) == [0, 1, 2, 3]
    centre = {
        int(mark): corner[0].mean(axis=0)
        for mark, corner in zip(found.ravel(), corners, strict=True)
    }
    assert centre[0][0] < 1024 < centre[1][0]
    assert centre[0][1] < 768 < centre[3][1]
    assert centre[2][0] > 1024 > centre[3][0]


def test_the_ruler_of_the_alignment_marks_is_in_millimetres() -> None:
    panel = PanelInfo((1000, 1600), 0.08)
    made = pattern("alignment", panel)
    ticks = np.flatnonzero(
        made[500 - 35, 120:790] == 255
    )  # only the ten-millimetre ticks are this long
    assert np.diff(ticks) * panel.pitch_mm == pytest.approx(10, abs=0.08)
    assert ticks.size == 5  # 125 pixels each, counted from the middle: 175 to 675


def test_the_focus_aid_has_lines_one_pixel_wide() -> None:
    made = pattern("focus", PanelInfo((800, 1200), 0.1)).astype(int)
    assert np.any(
        np.all(np.abs(np.diff(made[60:90], axis=1))[:, :, None] == 255, axis=(0, 2))
    )


def test_the_qr_code_on_the_terminal_reads_back_as_the_url(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    url = "http://192.168.1.23:8642/sMp9leHMUA84e8eQ_2I-Xg/screen"
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    Console().link("Open this", url)
    first, *rows = capsys.readouterr().err.splitlines()
    assert first == f"Open this: {url}"
    halves = {"█": (255, 255), "▀": (255, 0), "▄": (0, 255), " ": (0, 0)}
    bits = [[halves[cell][half] for cell in row] for row in rows if row for half in (0, 1)]
    code = np.kron(np.array(bits, dtype=np.uint8), np.ones((8, 8), dtype=np.uint8))
    assert (
        cv2.QRCodeDetector().detectAndDecode(np.pad(code, 40, constant_values=255))[0]
        == url
    )


def test_a_quiet_console_names_no_page_and_a_pipe_gets_no_code(
    capsys: pytest.CaptureFixture[str],
) -> None:
    Console(quiet=True).link("Open this", "http://h/")
    Console().link("Open this", "http://h/")
    assert capsys.readouterr().err == "Open this: http://h/\n"


def test_panels_by_name_become_displays_on_one_server() -> None:
    (only,) = panel_plans("sierpinski:order=3", ["ipad-10.2"], "127.0.0.1:1")
    assert only[0] == "web://127.0.0.1:1"
    addresses = [
        address
        for address, _ in panel_plans("x", ["ipad-10.2", "ipad-pro-11"], "0.0.0.0:1")
    ]
    assert addresses == ["web://0.0.0.0:1/1", "web://0.0.0.0:1/2"]
    with pytest.raises(PlanError, match="which panel"):
        panel_plans("sierpinski:order=3", [], "127.0.0.1:1")
