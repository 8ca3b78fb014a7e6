"""Edge- and line-spread functions from the OTF's slice, against closed forms, differences, and a camera that sums up areas."""

from dataclasses import replace

import numpy as np
import pytest

from labkit.edges.region import Edge, Region, mean_and_slopes
from labkit.edges.spread import camera_slice, edge_spread
from labkit.experiments.edge_camera import EdgeCamera
from labkit.imaging.optics import Optics
from labkit.imaging.parts import LowPass
from labkit.optics.spectrum import Spectrum
from labkit.types import Floats

NOLL = tuple(range(4, 12))
OPTICS = Optics(
    wavelength_nm=500.0,
    reference_nm=500.0,
    f_number=4.0,
    pitch_um=4.78,
    active_um=4.78,
    noll=NOLL,
)
AIRY_UM = 2.0
PERFECT = replace(OPTICS, active_um=1e-6)


def waves(defocus: float) -> Floats:
    return np.concatenate(
        [[defocus], np.random.default_rng(2).normal(0, 0.04, len(NOLL) - 1)]
    )


def test_a_perfect_lens_has_the_line_spread_of_the_closed_form_at_its_middle() -> None:
    # the integral of 2/pi (acos v - v sqrt(1 - v^2)) over -1..1 is 8 / (3 pi)
    spread = edge_spread(PERFECT, np.zeros(len(NOLL)), 0.7, 40.0).read(np.zeros(1))
    np.testing.assert_allclose(spread[:2, 0], [0.5, 8 / (3 * np.pi) / AIRY_UM], rtol=1e-6)


def test_a_perfect_lens_has_the_line_spread_of_struves_function() -> None:
    from scipy.special import struve

    # J. W. Goodman: a circular pupil's line-spread function, H1 of Struve
    r = np.linspace(0.1, 35, 300)
    x = 2 * np.pi * r / AIRY_UM
    closed = 4 / AIRY_UM * struve(1, x) / x**2
    np.testing.assert_allclose(
        edge_spread(PERFECT, np.zeros(len(NOLL)), 0.0, 40.0).read(r)[1], closed, atol=3e-6
    )  # 1.5e-6 measured: the spline


@pytest.mark.parametrize("defocus", [0.05, 0.6])
def test_slopes_are_those_of_differences(defocus: float) -> None:
    optics = replace(OPTICS, given=(LowPass(0.3, 0.2),), spectrum=Spectrum.of_width(0.002))
    at, step, here = np.linspace(-60, 60, 200), 1e-5, waves(defocus)

    def edge(azimuth: float, w: Floats, shift: float = 0.0) -> Floats:
        return np.asarray(edge_spread(optics, w, azimuth, 80.0).read(at + shift)[0])

    slopes = edge_spread(optics, here, 0.4, 80.0).read(at)[1:]
    unit = step * np.eye(len(NOLL))
    differences = [edge(0.4, here, step) - edge(0.4, here, -step)]
    differences += [
        edge(0.4, here + unit[k]) - edge(0.4, here - unit[k]) for k in range(len(NOLL))
    ]
    differences += [edge(0.4 + step, here) - edge(0.4 - step, here)]
    np.testing.assert_allclose(
        slopes, np.array(differences) / (2 * step), atol=2e-7
    )  # 1e-7 measured: the spline's slope


def test_a_longer_train_of_edges_changes_nothing() -> None:
    at = np.linspace(-79, 79, 300)
    near, far = (
        edge_spread(OPTICS, waves(0.4), 1.1, reach).read(at) for reach in (80.0, 800.0)
    )
    assert np.abs(near - far)[:2].max() < 1.5e-6  # 8e-7 measured: the halo's next order


def test_the_slice_is_the_transform_of_the_line_spread_function() -> None:
    frequency = np.array([0.01, 0.05, 0.12])
    r = np.arange(-3000, 3000, 0.25)
    line = edge_spread(OPTICS, waves(0.4), 1.1, 3001.0).read(r)[1]
    direct = 0.25 * np.exp(-2j * np.pi * np.outer(frequency, r)) @ line
    np.testing.assert_allclose(
        direct, camera_slice(OPTICS, waves(0.4), 1.1, frequency).value, atol=2e-5
    )


@pytest.mark.parametrize(
    ("defocus", "angle", "step"), [(0.3, 0.2, 1), (1.2, 1.75, 2), (-0.7, -2.6, 1)]
)
def test_an_edge_looks_as_to_a_camera_that_sums_up_areas(
    defocus: float, angle: float, step: int
) -> None:
    camera = EdgeCamera(0.5, 4.0, 4.78, step=step, frame=20, finer=6, reach_px=40)
    seen = camera.mean(angle, 0.8, (0.0, 1.0), waves(defocus), NOLL)
    places = step * np.arange(20.0)
    rows, columns = (a.ravel() for a in np.meshgrid(places, places, indexing="ij"))
    middle = (20 * step - 1) / 2
    region = Region(rows, columns, np.zeros(400), (middle, middle))
    mean = mean_and_slopes(region, Edge(angle, 0.8, 0.0, 1.0), OPTICS, waves(defocus))[0]
    # its light beyond 40 pixels, 7e-4 of all, adds nothing: up to 2.9e-4 of that is left here
    np.testing.assert_allclose(mean, seen.ravel(), atol=4e-4)
