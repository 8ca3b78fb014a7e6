"""The drawn target against its Fourier transform in closed form: a sum of sincs, no raster and no splines."""

import numpy as np
import pytest

from labkit.imaging.grid import Torus
from labkit.imaging.scene import Scene
from labkit.imaging.warp import Pose
from labkit.optics.psf import diffraction_mtf
from labkit.target.target import CellTarget
from labkit.types import Complexes

AIRY_UM, PITCH_UM, FRAME = 4.4, 5.5, (90, 90)  # 2.5 times undersampled


def carpet(order: int) -> CellTarget:
    cells = np.zeros((1, 1))
    for _ in range(order):
        cells = np.block([[cells] * 3, [cells, np.ones_like(cells), cells], [cells] * 3])
    return CellTarget(cells, (2.0, 2.0))


def upright(half: float, centre: float = 44.0) -> Pose:
    """Half its side, and where its centre stands along both axes: pixels."""
    return Pose.from_corners(
        np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]]) * half + centre, (2.0, 2.0)
    )


def spectrum_of_cells(
    torus: Torus, target: CellTarget, centre: float, half: float
) -> Complexes:
    """Half plane of the transform of cells that lie along rows and columns. centre, half side: pixels."""
    count = len(target.cells)
    width = 2 * half * torus.oversampling / count
    places = (centre + torus.margin[0]) * torus.oversampling + (
        np.arange(count) - (count - 1) / 2
    ) * width
    along_rows, along_columns = (
        np.exp(-2j * np.pi * np.outer(k, places)) * (np.sinc(k * width) * width)[:, None]
        for k in (
            torus.row_frequency.ravel() * torus.spacing_um,
            torus.column_frequency.ravel() * torus.spacing_um,
        )
    )
    return np.asarray(along_rows @ target.cells @ along_columns.T)


# the second torus's Nyquist frequency is hardly more than the cutoff: what the raster holds beyond folds back
@pytest.mark.parametrize("pitch_um", [5.5, 4.399])
@pytest.mark.parametrize(("half", "centre"), [(30.0, 44.37), (29.93, 44.0)])
@pytest.mark.parametrize("reference", [0.95, 1.0, 1.05])
def test_a_carpet_behind_a_perfect_lens_is_the_closed_form(
    reference: float, half: float, centre: float, pitch_um: float
) -> None:
    torus = Torus.around(FRAME, (40, 40), pitch_um, 1 / AIRY_UM)
    target = carpet(5)
    (drawn,) = (
        Scene(torus, target, 1 / AIRY_UM, upright(half * reference))
        .draw([upright(half, centre)])
        .spectra
    )
    blur = diffraction_mtf(np.hypot(torus.row_frequency, torus.column_frequency) * AIRY_UM)
    blur = (
        blur
        * np.sinc(torus.row_frequency * pitch_um)
        * np.sinc(torus.column_frequency * pitch_um)
    )
    ours = torus.sample(drawn * blur)
    exact = torus.sample(spectrum_of_cells(torus, target, centre, half) * blur)
    # the noise of a pixel of 25,000 electrons is 6e-3 of white, of the mean of 10,000 of them 6e-5; measured are 2.4e-6 to
    # 6e-6, and 1.5e-5 in the second torus where the reference is the larger
    assert np.std(ours - exact) < (1.2e-5 if reference <= 1 else 3e-5)


def test_a_drawing_does_not_know_what_was_drawn_before() -> None:
    torus, target = Torus.around(FRAME, (40, 40), PITCH_UM, 1 / AIRY_UM), carpet(3)
    here, elsewhere = upright(30.0), upright(32.1)
    scene, fresh = (Scene(torus, target, 1 / AIRY_UM, here) for _ in range(2))
    first, _, again = (scene.draw([pose]).spectra[0] for pose in (here, elsewhere, here))
    np.testing.assert_array_equal(again, first)
    fresh.draw([elsewhere])
    np.testing.assert_array_equal(fresh.draw([here]).spectra[0], first)


TURNED = Pose.from_corners(
    np.array([[-602.0, -590], [-631, 1420], [1405, 1434], [1392, -622]]), (2.0, 2.0)
)
"""A carpet of some 2000 pixels, of which the frame shows a small part."""


def test_a_tile_of_a_large_target_is_drawn_as_the_whole_target_is() -> None:
    torus, target = Torus.around(FRAME, (40, 40), PITCH_UM, 1 / AIRY_UM), carpet(5)
    poses = TURNED, TURNED.about((0.04, 0.04), (-0.25, -0.27))
    whole, part = (Scene(torus, target, 1 / AIRY_UM, pose) for pose in poses)
    blur = diffraction_mtf(np.hypot(torus.row_frequency, torus.column_frequency) * AIRY_UM)
    seen, ours = (
        torus.sample(scene.draw([pose]).spectra[0] * blur)
        for scene, pose in zip((whole, part), poses, strict=True)
    )
    assert np.ptp(seen) > 0.99
    # rasters end their bands by the scales at their own middles; measured: 1.05e-6
    assert np.std(ours - seen) < 2.1e-6
    # no larger than the torus asks for: a raster of the whole target has 120 million samples
    assert part._raster.coefficients.size < 2e6


def test_a_pose_in_the_coordinates_of_a_part_is_the_same_pose() -> None:
    part = TURNED.about((0.1, 0.2), (-0.25, 0.3))
    there = part.to_pixels(np.array([-1.0, 1.0]), np.array([0.5, -0.5]))
    same = TURNED.to_pixels(np.array([-0.35, -0.15]), np.array([0.4, 0.2]))
    assert np.allclose(there, same, rtol=0, atol=1e-9)
    assert np.allclose(part.of_target((2.0, 2.0)).v, TURNED.v, rtol=1e-12)
    # a scale is that at the centre of the part
    step = TURNED.to_pixels(np.array([-0.25, -0.25]), np.array([0.3, 0.3 + 1e-6]))
    down = TURNED.to_pixels(np.array([-0.25, -0.25 + 1e-6]), np.array([0.3, 0.3]))
    area = np.linalg.det([np.diff(down, axis=0)[0] / 1e-6, np.diff(step, axis=0)[0] / 1e-6])
    assert part.log_scale()[0] == pytest.approx(0.5 * np.log(area), abs=1e-5)
