"""The bench's image formation against closed forms and against itself on finer grids."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from labkit.drivers.simulated.bench import Bench
from labkit.drivers.simulated.optics import halo_beyond, point_spread
from labkit.drivers.simulated.scene import (
    FineGrid,
    Glass,
    carry,
    photograph,
    project,
    render,
    transform,
)
from labkit.drivers.simulated.world import BenchSettings, TrueSensor
from labkit.targets.sierpinski import carpet_cells


def half_plane(
    edge_px: float, roll_deg: float, grid: FineGrid
) -> np.ndarray[tuple[int, int], np.dtype[np.float32]]:
    """Fine samples of a panel that is white on its right half; the edge crosses the frame's middle row at edge_px."""
    codes = np.zeros((400, 400), dtype=np.int16)
    codes[:, 200:] = 255
    glass = Glass(codes, (codes / 255).astype(np.float32), 1.0)
    turn = project((0, 0), roll_deg, (0, 0), 1.0)
    camera = np.array([[1.0, 0, edge_px], [0, 1.0, (grid.rows - 1) / 2], [0, 0, 1]])
    return render(glass, camera @ turn, grid)


@pytest.mark.parametrize("fill_factor", [1.0, 0.5])
def test_a_blurred_edge_has_the_closed_form_of_diffraction_and_pixel(
    fill_factor: float,
) -> None:
    pitch_um, wavelength_nm, f_number, edge_px = 5.0, 550.0, 4.0, 7.3
    grid = FineGrid(16, 16, 30, 2400)
    psf = point_spread({}, wavelength_nm, f_number, pitch_um / grid.samples, grid.reach)
    halo = halo_beyond(
        wavelength_nm, f_number, pitch_um / grid.samples, grid.reach, grid.samples, 400
    )
    seen = photograph(
        transform(half_plane(edge_px, 0.0, grid), grid), psf, fill_factor, halo
    )
    cutoff = pitch_um / (wavelength_nm * 1e-3 * f_number)  # cycles per pixel

    def integrand(nu: float, x: float) -> float:
        s = nu / cutoff
        mtf = 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s * s))
        return float(mtf * np.sinc(nu * np.sqrt(fill_factor)) * 2 * x * np.sinc(2 * nu * x))

    expected = [
        0.5 + quad(integrand, 0, cutoff, args=(j - edge_px,), limit=200)[0]
        for j in range(16)
    ]
    # 1e-4 is what comes from farther than the halo goes, 2 mm; where the edge itself lies it is 2e-4
    np.testing.assert_allclose(seen[8], expected, atol=3e-4)


def test_a_fine_sample_holds_the_area_of_white_within_it() -> None:
    grid = FineGrid(12, 12, 8, 0)
    scene = half_plane(5.37, 20.0, grid)
    y, x = np.meshgrid(*2 * [np.arange(12.0)], indexing="ij")
    pixels = scene.reshape(12, 8, 12, 8).mean(axis=(1, 3))
    away = (x - 5.37) * np.cos(np.radians(20)) + (y - 5.5) * np.sin(np.radians(20))
    assert np.all(pixels[away < -0.71] == 0)
    assert np.all(pixels[away > 0.71] == 1)
    # the edge passes the frame's middle: by symmetry each row's white width is its distance to the right rim
    expected = 11.5 - (5.37 - (y[:, 0] - 5.5) * np.tan(np.radians(20)))
    np.testing.assert_allclose(pixels.sum(axis=1), expected, atol=5e-3)


def test_the_room_around_the_panel_is_dark() -> None:
    glass = Glass(
        np.full((4, 6), 255, dtype=np.int16), np.ones((4, 6), dtype=np.float32), 1.0
    )
    scene = render(
        glass, np.array([[1.0, 0, 5.5], [0, 1.0, 5.5], [0, 0, 1]]), FineGrid(12, 12, 4, 0)
    )
    lit = scene.reshape(12, 4, 12, 4).mean(axis=(1, 3))
    np.testing.assert_allclose(lit.sum(), 24, rtol=1e-6)
    np.testing.assert_allclose(lit[4:8, 3:9], 1)


def test_perspective_makes_what_is_farther_smaller() -> None:
    matrix = project((0.0, 10.0), 0.0, (0.0, 0.0), 100.0)
    right, _ = carry(matrix, np.array([-1.0, 1.0]), np.array([0.0, 0.0]))
    tilt = np.radians(10)
    expected = [-np.cos(tilt) / (100 + np.sin(tilt)), np.cos(tilt) / (100 - np.sin(tilt))]
    np.testing.assert_allclose(right, expected)


def test_a_positive_roll_turns_the_picture_clockwise() -> None:
    right, down = carry(
        project((0, 0), 30.0, (0, 0), 1.0), np.array([1.0]), np.array([0.0])
    )
    assert (right[0], down[0]) == pytest.approx((np.cos(np.pi / 6), 0.5))


@pytest.fixture(scope="module")
def bench() -> Bench:
    bench = Bench(replace(BenchSettings(), sensor=TrueSensor(rows=64, cols=64)))
    bench.turn_screw(60.0)
    bench.stand(60.0)
    bench.light((np.kron(carpet_cells(3), np.ones((4, 4))) * 255).astype(np.uint8))
    return bench


# how far the halo goes does not depend on the samples: 8 are as few as a pupil at f/2.8 allows
@pytest.mark.parametrize(
    ("usual", "better"), [((10, 250.0), (18, 250.0)), ((8, 750.0), (8, 1000.0))]
)
def test_a_finer_grid_or_a_wider_halo_changes_little_beside_the_noise(
    bench: Bench, usual: tuple[int, float], better: tuple[int, float]
) -> None:
    coarse, finer = bench.irradiance("B", *usual), bench.irradiance("B", *better)
    noise = np.sqrt(23_000 * np.maximum(finer, 0) + 6)
    # an error of 0.12 standard deviations adds 0.015 to chi-square per pixel
    assert np.sqrt(np.mean((23_000 * (coarse - finer) / noise) ** 2)) < 0.12
