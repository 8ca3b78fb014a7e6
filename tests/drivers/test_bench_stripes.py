"""A panel's own pixels on the bench: where its stripes are, and how much light they give."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from labkit.drivers.simulated.bench import Bench
from labkit.drivers.simulated.display import SimulatedDisplay
from labkit.drivers.simulated.scene import FineGrid, Glass, project, render
from labkit.drivers.simulated.world import (
    BenchSettings,
    TrueLens,
    TruePanel,
    TruePose,
    TrueRail,
    TrueSensor,
)
from labkit.types import Floats, Floats32

STRIPES = TruePanel(pixels=(60, 60), layout="rgb-stripes")


def seen(
    colour: str,
    pixel_px: float,
    roll_deg: float,
    grid: FineGrid,
    rows: int = 5,
    cols: int = 5,
) -> Floats32:
    """Fine samples of a white panel of few pixels, each pixel_px of the camera's pixels wide, its middle in the frame's."""
    codes = np.full((rows, cols), 255, dtype=np.int16)
    glass = Glass(codes, np.ones((rows, cols), dtype=np.float32), 1.0, STRIPES.lit(colour))
    camera = np.diag([pixel_px, pixel_px, 1.0])
    camera[:2, 2] = (grid.cols - 1) / 2, (grid.rows - 1) / 2
    return render(glass, camera @ project((0, 0), roll_deg, (0, 0), 1.0), grid)


@pytest.mark.parametrize(
    ("colour", "left"), [("R", 0.03), ("G", 1 / 3 + 0.03), ("B", 2 / 3 + 0.03)]
)
def test_a_point_sampler_sees_each_stripe_where_it_is(colour: str, left: float) -> None:
    grid = FineGrid(
        20, 20, 50, 0
    )  # a pixel of the panel is 10 of the camera's, 500 samples
    lines = seen(colour, 10.0, 0.0, grid, 2, 2)[[0, 200]]
    left_of = np.arange(1000) / 500  # in panel pixels; a sample is 1/500 wide
    lit = np.zeros(1000)
    for pixel in (0, 1):  # the margins of a stripe within its third are 0.09 of that
        overlap = np.minimum(left_of + 1 / 500, pixel + left + 0.82 / 3) - np.maximum(
            left_of, pixel + left
        )
        lit += 500 * np.clip(overlap, 0, None)
    # black for the upper 0.06 of a pixel; a side that does not slant is drawn 1e-6 of a panel pixel wide: 2.6e-4
    np.testing.assert_allclose(lines, [0 * lit, lit / (0.82 / 3 * 0.88)], atol=5e-4)


@pytest.mark.parametrize(
    ("pixel_px", "roll_deg"), [(0.3, 2.0), (1.0, 0.0), (1.7, 13.0), (3.0, 40.0)]
)
def test_stripes_give_as_much_light_as_whole_pixels_wherever_they_lie(
    pixel_px: float, roll_deg: float
) -> None:
    grid = FineGrid(24, 24, 6, 0)
    y, x = np.meshgrid(grid.centres(24) - 11.5, grid.centres(24) - 11.5, indexing="ij")
    turn = np.radians(roll_deg)
    for number, colour in enumerate("RGB"):
        light = seen(colour, pixel_px, roll_deg, grid).astype(float) / grid.samples**2
        total = light.sum()
        middle = np.array([(light * x).sum(), (light * y).sum()]) / total / pixel_px
        expected = (number - 1) / 3 * np.array([np.cos(turn), np.sin(turn)])
        # of the smallest, 25 in all, 0.6 % and 0.012 pixels: the panel's rim is drawn by 34 points a sample
        assert total == pytest.approx(25 * pixel_px**2, rel=0.012 if pixel_px < 1 else 5e-4)
        np.testing.assert_allclose(middle, expected, atol=0.025 if pixel_px < 1 else 2e-3)


@pytest.mark.parametrize(
    ("pixel_px", "roll_deg"), [(0.3, 2.0), (1.0, 2.0), (2.5, 2.0), (0.7, 40.0)]
)
def test_six_samples_a_pixel_draw_stripes_as_thirty_six_do(
    pixel_px: float, roll_deg: float
) -> None:
    pictures = []
    for samples in (6, 36):
        fine = seen("G", pixel_px, roll_deg, FineGrid(24, 24, samples, 0), 120, 120)
        pictures.append(fine.reshape(24, samples, 24, samples).mean(axis=(1, 3)))
    # 3e-4 as measured; 5.5e-3 at 40 degrees, where a sample's square is a lozenge to the panel
    assert np.sqrt(np.mean((pictures[0] - pictures[1]) ** 2)) < (
        6e-4 if roll_deg < 5 else 0.011
    )


def close(layout: Literal["none", "rgb-stripes"], picture: Floats) -> Bench:
    """A bench whose camera sees each pixel of the panel 2.5 of its own wide."""
    lens = TrueLens(
        f_number=5.6,
        pupil_magnification=1.0,
        best_focus_mm=dict.fromkeys("RGB", 500.0),
        aberration_waves=0,
    )
    pitch_mm = 2.5 * 4.78e-3 * (500 - 70) / 70
    settings = BenchSettings(
        lens=lens,
        sensor=TrueSensor(rows=32, cols=32, hot_pixels=0, dead_pixels=0),
        panel=replace(
            STRIPES, pitch_mm=pitch_mm, layout=layout, unevenness=0.0, contrast=1e9
        ),
        rail=TrueRail(range_at_zero_mm=500.0, scatter_mm=0.0),
        pose=TruePose(0, 0, 0, 0),
        halo_um=120.0,
    )
    bench = Bench(settings)
    bench.stand(0.0)
    bench.light((picture * 255).astype(np.uint8))
    return bench


def test_a_camera_close_by_sees_the_stripes_of_white_and_their_mean_is_whites() -> None:
    bench = close("rgb-stripes", np.ones((60, 60)))
    for colour in "RGB":
        picture = bench.irradiance(colour)
        assert picture[6:26, 6:26].mean() == pytest.approx(
            1, abs=1e-5
        )  # over eight pixels of the panel each way
        assert picture.std() > 0.5
    assert bench._picture().std() > 0.5
    assert bench.truth.visits == ()  # a flat is no visit
    assert close("none", np.ones((60, 60)))._picture().std() == 0


def test_colours_stand_a_third_of_a_panel_pixel_apart() -> None:
    bench = close("rgb-stripes", np.ones((1, 1)))
    x = np.arange(32.0)
    lines = [bench.irradiance(colour).sum(axis=0, dtype=float) for colour in "RGB"]
    red, green, blue = ((line * x).sum() / line.sum() for line in lines)
    # 0.81 and 0.83 as measured: light that falls beyond the frame draws each mean to the middle
    assert green - red == pytest.approx(2.5 / 3, abs=0.04)
    assert blue - green == pytest.approx(2.5 / 3, abs=0.04)


def test_a_display_of_stripes_says_so_and_a_colour_of_none_is_refused() -> None:
    assert SimulatedDisplay(close("rgb-stripes", np.ones((1, 1)))).panel.subpixels == "rgb"
    assert SimulatedDisplay(close("none", np.ones((1, 1)))).panel.subpixels == "none"
    with pytest.raises(ValueError, match="shines in R, G and B"):
        STRIPES.lit("infrared")
    with pytest.raises(ValueError, match=r"outside 0\.\.1"):
        replace(STRIPES, lit_down=1.2).lit("R")
