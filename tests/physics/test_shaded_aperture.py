"""The shaded aperture, against a circle's area, a fine raster and integrated chords."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad

from labkit.experiments.methods.shaded_aperture import disc_area


@pytest.mark.parametrize("radius", [3.3, 20.0, 57.9])
def test_a_shaded_disc_has_the_area_of_a_circle(radius: float) -> None:
    half = int(np.ceil(radius)) + 1
    assert disc_area(np.arange(-half, half + 1.0), radius).sum() == pytest.approx(
        np.pi * radius**2, rel=1e-12
    )


def test_each_shaded_sample_holds_the_area_that_a_fine_raster_counts() -> None:
    radius, many = 4.37, 200
    fine = (np.arange(11 * many) + 0.5) / many - 5.5
    inside = np.hypot(fine[:, None], fine) < radius
    counted = inside.reshape(11, many, 11, many).mean(axis=(1, 3))
    # a raster errs by less than one fine sample along the edge, which is at most two samples long
    assert np.abs(disc_area(np.arange(-5.0, 6), radius) - counted).max() < 2 / many


def test_no_radius_rounds_to_a_hole_in_the_pupil() -> None:
    # of these the square by Python's power and that by NumPy's differ in the last digit, as of one in 2800
    for radius in (34.29393254658977, 77.4230638885693, 106.99580188058677):
        area = disc_area(np.arange(-np.ceil(radius), np.ceil(radius) + 1), radius)
        assert area.sum() == pytest.approx(np.pi * radius**2, rel=1e-12)


@pytest.mark.parametrize("radius", [0.3, 0.5, 0.8, 1.5, 6.02])
def test_each_shaded_sample_holds_the_exact_area_of_small_and_large_discs(
    radius: float,
) -> None:
    at = np.arange(-7.0, 8.0)

    def chord(
        x: float, bottom: float
    ) -> float:  # of the disc at x, inside a sample from bottom to bottom + 1
        half = np.sqrt(max(radius**2 - x**2, 0.0))
        return float(max(min(half, bottom + 1) - max(-half, bottom), 0.0))

    for row, col in [(0, 0), (0, 1), (1, 1), (-2, 0), (4, -4), (3, 5), (-6, 0), (6, 1)]:
        left, bottom = col - 0.5, row - 0.5
        kinks = [left, left + 1, -radius, radius]
        kinks += [
            s * np.sqrt(max(radius**2 - y**2, 0))
            for s in (-1, 1)
            for y in (bottom, bottom + 1)
        ]
        kinks = sorted(x for x in kinks if left <= x <= left + 1)
        area = sum(
            quad(chord, a, b, args=(bottom,))[0] for a, b in pairwise(kinks) if b > a
        )
        assert disc_area(at, radius)[row + 7, col + 7] == pytest.approx(area, abs=1e-8)
