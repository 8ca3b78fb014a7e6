"""A panel's stripes: drawn in closed form, against sums over their area; their aperture, against differences of pictures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labkit.errors import TargetError
from labkit.imaging.model import ForwardModel
from labkit.imaging.panel_aperture import Aperture
from labkit.panel.drawn_target import PanelTarget
from labkit.target.target import CellTarget, low_pass
from labkit.types import Floats
from tests.unit.test_cone import CARPET, OPTICS, POSE, TRUTH

PIXELS = np.random.default_rng(0).integers(0, 2, (6, 9)).astype(float)
APERTURE = (0.8, 0.7)
Y, X, BANDWIDTH = np.linspace(-1, 1, 41), np.linspace(-1.3, 1.3, 43), 7.0


def striped(place: int, lying: bool) -> PanelTarget:
    return PanelTarget(PIXELS, (1.2, 1.8), place, lying, APERTURE)


def summed(target: PanelTarget) -> Floats:
    """What the low-pass filter makes of the target, by summing over points 0.2 mm / 300 apart: no stripe's edge is between."""
    reach, step = low_pass()

    def kernel(at: Floats, side_mm: float) -> tuple[Floats, Floats]:
        count = round(side_mm / 0.2 * 300)
        points = ((np.arange(count) + 0.5) / count - 0.5) * side_mm
        far = (at[:, None] - points) * BANDWIDTH
        inside = np.abs(far) < reach
        return points, np.where(
            inside, step.derivative()(np.clip(far, -reach, reach)), 0.0
        ) * BANDWIDTH * side_mm / count

    (y, by), (x, bx) = kernel(Y, target.size_mm[0]), kernel(X, target.size_mm[1])
    return np.asarray(by @ target.radiance(y[:, None], x[None, :]) @ bx.T)


@pytest.mark.parametrize("lying", [False, True])
@pytest.mark.parametrize("place", [0, 1, 2])
def test_stripes_are_drawn_as_sums_over_them(place: int, lying: bool) -> None:
    target = striped(place, lying)
    # measured: 9e-5 to 1.1e-4, of the points' spacing: (2 pi 7 h)^2 / 24 of a stripe's 5.4
    np.testing.assert_allclose(
        target.sample(Y, X, BANDWIDTH), summed(target), rtol=0, atol=2e-4
    )


def test_a_stripe_lies_where_its_colour_does() -> None:
    one = PanelTarget(np.ones((1, 1)), (1.0, 1.0), 0, aperture=(1.0, 0.5))
    x = np.array([-0.4, -0.2, -0.1, 0.0, 0.3])
    np.testing.assert_array_equal(
        one.radiance(0.0, x) > 0, [True, True, False, False, False]
    )
    np.testing.assert_array_equal(
        replace(one, place=2).radiance(0.0, x) > 0, [False, False, False, False, True]
    )
    np.testing.assert_array_equal(
        replace(one, lying=True).radiance(x, 0.0) > 0, [True, True, False, False, False]
    )
    assert one.radiance(0.0, -0.3) == pytest.approx(
        3 / 0.5
    )  # so that a pixel's mean is what it shows


def test_far_away_stripes_are_the_target_moved_by_a_third_of_a_pixel() -> None:
    cells = CellTarget(PIXELS, (1.2, 1.8))
    far = 1.5  # cycles/mm; the pixels' own 5 are stopped
    moved = cells.sample(Y, X + 0.2 / 3, far)
    kept = np.sinc(0.2 / 3 * 0.8 * 1.5) / np.sinc(0.2 * 1.5)
    drawn = striped(0, False).sample(Y, X, far)
    # the shares of light are the same, and a stripe blurs less than a pixel
    assert np.abs(drawn - moved).max() < (kept - 1) * np.abs(moved).max()


@pytest.mark.parametrize("lying", [False, True])
def test_slopes_by_the_aperture_are_differences(lying: bool) -> None:
    target = striped(2, lying)
    for slope, step in zip(target.slopes(Y, X, BANDWIDTH), 1e-5 * np.eye(2), strict=True):
        up, down = (
            target.lit(*(np.array(APERTURE) + s * step)).sample(Y, X, BANDWIDTH)
            for s in (1, -1)
        )
        np.testing.assert_allclose(
            slope, (up - down) / 2e-5, atol=1e-8 * np.abs(slope).max()
        )


def test_slopes_of_pictures_by_the_aperture_are_differences() -> None:
    target = PanelTarget.of(CARPET, (54, 54), 0)
    optics = replace(OPTICS, panel=Aperture(0.03, -0.02))
    model = ForwardModel.build(optics, target, (58, 60), POSE, f_number_margin=0.02)
    assert isinstance(model.scene.target, PanelTarget)
    assert model.scene.target.aperture == pytest.approx((0.88, 0.83))
    used = [np.ones((58, 60), bool)]
    slopes = model.evaluate(TRUTH.waves, model.draw([POSE]), used, by_camera=True)[
        0
    ].by_waves[len(TRUTH.waves) :]
    for k, step in enumerate(1e-2 * np.eye(3)[:2]):
        up, down = (
            model.with_optics(
                optics.with_camera_parameters(optics.camera_parameters + sign * step)
            )
            for sign in (1, -1)
        )
        means = [each.means(TRUTH.waves, each.draw([POSE]), used)[0] for each in (up, down)]
        difference = (means[0] - means[1]) / 2e-2
        # measured: 1.2e-4 of the largest, which single precision of drawings makes: pictures err by 2e-8 of white RMS
        assert np.std(slopes[k] - difference) < 2.4e-4 * np.abs(difference).max()


@pytest.mark.parametrize(
    "wrong", [{"place": 3}, {"aperture": (0.0, 0.9)}, {"surround": 1.0}]
)
def test_impossible_stripes_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(TargetError, match=r"stripe|pixels"):
        replace(striped(0, False), **wrong)  # type: ignore[arg-type]
