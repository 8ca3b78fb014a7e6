"""Registration of a rendered target with a picture, and how well the two agree.

Corners are (4, 2) arrays of (row, col) in pixels, pixel centres at integers, in the order of the target's own
(0, 0), (0, w), (h, w), (h, 0).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from labkit.target import Target
from labkit.types import Floats

Singles = NDArray[np.float32]

REGISTRATION_PASSES = ((160, (7, 5)), (320, (5,)))
"""Pixels across the target at which it is registered, first roughly: a larger picture is binned down to about this. And the
sides of the kernels, pixels, that smooth the picture, one after the other."""

HOPELESS = 0.3
"""Agreement below which a place is not refined: it would have to be twice as good."""

FIRST_BLUR = 1 / 80
"""Of the target's side, before a better blur is known."""

PARENT_SIDE = 243
"""Pixels across a carpet that the target may be a part of."""

TRIED_BLURS = (0.6, 1.2, 2.4, 4.8)
"""Standard deviations of the blurs tried for the unknown lens, in pixels at the working size."""

MOST_LARGER = (
    4.0  # than the picture: a corner so far away is where nearly parallel lines meet
)

OWN_CORNERS = np.array([[-0.5, -0.5], [-0.5, 0.5], [0.5, 0.5], [0.5, -0.5]])
"""A target's corners from its centre, in its own size."""

LIGHT_BLUR = 0.8
"""Blur of the picture before comparison, which reduces noise and aliasing."""


@dataclass(frozen=True, slots=True)
class Agreement:
    """Normalised correlation of the rendered target with the image, over the whole and in each of 3×3 parts."""

    whole: float
    parts: tuple[float, ...]

    @property
    def median_part(self) -> float:
        return float(np.median(self.parts)) if self.parts else self.whole

    @property
    def least_part(self) -> float:
        return min(self.parts, default=self.whole)


@dataclass(frozen=True, slots=True)
class _Template:
    """The target rendered on a regular grid, and the compared part; corners (4, 2) in pixels of this part.

    The part contains some of the surround if its radiance is known; otherwise it excludes
    the target's rim.
    """

    sharp: Singles
    part: tuple[slice, slice]
    corners: Floats

    @property
    def shape(self) -> tuple[int, int]:
        return self.sharp[self.part].shape[0], self.sharp[self.part].shape[1]

    def blurred(self, sigma: float) -> Singles:
        return _blur(self.sharp, sigma)[self.part]


def register(image: Singles, target: Target, corners: Floats) -> tuple[Floats, Agreement]:
    """Refine corners from within a few per cent of the target's side; return them and the agreement.

    image: (rows, cols). The homography maximises the enhanced correlation coefficient
    (Evangelidis and Psarakis, PAMI 30, 2008) with the target, at the best of a few blurs.
    """
    blur = max(FIRST_BLUR, TRIED_BLURS[1] / _side(corners))
    agreement = Agreement(0.0, ())
    for side, lights in REGISTRATION_PASSES:
        factor = max(1, round(_side(corners) / side))
        picture, first = _prepared(image, corners, factor)
        template = _render(target, _side(first))
        at = first
        sigma = blur * _side(at)
        for light in lights:
            at = _ecc(picture, _lit(picture, template, at, sigma), at, sigma, light)
            sigma = _best_blur(picture, template, at)
        corners = corners + (at - first) * factor
        blur = sigma / _side(at)
        agreement = _agreement(picture, template, at, sigma)
        if agreement.whole < HOPELESS or np.array_equal(at, first):  # no pass converged
            break
    return corners, agreement


def quick_agreement(
    image: Singles, target: Target, corners: Floats, side: int = 81
) -> float:
    """Return the correlation over the target at a coarse scale; 0 if most of the target is outside the image."""
    if np.ptp(corners, axis=0).max() > MOST_LARGER * max(image.shape):
        return 0.0
    factor = max(1, round(_side(corners) / side))
    picture, at = _prepared(image, corners, factor)
    template = _render(target, _side(at))
    return _correlation(*_compared(picture, template, at, TRIED_BLURS[1]))


def parent_agreement(image: Singles, target: Target, corners: Floats) -> float:
    """Return the agreement of the surrounding image with a target nine times as large in area.

    A carpet contains smaller carpets. If a carpet is partly outside the frame, a whole
    smaller carpet is found in its place. The result is the best correlation over the eight
    possible places of the larger carpet, outside of `corners`.
    """
    unit = np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [1.0, -1.0]])
    image_from_small = homography(unit, corners)
    template = _render(target, min(PARENT_SIDE, 3 * _side(corners)))
    smaller: dict[int, Singles] = {}
    best = 0.0
    for row in (-2.0, 0.0, 2.0):
        for col in (-2.0, 0.0, 2.0):
            if row == col == 0.0:
                continue
            # the large target's corners in the small one's units, which reach from -1 to 1
            large = mapped(image_from_small, 3 * unit - np.array([row, col]))
            factor = max(1, round(_side(large) / PARENT_SIDE))
            if factor not in smaller:
                smaller[factor] = binned(image, factor)
            at, hidden = ((places + 0.5) / factor - 0.5 for places in (large, corners))
            pair = _compared(smaller[factor], template, at, TRIED_BLURS[1], hidden)
            best = max(best, _correlation(*pair))
    return best


def _side(corners: Floats) -> float:
    """Return the mean of a quadrilateral's four sides."""
    return float(np.mean(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)))


def binned(image: Singles, factor: int) -> Singles:
    """Return means over factor × factor pixels, without the remainder at the end."""
    if factor == 1:
        return image
    rows, cols = image.shape[0] // factor, image.shape[1] // factor
    whole = image[: rows * factor, : cols * factor]
    return np.asarray(
        cv2.resize(whole, (cols, rows), interpolation=cv2.INTER_AREA), dtype=np.float32
    )


def _prepared(image: Singles, corners: Floats, factor: int) -> tuple[Singles, Floats]:
    """Return the neighbourhood of a quadrilateral, binned, and the quadrilateral in its pixels."""
    reach = 0.3 * _side(corners)
    low = np.maximum(np.floor(corners.min(axis=0) - reach), 0).astype(int)
    high = np.maximum(np.ceil(corners.max(axis=0) + reach), low + 2 * factor).astype(int)
    return binned(image[low[0] : high[0], low[1] : high[1]], factor), (
        corners - low + 0.5
    ) / factor - 0.5


def _render(target: Target, side_px: float) -> _Template:
    height, width = target.size_mm
    spacing = (height + width) / 2 / side_px
    rows, cols = max(9, round(height / spacing)), max(9, round(width / spacing))
    rim = max(4, round(0.06 * side_px))
    y = (np.arange(-rim, rows + rim) + 0.5) / rows - 0.5
    x = (np.arange(-rim, cols + rim) + 0.5) / cols - 0.5
    sharp = np.asarray(
        target.sample(y * height, x * width, 0.4 / spacing), dtype=np.float32
    )
    cut = 2 * rim if target.surround is None else 0
    low = rim - cut - 0.5
    bottom = rim - cut + rows - 0.5
    right = rim - cut + cols - 0.5
    corners = np.array([[low, low], [low, right], [bottom, right], [bottom, low]])
    return _Template(
        sharp, (slice(cut, sharp.shape[0] - cut), slice(cut, sharp.shape[1] - cut)), corners
    )


def homography(source: Floats, destination: Floats) -> Floats:
    """Return the 3×3 map of (x, y) from four (row, col) points to four others."""
    x_y = [
        np.ascontiguousarray(points[:, ::-1], dtype=np.float32)
        for points in (source, destination)
    ]
    return np.asarray(cv2.getPerspectiveTransform(x_y[0], x_y[1]), dtype=np.float64)


def mapped(by: Floats, points: Floats) -> Floats:
    """Return (row, col) points under a 3×3 map of (x, y)."""
    x, y, w = by @ np.column_stack((points[:, ::-1], np.ones(len(points)))).T
    return np.column_stack((y / w, x / w))


def _blur(image: Singles, sigma: float) -> Singles:
    return np.asarray(
        cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE),
        dtype=np.float32,
    )


def _ecc(
    picture: Singles, template: _Template, corners: Floats, sigma: float, light: int
) -> Floats:
    start = homography(template.corners, corners).astype(np.float32)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 40, 1e-6)
    try:
        everywhere = np.ones(picture.shape, np.uint8)
        _, aligned = cv2.findTransformECC(
            template.blurred(sigma),
            picture,
            start,
            cv2.MOTION_HOMOGRAPHY,
            criteria,
            everywhere,
            light,
        )
    except cv2.error:  # it did not converge: then the agreement decides
        return corners
    moved = mapped(np.asarray(aligned, dtype=np.float64), template.corners)
    # a correction is small; a large one is a flight, not a fit
    return moved if np.max(np.abs(moved - corners)) < 0.25 * _side(corners) else corners


def _aligned(
    picture: Singles, template: _Template, corners: Floats
) -> tuple[Singles, NDArray[np.bool_]]:
    """Return the image on the template's grid, lightly blurred, and a mask of valid samples."""
    image_from_template = homography(template.corners, corners)
    size = template.shape[::-1]
    how = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    in_frame = (
        cv2.warpPerspective(np.ones_like(picture), image_from_template, size, flags=how)
        > 0.99
    )
    warped = cv2.warpPerspective(
        picture, image_from_template, size, flags=how, borderMode=cv2.BORDER_REPLICATE
    )
    return _blur(np.asarray(warped, dtype=np.float32), LIGHT_BLUR), in_frame


def _lit(picture: Singles, template: _Template, corners: Floats, sigma: float) -> _Template:
    """Return the template under the image's illumination: a plane in row and column, plus a constant."""
    warped, in_frame = _aligned(picture, template, corners)
    expected = template.blurred(sigma)
    y, x = (
        np.linspace(-1, 1, n, dtype=np.float32)[span]
        for n, span in zip(template.sharp.shape, template.part, strict=True)
    )
    columns = (
        expected,
        expected * y[:, None],
        expected * x[None, :],
        np.ones_like(expected),
    )
    design = np.stack([column[in_frame] for column in columns], axis=1).astype(np.float64)
    fitted = np.linalg.lstsq(
        design.T @ design, design.T @ warped[in_frame].astype(np.float64), rcond=1e-9
    )[0]
    y, x = (np.linspace(-1, 1, n, dtype=np.float32) for n in template.sharp.shape)
    light = fitted[0] + fitted[1] * y[:, None] + fitted[2] * x[None, :]
    if (
        not light.min() > 0.1 * light.max()
    ):  # no light that a lamp could throw: rather none than a wild one
        return template
    return replace(template, sharp=(template.sharp * light).astype(np.float32))


def _best_blur(picture: Singles, template: _Template, corners: Floats) -> float:
    warped, in_frame = _aligned(picture, template, corners)
    return max(
        TRIED_BLURS,
        key=lambda sigma: _correlation(
            warped, template.blurred(np.hypot(sigma, LIGHT_BLUR)), in_frame
        ),
    )


def _compared(
    picture: Singles,
    template: _Template,
    corners: Floats,
    sigma: float,
    hidden: Floats | None = None,
) -> tuple[Singles, Singles, NDArray[np.bool_]]:
    """Return the image on the template's grid, the blurred template, and a mask of samples in the frame and not hidden."""
    warped, in_frame = _aligned(picture, template, corners)
    if hidden is not None:
        at = mapped(homography(corners, template.corners), hidden)
        covered = cv2.fillConvexPoly(
            np.zeros(in_frame.shape, np.uint8), np.rint(at[:, ::-1]).astype(np.int32), 1
        )
        in_frame &= covered == 0
    return warped, template.blurred(np.hypot(sigma, LIGHT_BLUR)), in_frame


def _agreement(
    picture: Singles, template: _Template, corners: Floats, sigma: float
) -> Agreement:
    warped, expected, in_frame = _compared(picture, template, corners, sigma)
    contrast = float(expected.std())
    parts = []
    for rows in np.array_split(np.arange(in_frame.shape[0]), 3):
        for cols in np.array_split(np.arange(in_frame.shape[1]), 3):
            part = slice(rows[0], rows[-1] + 1), slice(cols[0], cols[-1] + 1)
            if float(expected[part].std()) > 0.1 * contrast:
                parts.append(_correlation(warped[part], expected[part], in_frame[part]))
    return Agreement(_correlation(warped, expected, in_frame), tuple(parts))


def _correlation(a: Singles, b: Singles, where: NDArray[np.bool_]) -> float:
    """Return Pearson's correlation over the pixels `where`; 0 if they are too few or an image is flat."""
    if np.count_nonzero(where) < 0.2 * where.size:
        return 0.0
    left, right = (x[where].astype(np.float64) for x in (a, b))
    left, right = left - left.mean(), right - right.mean()
    scale = np.sqrt((left @ left) * (right @ right))
    return float(left @ right / scale) if scale > 0 else 0.0
