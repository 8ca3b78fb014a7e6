"""A photograph of the wedge, made by brute force, gives back the curve that it was made with."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from scipy.optimize import least_squares

from labkit.calibration import tone_wedge
from labkit.calibration.tone_wedge import PATCHES, measure_tone
from labkit.cli import run
from labkit.devices.protocols import PanelInfo
from labkit.errors import DataError, PlanError, TargetError
from labkit.panel.picture import panel_picture
from labkit.photographs.decoding import read_photograph
from labkit.plan import Sensor
from labkit.target.target import CellTarget, open_target
from labkit.types import Floats

Curve = Callable[[Floats], Floats]


def picture_style(light: Floats) -> Floats:
    """A camera's rendering, by hand: more contrast than sRGB, a shoulder in the lights. light: 0 to 1."""
    return np.asarray(
        np.log1p(40 * light**1.25) / np.log1p(40) * (1 - 0.12 * (1 - light) ** 3)
    )


def gamma(light: Floats) -> Floats:
    return np.asarray(light ** (1 / 2.2))


def light_of_wedge(
    blur_px: float = 6.0, white: float = 0.9, fall: float = 0.15, seed: int = 1
) -> Floats:
    """(600, 900) light of a panel that shows the wedge, seen a little from the side: its own gamma has no say."""
    panel = PanelInfo((600, 1200), 0.1, gamma=3.1)
    shown = panel_picture(open_target("wedge:size_mm=51.2"), panel).grey / 255.0
    assert set(np.unique(shown)) == {0.0, 1.0}
    glass = np.full(panel.pixels, 0.002)
    top, left = (
        (whole - part) // 2 for whole, part in zip(panel.pixels, shown.shape, strict=True)
    )
    glass[top : top + shown.shape[0], left : left + shown.shape[1]] += shown
    rows, cols = 600, 900
    corners = np.array(
        [[0, 0], [panel.pixels[1], 0], panel.pixels[::-1], [0, panel.pixels[0]]], np.float32
    )
    seen = np.array([[60, 90], [850, 70], [840, 520], [50, 500]], np.float32)
    at = cv2.getPerspectiveTransform(corners, 2 * seen)  # twice as fine, and then binned
    fine = cv2.warpPerspective(glass, at, (2 * cols, 2 * rows), flags=cv2.INTER_AREA)
    light = (
        cv2.GaussianBlur(fine, (0, 0), 2 * blur_px)
        .reshape(rows, 2, cols, 2)
        .mean(axis=(1, 3))
    )
    y, x = np.mgrid[:rows, :cols] / cols - 0.5
    light = (
        white * light * (1 - fall * (x**2 + y**2) * 4 - 0.05 * x) + 0.004
    )  # falls off, and some stray light
    return np.asarray(
        np.clip(
            light * (1 + np.random.default_rng(seed).normal(scale=0.01, size=light.shape)),
            0,
            1,
        )
    )


def photograph(path: Path, light: Floats, curve: Curve, quality: int = 92) -> Path:
    Image.fromarray(np.rint(255 * curve(light)).astype(np.uint8)).save(
        path, quality=quality
    )
    return path


def undone(tone: tone_wedge.Tone, curve: Curve, folder: Path) -> float:
    """Largest error of the light that a plan with the measured curve gives, relative to full scale, where it was measured."""
    measured = tomllib.loads(tone.to_toml())["sensor"]
    stored = np.arange(256, dtype=np.uint8)
    Image.fromarray(stored[None].repeat(2, 0)).save(folder / "ramp.png")
    mosaic = read_photograph(
        folder / "ramp.png", Sensor.from_tables({"pixel_pitch_um": 5.0, **measured})
    )
    fine = np.linspace(0, 1, 20_001)
    seen = (stored / 255 > tone.numbers.min()) & (stored / 255 < tone.numbers.max())
    want, got = (
        np.interp(stored / 255, curve(fine), fine)[seen],
        mosaic.counts[0, seen] / 65535,
    )
    factor, constant = np.polyfit(got, want, 1)  # both are every fit's own
    return float(np.max(np.abs(factor * got + constant - want)))


def light_std(tone: tone_wedge.Tone, curve: Curve) -> float:
    """The largest standard error of light that the measured numbers have, of the light at full scale."""
    fine = np.linspace(0, 1, 20_001)
    slope = np.interp(tone.numbers[0], curve(fine), np.gradient(fine, curve(fine)))
    return float(np.max(tone.std[0] * slope))


def test_the_wedge_has_known_greys_each_twice() -> None:
    wedge = open_target("wedge:size_mm=10")
    assert isinstance(wedge, CellTarget)
    blocks = wedge.cells.reshape(PATCHES[0], 64, PATCHES[1], 64)
    duty, times = np.unique(blocks.mean(axis=(1, 3)), return_counts=True)
    np.testing.assert_allclose(duty[[0, 1, 7, -1]], [0, 1 / 64, 1 / 4, 1])
    assert set(times) == {2}
    assert set(np.unique(wedge.cells)) == {0.0, 1.0}


@pytest.mark.parametrize(("curve", "limit"), [(gamma, 0.008), (picture_style, 0.006)])
def test_the_curve_of_a_simulated_photograph_comes_back(
    tmp_path: Path, curve: Curve, limit: float
) -> None:
    tone = measure_tone(photograph(tmp_path / "wedge.jpg", light_of_wedge(), curve))
    error = undone(tone, curve, tmp_path)
    assert error < limit  # 0.0041 and 0.0033 were measured
    assert error < 4 * light_std(tone, curve) < 0.02


def test_a_lens_that_darkens_the_corners_leaves_the_curve_as_it_is(
    tmp_path: Path, found: None
) -> None:
    """By a quarter at the ends of the wedge: both places of some steps stand there."""
    tone = measure_tone(
        photograph(tmp_path / "wedge.jpg", light_of_wedge(fall=0.25), gamma)
    )
    assert 0.2 < tone.uneven < 0.25

    def error(at: Floats) -> Floats:
        return np.asarray(gamma(at[0] * tone.light + at[1]) - tone.numbers[0])

    white, black = 0.89, 0.005
    rest = error(least_squares(error, [white, black]).x)
    assert np.abs(rest).max() < 0.012  # 0.0063; 0.020 without the fall-off's fourth order


@pytest.fixture
def found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The wedge is where it is: it takes five seconds to find."""
    corners = np.array([[118.0, 112.0], [104.0, 785.0], [485.0, 777.0], [470.0, 104.0]])
    monkeypatch.setattr(tone_wedge, "find_target", lambda image, target: corners)


def test_colours_have_a_curve_each(tmp_path: Path, found: None) -> None:
    light = light_of_wedge()
    colours = np.dstack([gamma(0.7 * light), picture_style(light), gamma(0.5 * light)])
    Image.fromarray(np.rint(255 * colours).astype(np.uint8)).save(tmp_path / "wedge.png")
    tone = measure_tone(tmp_path / "wedge.png")
    assert tone.numbers.shape == tone.std.shape == (3, 16)
    # white is 0.9 of full scale there, but for what falls off towards the sides
    white = np.array([0.63, 0.9, 0.45])
    wanted = np.diag([gamma(white), picture_style(white), gamma(white)])
    np.testing.assert_allclose(tone.numbers[:, -1], wanted, rtol=0.02)


@pytest.mark.parametrize(
    ("light", "curve", "words"),
    [
        (
            light_of_wedge(white=1.4),
            gamma,
            r"of the 32 steps are clipped at full scale: expose less",
        ),
        (
            light_of_wedge(blur_px=2.0),
            gamma,
            r"the half-tone's dots are resolved, .* defocus the lens",
        ),
        (
            light_of_wedge(),
            lambda light: 0.9 * np.minimum(light, 1.2 - light),
            r"the curve does not rise: light of 0\.\d+ gives",
        ),
    ],
)
def test_steps_that_cannot_be_used_are_refused(
    tmp_path: Path, found: None, light: Floats, curve: Curve, words: str
) -> None:
    with pytest.raises(DataError, match=words):
        measure_tone(photograph(tmp_path / "wedge.png", light, curve))


def test_a_picture_without_a_wedge_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    noise = np.random.default_rng(1).uniform(size=(90, 160))
    path = photograph(tmp_path / "noise.png", noise, gamma)
    with pytest.raises(
        TargetError, match=r"no wedge found: show labkit target serve wedge:size_mm=100"
    ):
        measure_tone(path)
    assert run(["camera", "tone", str(path)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert run(["camera", "tone", str(tmp_path)]) == 2
    assert capsys.readouterr().err == f"labkit: {tmp_path}: a folder; a file is needed\n"


def test_the_command_writes_what_a_plan_takes(tmp_path: Path, found: None) -> None:
    path, out = (
        photograph(tmp_path / "wedge.png", light_of_wedge(), gamma),
        tmp_path / "tone.toml",
    )
    assert run(["camera", "tone", str(path), "--out", str(out)]) == 0
    sensor = Sensor.from_tables(
        {"pixel_pitch_um": 5.0, **tomllib.loads(out.read_text())["sensor"]}
    )
    assert len(sensor.tone_curve.light) == 16  # type: ignore[union-attr]
    assert (
        run(["camera", "tone", str(path), "--out", str(out)]) == 2
    )  # nothing is overwritten


@pytest.mark.parametrize(
    "wrong", ["gamma", {"light": [0, 1], "numbers": [[0.5, 0.5]]}, {"light": [0, 1]}]
)
def test_a_tone_curve_that_is_none_is_refused(wrong: object) -> None:
    with pytest.raises(PlanError, match="tone_curve"):
        Sensor.from_tables({"pixel_pitch_um": 5.0, "tone_curve": wrong})
