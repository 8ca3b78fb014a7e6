"""Registration of a rendered target with a picture, and how well the two agree.

Corners are (4, 2) arrays of (row, col) in pixels, pixel centres at integers, in the order of the target's own
(0, 0), (0, w), (h, w), (h, 0).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from labkit.finder.picture import Picture, Singles, normalised, single
from labkit.target.target import Target
from labkit.types import Floats

REGISTRATION_PASSES = ((40, (5,)), (160, (7, 5)), (320, (5,)))
"""Pixels across the target at which it is registered, first roughly: a larger picture is binned down to about this. And the
sides of the kernels, pixels, that smooth the picture, one after the other."""

LEAST_AGREEMENT, CLEAR_AGREEMENT, BEYOND_DOUBT = 0.6, 0.9, 0.95
"""Least correlation of a picture with the rendered target, for the whole target and for the median of 3×3 parts; the worst
part needs half; for a target partly outside the frame or far out of focus; and for one that replaces another one. In 120 drawn
rooms without a target none had 0.5 unless far out of focus."""

SMOOTH_DEGREE, LEAST_DETAIL_AGREEMENT = 4, 0.8
"""Degree of the polynomial in row and column without which pictures of targets far out of focus are compared, and the least
correlation then. In 60 drawn rooms without a target, smooth spots had 0.71 at the most; a carpet of 62 pixels whose side
squares are blurred away had 0.89."""

HOPELESS = 0.3
"""Agreement after a rough registration below which there is no fine one: it would have to be twice as good."""

FAR_OUT_OF_FOCUS = 0.04
"""Blur, in the target's sides, that leaves little but the bright square in the middle of a carpet."""

FIRST_BLUR = 1 / 80
"""Of the target's side, before a better blur is known."""

TRIED_BLURS = (0.002, 0.004, 0.008, 0.016, 0.023, 0.032, 0.045, 0.064)
"""Standard deviations of the blurs tried for the unknown lens, in the target's sides. A disc as wide as a quarter of the target
has the largest."""

PARENT_BLUR = 0.01
"""Blur with which a larger carpet is compared."""

PARENT_SIDE = 243
"""Pixels across a carpet that the target may be a part of."""

CLEAR_RIM, COMPARED_RIM = 0.04, 0.1
"""Width around the target, in its sides, of what belongs to the target or its blur; and of what registration looks at."""

LIKE_LEVEL = 0.25
"""Difference from a target's black or white, relative to its range, of a surround of the same kind."""

CLUTTER, NOISY_SHARE = 0.15, 0.02
"""Difference from the stated surround, of the target's own range, that is something else, such as a bright wall beside a black
rim; and the share of such pixels that noise makes."""

SURROUNDINGS = 0.3
"""Width of the surroundings in which a target may move as it is registered, in sides."""

LEAST_DRAWN_PX = 24.0
"""Side of the smallest target drawn: a rim of a few samples must leave something."""

LIGHT_SIDE = 100
"""Samples across a target when its light is compared with another one's."""

OWN_CORNERS = np.array([[-0.5, -0.5], [-0.5, 0.5], [0.5, 0.5], [0.5, -0.5]])
"""A target's corners from its centre, in its own size."""

LIGHT_BLUR = 0.8
"""Blur of the picture before comparison, which reduces noise and aliasing."""


@dataclass(frozen=True, slots=True)
class Agreement:
    """Normalised correlation of the rendered target with the image, over the whole and in each of 3×3 parts.

    blur: standard deviation of the rendered target's blur, in its sides; detail: correlation without what is smooth over
    the target, of a target far out of focus.
    """

    whole: float
    parts: tuple[float, ...]
    blur: float = 0.0
    detail: float = 1.0

    @property
    def median_part(self) -> float:
        return float(np.median(self.parts)) if self.parts else self.whole

    @property
    def is_hopeless(self) -> bool:
        """Return whether a rough registration cannot become believable."""
        return self.least < (CLEAR_AGREEMENT if self.blur > FAR_OUT_OF_FOCUS else HOPELESS)

    @property
    def is_believable(self) -> bool:
        """Return whether the photograph agrees with the target everywhere."""
        return self.credit >= LEAST_AGREEMENT

    @property
    def credit(self) -> float:
        """The least correlation; of a target far out of focus, where more is asked for, in the same measure."""
        if self.blur <= FAR_OUT_OF_FOCUS:
            return self.least
        share = min(self.least / CLEAR_AGREEMENT, self.detail / LEAST_DETAIL_AGREEMENT)
        return LEAST_AGREEMENT * share

    @property
    def least(self) -> float:
        """The least of the whole, the median part, and twice the worst part."""
        return min(self.whole, self.median_part, 2 * min(self.parts, default=self.whole))


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


def register(picture: Picture, target: Target, corners: Floats) -> tuple[Floats, Agreement]:
    """Refine corners from within a few per cent of the target's side; return them and the agreement.

    The homography maximises the enhanced correlation coefficient
    (Evangelidis and Psarakis, PAMI 30, 2008) with the target, at the best of a few blurs.
    """
    blur = FIRST_BLUR
    agreement = Agreement(0.0, ())
    for side, lights in REGISTRATION_PASSES:
        image, first, factor = neighbourhood(picture, corners, side)
        template = _render(target, mean_side(first), _stands_alone(image, first, target))
        at = first
        sigma = blur * mean_side(at)
        for light in lights:
            at = _ecc(image, _lit(image, template, at, sigma), at, sigma, light)
            sigma = _best_blur(image, template, at)
        corners = corners + (at - first) * factor
        blur = sigma / mean_side(at)
        agreement = _agreement(image, template, at, sigma)
        if agreement.is_hopeless or np.array_equal(at, first):  # no pass converged
            break
    return corners, agreement


def parents(
    picture: Picture, target: Target, corners: Floats
) -> Iterator[tuple[Floats, float]]:
    """Yield the corners of targets nine times as large in area around a target, and the picture's agreement with them.

    A carpet contains smaller carpets. If a carpet is partly outside the frame, a whole
    smaller carpet is found in its place. The agreement is that outside of `corners`.
    """
    unit = np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [1.0, -1.0]])
    image_from_small = homography(unit, corners)
    template = _render(target, min(PARENT_SIDE, 3 * mean_side(corners)), alone=True)
    for row in (-2.0, 0.0, 2.0):
        for col in (-2.0, 0.0, 2.0):
            if row == col == 0.0:
                continue
            # the large target's corners in the small one's units, which reach from -1 to 1
            large = mapped(image_from_small, 3 * unit - np.array([row, col]))
            image, at, factor = neighbourhood(picture, large, PARENT_SIDE)
            hidden = at[0] + (corners - large[0]) / factor
            pair = _compared(image, template, at, PARENT_BLUR * mean_side(at), hidden)
            yield large, correlation(*pair)


def _stands_alone(image: Singles, corners: Floats, target: Target) -> bool:
    """Return whether something else than a stated surround is beside a target: then the target is compared without it."""
    if target.surround is None:
        return True
    beside = _beside(image, corners)
    other = np.abs(beside - target.surround) > CLUTTER
    return bool(np.count_nonzero(other) > NOISY_SHARE * beside.size)


def _beside(image: Singles, corners: Floats) -> Singles:
    """Return the smoothed values beside a quadrilateral."""
    by = homography(OWN_CORNERS, corners)
    inner, outer = (
        covered(mapped(by, (1 + 2 * rim) * OWN_CORNERS), image.shape)
        for rim in (CLEAR_RIM, COMPARED_RIM)
    )
    return single(cv2.blur(image, (3, 3))[(outer > 0) & (inner == 0)])


def surround_share(picture: Picture, corners: Floats, level: float) -> float:
    """Return the share of what is beside a target that is about as light as its black, 0, or its white, 1."""
    image, at, _ = neighbourhood(picture, corners, LIGHT_SIDE)
    beside = _beside(image, at)
    return float(np.mean(np.abs(beside - level) < LIKE_LEVEL)) if beside.size else 0.0


def light_range(picture: Picture, corners: Floats) -> float:
    """Return the difference of the lightest and the darkest parts within a quadrilateral, in the picture's own scale."""
    # of whole cells: in the pixels of a mosaic colours are on scales of their own
    factor = picture.binning(max(2, round(mean_side(corners) / LIGHT_SIDE)))
    low = np.clip(np.floor(corners.min(axis=0)).astype(int), 0, np.array(picture.shape) - 1)
    image = picture.part(
        picture.whole_cells(low), np.ceil(corners.max(axis=0)).astype(int) + 1, factor
    )
    return float(np.ptp(np.percentile(image, (5, 95))))


def mean_side(corners: Floats) -> float:
    """Return the mean of a quadrilateral's four sides."""
    return float(np.mean(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)))


def neighbourhood(
    picture: Picture, corners: Floats, side: float, reach: float = SURROUNDINGS
) -> tuple[Singles, Floats, int]:
    """Return the surroundings of a quadrilateral, the quadrilateral in their pixels, and how many pixels are binned to one.

    The darkest pixels near the quadrilateral are 0 and the brightest 1, whatever is around.

    Parameters
    ----------
    picture : the photograph
    corners : (4, 2) of the quadrilateral
    side : about as many samples are wanted across it
    reach : width of the surroundings, in sides
    """
    factor = picture.binning(round(mean_side(corners) / side))
    shape = np.array(picture.shape)
    inner = np.clip((corners.min(axis=0), corners.max(axis=0)), 0, shape - 1)
    away = reach * mean_side(corners)
    low = picture.whole_cells(np.maximum(np.floor(inner[0] - away), 0))
    high = np.minimum(np.ceil(inner[1] + away).astype(int) + 1, shape)
    low = np.maximum(np.minimum(low, picture.whole_cells(shape - 2 * factor)), 0)
    high = np.minimum(np.maximum(high, low + 2 * factor), shape)
    image = picture.part(low, high, factor)
    at = (corners - low + 0.5) / factor - 0.5
    return normalised(image, image[covered(at, image.shape) > 0]), at, factor


def covered(corners: Floats, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """Return an image that is 1 within a quadrilateral."""
    inside = np.zeros(shape, np.uint8)
    cv2.fillConvexPoly(inside, np.rint(corners[:, ::-1]).astype(np.int32), 1)
    return inside


def _render(target: Target, side_px: float, alone: bool) -> _Template:
    """Return the target drawn with its surround, or with its rim cut off if it is compared alone."""
    height, width = target.size_mm
    side_px = max(side_px, LEAST_DRAWN_PX)
    spacing = (height + width) / 2 / side_px
    rows, cols = max(9, round(height / spacing)), max(9, round(width / spacing))
    rim = max(4, round(0.06 * side_px))
    y = (np.arange(-rim, rows + rim) + 0.5) / rows - 0.5
    x = (np.arange(-rim, cols + rim) + 0.5) / cols - 0.5
    sharp = np.asarray(
        target.sample(y * height, x * width, 0.4 / spacing), dtype=np.float32
    )
    cut = 2 * rim if alone else 0
    low = rim - cut - 0.5
    bottom = rim - cut + rows - 0.5
    right = rim - cut + cols - 0.5
    corners = np.array([[low, low], [low, right], [bottom, right], [bottom, low]])
    part = (slice(cut, sharp.shape[0] - cut), slice(cut, sharp.shape[1] - cut))
    return _Template(sharp, part, corners)


def drawn_with_rim(target: Target, side_px: float) -> tuple[Singles, Floats]:
    """Return a target drawn sharp, of about `side_px` samples, with some of its surround; and its corners (4, 2) there."""
    template = _render(target, side_px, alone=False)
    return template.sharp, template.corners


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
    return moved if np.max(np.abs(moved - corners)) < 0.25 * mean_side(corners) else corners


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
        (blur * mean_side(corners) for blur in TRIED_BLURS),
        key=lambda sigma: correlation(
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
        in_frame &= covered(at, in_frame.shape) == 0
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
                parts.append(correlation(warped[part], expected[part], in_frame[part]))
    blur = sigma / mean_side(corners)
    far = blur > FAR_OUT_OF_FOCUS
    return Agreement(
        correlation(warped, expected, in_frame),
        tuple(parts),
        blur,
        _detail(warped, expected, in_frame) if far else 1.0,
    )


def _detail(a: Singles, b: Singles, where: NDArray[np.bool_]) -> float:
    """Return the correlation over the pixels `where` of two images without a polynomial in row and column."""
    rows, cols = np.nonzero(where)
    y, x = (2 * at / n - 1 for at, n in zip((rows, cols), a.shape, strict=True))
    powers = np.polynomial.legendre.legvander2d(y, x, (SMOOTH_DEGREE, SMOOTH_DEGREE))
    both = np.stack((a[where], b[where]), axis=1).astype(np.float64)
    fitted = np.linalg.lstsq(powers.T @ powers, powers.T @ both, rcond=1e-9)[0]
    left, right = (both - powers @ fitted).T
    return float(left @ right / max(np.sqrt((left @ left) * (right @ right)), 1e-300))


def correlation(a: Singles, b: Singles, where: NDArray[np.bool_]) -> float:
    """Return Pearson's correlation over the pixels `where`; 0 if they are too few or an image is flat."""
    if np.count_nonzero(where) < 0.2 * where.size:
        return 0.0
    left, right = (x[where].astype(np.float64) for x in (a, b))
    left, right = left - left.mean(), right - right.mean()
    scale = np.sqrt((left @ left) * (right @ right))
    return float(left @ right / scale) if scale > 0 else 0.0
