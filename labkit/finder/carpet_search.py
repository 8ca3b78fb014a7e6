"""Search a photograph for Sierpinski carpets of any size and direction, from coarse to fine.

1. In copies of the picture of many scales, the bright square in a carpet's middle is a bright spot about as wide as a
   Gaussian kernel. Normalised correlation with the kernel finds it, whatever the light and the direction.
2. Each spot is compared with the carpet in twelve directions and three sizes.
3. The likeliest are aligned with the carpet at forty samples across, by an affine map that maximises the enhanced
   correlation coefficient (Evangelidis and Psarakis, PAMI 30, 2008). Now its smaller squares tell it from other objects.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from labkit.finder.picture import Picture, Singles
from labkit.finder.registration import OWN_CORNERS, correlation, mean_side
from labkit.target.target import CellTarget, Target
from labkit.types import Bools, Floats

COARSE_SIDE = 15
"""Samples across a carpet where its middle is searched for. The square in the middle has five."""

SPOT_WINDOW, SPOT_STD = 11, 1.7
"""Samples of the window in which a bright spot stands out, within the carpet in every direction; and its kernel's width."""

LEAST_SPOT = 0.6
"""Least correlation with the spot's kernel. Carpets have 0.74 to 0.88, in and out of focus, in 80 drawn rooms."""

ROWS_OF_SPOTS = 128
"""Rows of a picture correlated with the spot's kernel at once."""

MOST_SPOTS = 1000
"""Brightest spots of a scale looked at. Carpets were among the first 250."""

SCALE_STEP = 2**0.25
"""From one scale to the next: a carpet is within 9 % of one of them."""

DIRECTIONS_DEG = np.arange(0.0, 90.0, 7.5)
SIZES = (0.93, 1.0, 1.08)
COARSE_BLURS = (0.7, 1.1)
"""Standard deviations of the blur of compared carpets, in samples at COARSE_SIDE: in focus, and far out of focus. With 0.9 and
2.0 six of 56 small carpets in drawn rooms were not among the likeliest 150; now one."""

EVEN_DEVIATION = 0.01
"""Deviation of what is compared, relative to the whole window's, below which it is taken for even."""

COMPARED_SHARE = 0.94
"""Part of a carpet's side compared: anything may be beside it."""

MOST_ALIGNED, BATCH = 500, 100
"""Likeliest places aligned, and how many at once: no more follow where a carpet is clear among them."""

LEAST_LIKENESS, ALWAYS_ALIGNED = 0.7, 16
"""Least likeness of a place aligned, and the number that are whatever it is: a search in vain shows where it looked.
Of 110 carpets of 22 pixels to 0.9 of the frame none had less than 0.86; of the 500 likeliest places of a room 90 had 0.7."""

FINE_SIDE, FINE_WINDOW, FINE_BLURS = 40, 64, (0.8, 1.6, 3.2)
"""Samples across an aligned carpet, those of the window around it, and the blurs that it may have."""

ALIGNED_BLUR, ALIGN_STEPS = 1.2, 10

CLEAR_LIKENESS = 0.97
"""Correlation of an aligned carpet. Carpets have 0.98 and more, other objects 0.95 at the most, in 80 drawn rooms."""

NEAR_PLACE, NEAR_SIZE = 0.1, 1.16
"""Places nearer than this, in sizes, and of sizes nearer than this ratio, are one place."""


@dataclass(frozen=True, slots=True)
class Likely:
    """A likely place of a target: its corners (4, 2) in pixels, and its correlation with the target."""

    corners: Floats
    likeness: float

    @property
    def side_px(self) -> float:
        """Mean side, pixels."""
        return mean_side(self.corners)

    @property
    def is_clear(self) -> bool:
        """Return whether nothing else than the target looks like that."""
        return self.likeness > CLEAR_LIKENESS


def is_carpet(target: Target) -> bool:
    """Return whether a target is searched for by the bright square in its middle: a Sierpinski carpet.

    The square determines the pose if the target is unchanged by a quarter turn and in a
    mirror, has a black rim around the square, and has no other white area as large.
    """
    if not isinstance(target, CellTarget) or target.size_mm[0] != target.size_mm[1]:
        return False
    cells = target.cells
    if not (np.array_equal(cells, np.rot90(cells)) and np.array_equal(cells, cells.T)):
        return False
    labels, _ = ndimage.label(cells == cells.max())
    middle = labels[cells.shape[0] // 2, cells.shape[1] // 2]
    areas = np.bincount(labels.ravel())
    side = np.count_nonzero((labels == middle).any(axis=1))
    return bool(
        middle != 0
        and areas[middle] == areas[1:].max() == side**2
        and 3 * side == cells.shape[0]
    )


def likely_carpets(
    picture: Picture,
    target: Target,
    least_px: float,
    most_px: float = np.inf,
    most: int = MOST_ALIGNED,
) -> list[Likely]:
    """Return likely places of carpets: clear ones first, from the largest on, then the others, likeliest first.

    The carpets within a clear carpet are clear too. Corners have the order of least rotation.

    Parameters
    ----------
    picture : the photograph
    target : the carpet, as `is_carpet` knows it
    least_px, most_px : sides of the smallest and the largest carpet searched for
    most : number of likely places aligned
    """
    bank = _Bank(target)
    spots = [_spots(picture, at, bank) for at in _scales(picture, least_px, most_px)]
    places = np.concatenate([np.empty((0, 5)), *spots])
    likeliest = places[np.argsort(-places[:, 0])]
    enough = max(ALWAYS_ALIGNED, np.count_nonzero(places[:, 0] > LEAST_LIKENESS))
    distinct = _distinct(likeliest[:enough], most)
    likely = list[Likely]()
    for first in range(0, len(distinct), BATCH):
        batch = distinct[first : first + BATCH]
        aligned = (bank.aligned(picture, *place[1:]) for place in batch)
        likely += [one for one in aligned if one is not None]
        if any(one.is_clear for one in likely):
            break
    return sorted(
        likely,
        key=lambda one: (-one.is_clear, -one.side_px if one.is_clear else -one.likeness),
    )


def _scales(picture: Picture, least_px: float, most_px: float) -> Iterator[float]:
    """Yield scales at which carpets of `least_px` to `most_px`, or to the frame's size, have about COARSE_SIDE samples."""
    scale = COARSE_SIDE / least_px
    largest_px = min(most_px, SCALE_STEP * min(picture.shape))
    while scale > COARSE_SIDE / largest_px:
        yield scale
        scale /= SCALE_STEP


def _spots(picture: Picture, scale: float, bank: _Bank) -> Floats:
    """Return (n, 5) places of bright spots: likeness, row, column and side in pixels, direction in degrees."""
    small = picture.scaled(scale)
    if min(small.shape) < SPOT_WINDOW:
        return np.empty((0, 5))
    likeness = _spot_likeness(small)
    peak = (likeness >= cv2.dilate(likeness, np.ones((3, 3)))) & (likeness > LEAST_SPOT)
    rows, cols = np.unravel_index(np.flatnonzero(peak), peak.shape)
    if not len(rows):
        return np.empty((0, 5))
    if len(rows) > MOST_SPOTS:
        brightest = np.argpartition(-likeness[rows, cols], MOST_SPOTS)[:MOST_SPOTS]
        rows, cols = rows[brightest], cols[brightest]
    score, size, direction = bank.compared(small, rows, cols)
    at = (np.column_stack((rows, cols)) + 0.5) / scale - 0.5
    return np.column_stack((score, at, size / scale, direction))


def _spot_likeness(image: Singles) -> Singles:
    """Return the normalised correlation with a Gaussian kernel, in a window about each sample."""
    least_variance = np.float32(_least_variance(image))
    likeness = np.empty_like(image)
    rim = SPOT_WINDOW // 2
    # in strips, which stay in the processor's cache
    for first in range(0, len(image), ROWS_OF_SPOTS):
        top = max(first - rim, 0)
        strip = _strip_likeness(image[top : first + ROWS_OF_SPOTS + rim], least_variance)
        likeness[first : first + ROWS_OF_SPOTS] = strip[first - top :][:ROWS_OF_SPOTS]
    return likeness


def _strip_likeness(image: Singles, least_variance: np.float32) -> Singles:
    window = (SPOT_WINDOW, SPOT_WINDOW)
    line = cv2.getGaussianKernel(SPOT_WINDOW, SPOT_STD)
    kernel_norm = float(np.sqrt(np.sum(line**2) ** 2 - 1 / SPOT_WINDOW**2))
    # OpenCV adds up in double precision, so that a bright window leaves no errors beside it; single precision then resolves
    # a hundredth of a per cent of contrast, and takes half the time
    mean = cv2.boxFilter(image, cv2.CV_32F, window)
    variance = cv2.sqrBoxFilter(image, cv2.CV_32F, window)
    cv2.subtract(variance, cv2.multiply(mean, mean), variance)
    norm = cv2.sqrt(np.maximum(variance, least_variance))
    above = cv2.subtract(cv2.GaussianBlur(image, window, SPOT_STD), mean)
    return np.asarray(
        cv2.divide(above, norm, scale=1 / (kernel_norm * SPOT_WINDOW)), np.float32
    )


def _least_variance(image: Singles) -> float:
    """Return a variance that rounding of single precision does not reach."""
    dark, bright, _, _ = cv2.minMaxLoc(image)
    return max(1e-6 * max(-dark, bright), 1e-12) ** 2


class _Bank:
    """The carpet as it is compared: in many directions, sizes and blurs."""

    def __init__(self, target: Target) -> None:
        self._sharp = _upright(target)
        reach = COARSE_SIDE * max(SIZES) * COMPARED_SHARE / np.sqrt(2)
        self._window = 2 * int(np.ceil(reach)) + 1
        poses = [(size, degrees) for size in SIZES for degrees in DIRECTIONS_DEG]
        self._sizes, self._degrees = np.array(poses).T
        masks, templates = [], []
        for size, degrees in poses:
            mask, blurred = self._template(COARSE_SIDE * size, degrees, COARSE_BLURS)
            masks.append(mask.ravel().astype(np.float32))
            templates.append([t.ravel() for t in blurred])
        self._masks = np.array(masks)
        self._templates = np.array(templates).transpose(1, 0, 2)

    def _template(
        self,
        side: float,
        degrees: float,
        blurs: tuple[float, ...],
        window: int | None = None,
    ) -> tuple[Bools, list[Singles]]:
        """Return the mask of a carpet in a window, and the carpet, blurred, of mean 0 and unit norm within it."""
        window = window or self._window
        finer = UPRIGHT_SIDE / side
        middle = (len(self._sharp) - 1) / 2
        to_fine = _similarity(window, degrees, finer, (middle, middle))
        how = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        smooth = cv2.GaussianBlur(self._sharp, (0, 0), 0.4 * finer)
        drawn = cv2.warpAffine(smooth, to_fine, (window, window), flags=how).astype(
            np.float32
        )
        covered = _square(len(self._sharp), COMPARED_SHARE * UPRIGHT_SIDE)
        mask = cv2.warpAffine(covered, to_fine, (window, window), flags=how) > 0.5
        return mask, [_unit(drawn, blur, mask) for blur in blurs]

    def compared(
        self, image: Singles, rows: NDArray[np.int_], cols: NDArray[np.int_]
    ) -> tuple[Floats, Floats, Floats]:
        """Return, of places in an image, the likeness, side in samples and direction of the likeliest carpet."""
        border = self._window // 2
        padded = cv2.copyMakeBorder(
            image, border, border, border, border, cv2.BORDER_REPLICATE
        )
        windows = np.lib.stride_tricks.sliding_window_view(padded, [self._window] * 2)
        patches = windows[rows, cols].reshape(len(rows), -1)
        patches = patches - patches.mean(axis=1, keepdims=True)
        count = self._masks.sum(axis=1)
        variance = patches**2 @ self._masks.T - (patches @ self._masks.T) ** 2 / count
        products = np.max([patches @ of_blur.T for of_blur in self._templates], axis=0)
        # beside an edge that is not compared, the difference of squares has no digits left
        least = np.maximum(
            EVEN_DEVIATION**2 * (patches**2).sum(axis=1), _least_variance(image)
        )
        likeness = products / np.sqrt(np.maximum(variance, least[:, None]))
        best = likeness.argmax(axis=1)
        of_best = likeness[np.arange(len(best)), best]
        return of_best, COARSE_SIDE * self._sizes[best], self._degrees[best]

    @cached_property
    def _fine(self) -> tuple[Bools, list[Singles], Singles]:
        """Mask and blurred carpets of a window of FINE_WINDOW, and the carpet aligned, without its rim."""
        mask, blurred = self._template(FINE_SIDE, 0.0, FINE_BLURS, FINE_WINDOW)
        rim = (FINE_WINDOW - FINE_SIDE) // 2 + 1
        _, (aligned,) = self._template(FINE_SIDE, 0.0, (ALIGNED_BLUR,), FINE_WINDOW)
        return mask, blurred, np.ascontiguousarray(aligned[rim:-rim, rim:-rim])

    def aligned(
        self, picture: Picture, row: float, col: float, side: float, degrees: float
    ) -> Likely | None:
        """Return a carpet near a place, aligned; None where no carpet can be aligned."""
        mask, blurred, template = self._fine
        from_window = _similarity(FINE_WINDOW, -degrees, side / FINE_SIDE, (row, col))
        window = picture.warped(from_window, (FINE_WINDOW, FINE_WINDOW))
        rim = (FINE_WINDOW - len(template)) // 2
        start = np.array([[1, 0, rim], [0, 1, rim]], np.float32)
        criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, ALIGN_STEPS, 1e-3)
        everywhere = np.ones(window.shape, np.uint8)
        try:
            _, found = cv2.findTransformECC(
                template, window, start, cv2.MOTION_AFFINE, criteria, everywhere, 3
            )
        except cv2.error:  # it did not converge
            return None
        moved = found @ np.array([[1, 0, -rim], [0, 1, -rim], [0, 0, 1]])
        how = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        seen = cv2.warpAffine(
            window, moved, window.shape, flags=how, borderMode=cv2.BORDER_REPLICATE
        )
        likeness = max(
            correlation(np.asarray(seen, np.float32), one, mask) for one in blurred
        )
        corners = (FINE_WINDOW - 1) / 2 + FINE_SIDE * OWN_CORNERS[:, ::-1]
        for by in (moved, from_window):
            corners = corners @ by[:, :2].T + by[:, 2]
        return Likely(least_rotation(np.asarray(corners[:, ::-1], np.float64)), likeness)


UPRIGHT_SIDE = 162
"""Samples across a carpet drawn once, and turned and shrunk from then on."""


def _upright(target: Target) -> Singles:
    """Return a carpet of UPRIGHT_SIDE samples with half as much around it."""
    size_mm = target.size_mm[0]
    spacing = size_mm / UPRIGHT_SIDE
    reach = UPRIGHT_SIDE // 2 + UPRIGHT_SIDE // 4
    y = (np.arange(-reach, reach) + 0.5) * spacing
    return np.asarray(target.sample(y, y, 0.4 / spacing), np.float32)


def _square(size: int, side: float) -> Singles:
    inside = np.abs(np.arange(size) - (size - 1) / 2) < side / 2
    return np.asarray(np.outer(inside, inside), np.float32)


def _unit(image: Singles, blur: float, mask: Bools) -> Singles:
    blurred = cv2.GaussianBlur(image, (0, 0), blur)
    about = np.where(mask, blurred - blurred[mask].mean(), 0.0)
    return np.asarray(about / np.linalg.norm(about), np.float32)


def _similarity(
    window: int, degrees: float, scale: float, middle: tuple[float, float]
) -> Floats:
    """Return the map (2, 3) of (x, y) in a square window that turns, stretches, and carries its middle to a (row, column)."""
    own = (window - 1) / 2
    turned = cv2.getRotationMatrix2D((own, own), degrees, scale)
    shift = np.array([[0, 0, middle[1] - own], [0, 0, middle[0] - own]])
    return np.asarray(turned + shift, np.float64)


def _distinct(places: Floats, most: int) -> Floats:
    """Return the first of places (n, 5) of about the same position and size, `most` of them at most."""
    kept = np.empty((0, 5))
    for place in places:
        if len(kept) == most:
            break
        size_ratio = np.abs(np.log(kept[:, 3] / place[3]))
        away = np.abs(kept[:, 1:3] - place[1:3]).max(axis=1, initial=0.0)
        same = (away < NEAR_PLACE * place[3]) & (size_ratio < np.log(NEAR_SIZE))
        if not same.any():
            kept = np.vstack((kept, place))
    return kept


def least_rotation(corners: Floats) -> Floats:
    """Return corners clockwise on the screen (x right, y down), the first side nearest to pointing right."""
    first, second = corners[1] - corners[0], corners[2] - corners[1]
    if first[0] * second[1] - first[1] * second[0] > 0:
        corners = corners[::-1]
    sides = np.roll(corners, -1, axis=0) - corners
    start = int(np.argmax(sides[:, 1] / np.linalg.norm(sides, axis=1)))
    return np.roll(corners, -start, axis=0)
