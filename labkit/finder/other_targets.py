"""Targets that a photograph may show in place of the stated one: of another order or kind, its negative, or in a mirror.

An other target with the same outline is found where the stated one is. Both are compared there, pixel by pixel, each through
the kernel that suits it best: a sum of Gaussians of many widths. A kernel can blur detail away that the photograph lacks, so
the target shown leaves no more unexplained than others do; where the lens or the pixels resolve the detail, it leaves
far less. Detail that they do not resolve cannot be told.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import chain

import cv2
import numpy as np

from labkit.finder.picture import Picture, Singles, single
from labkit.finder.registration import covered, drawn_with_rim, homography, mean_side
from labkit.target.target import CellTarget, Target, open_target
from labkit.types import Bools, Floats

ANY_CARPET = "sierpinski:order=4,size_mm=30"
"""Looked for where another kind of target is not found."""

MOST_CARPET_ORDER_TRIED, ORDERS_OFF = 8, 2
"""Largest order of a carpet; and by how much an order may be wrong."""

SHARP_KERNEL_PX, WIDE_KERNEL_PX = (0.35, 0.5, 0.7, 1.0), (1.4, 2.0, 2.8, 4.0, 5.6, 8.0)
"""Standard deviations of the Gaussians of a kernel, samples: from sharp to far out of focus."""

OWN_LIGHT_DEGREE = 2
"""Degree of the polynomial in row and column by which the light, and haze, may differ over the target."""

COMPARED_SIDE = 500
"""Samples across a target compared: a larger picture is binned down to about this."""

DRAWN_FINER = 2.5
"""Samples of a drawn target along a sample of the picture."""

INNER = 0.97
"""Part of a target's side compared: anything may be beside it."""

CLEARLY_LESS = 0.5
"""Share of what the stated target leaves unexplained, below which another target is the one that is shown. In 57 photographs
of golden sessions and 130 drawn ones, in focus and far out of it, other orders left 0.98 of it or more."""

LEAST_CELL = 0.4
"""Samples of the picture along a cell, below which a target's finest cells cannot be told from grey."""


@dataclass(frozen=True, slots=True)
class Other:
    """Another target: shown, what the photograph shows, in words; remedy, what to do.

    in_negative: whether to look for it in the picture's negative, for carpets are found far quicker than other drawings.
    """

    target: Target
    shown: str
    remedy: str
    in_negative: bool = False

    @property
    def message(self) -> str:
        """One line for the user."""
        return f"the photograph shows {self.shown}: {self.remedy}"


def other_targets(target: Target) -> Iterator[Other]:
    """Yield the targets that may be shown in place of a target and have to be searched for."""
    if isinstance(target, CellTarget):
        yield Other(
            replace(target, surround=None),
            "the negative of the target",
            "exchange black and white, in what is shown or in [target]",
            in_negative=True,
        )
        mirrored = target.cells[:, ::-1]
        turned = (np.rot90(target.cells, k) for k in range(4))
        if not any(np.array_equal(mirrored, cells) for cells in turned):
            yield Other(
                replace(target, cells=mirrored),
                "the target mirrored",
                "show and photograph it unmirrored",
            )
        yield from _other_surround(target)
    if carpet_order(target) is None:
        yield Other(
            open_target(ANY_CARPET), "a Sierpinski carpet", "check kind of [target]"
        )


def _other_surround(target: CellTarget) -> Iterator[Other]:
    """Yield a target with white around it in place of black, or the other way round."""
    if target.surround is None:
        return
    words = ("black", "white") if target.surround == 0 else ("white", "black")
    yield Other(
        replace(target, surround=1.0 - target.surround),
        f'the target with a {words[1]} surround, [target] has surround = "{words[0]}"',
        f'write surround = "{words[1]}"',
    )


def other_orders(target: Target, most_cells: float) -> Iterator[Other]:
    """Yield carpets of other orders, the nearest first, that may be shown where a carpet is found; none for other targets.

    most_cells : most cells along a side that can be told from grey
    """
    stated = carpet_order(target)
    if not isinstance(target, CellTarget) or stated is None:
        return
    size_mm = target.size_mm[0]
    off = range(1, ORDERS_OFF + 1)
    for order in chain.from_iterable((stated + k, stated - k) for k in off):
        if 1 <= order <= MOST_CARPET_ORDER_TRIED and 3**order <= most_cells:
            carpet = open_target(f"sierpinski:order={order},size_mm={size_mm!r}")
            shown = f"order {order}, [target] order = {stated}"
            yield Other(carpet, shown, f"write order = {order}")


def carpet_order(target: Target) -> int | None:
    """Return the order of a Sierpinski carpet; None for other targets."""
    if not isinstance(target, CellTarget) or target.size_mm[0] != target.size_mm[1]:
        return None
    return _order(target.cells)


def _order(cells: Floats) -> int | None:
    """Return the order of a carpet of cells (n, n); 0 for a black cell, None for no carpet."""
    if cells.shape == (1, 1):
        return 0 if cells[0, 0] == 0 else None
    third = cells.shape[0] // 3
    if third == 0 or cells.shape != (3 * third, 3 * third):
        return None
    blocks = cells.reshape(3, third, 3, third).transpose(0, 2, 1, 3)
    around = [blocks[at] for at in np.ndindex(3, 3) if at != (1, 1)]
    if not all(np.array_equal(block, around[0]) for block in around):
        return None
    order = _order(around[0])
    return None if order is None or np.any(blocks[1, 1] != 1) else order + 1


def shown_in_place(picture: Picture, target: Target, corners: Floats) -> Other | None:
    """Return the target that a photograph shows where a carpet is found; None if no other order explains it far better.

    Parameters
    ----------
    picture : the photograph
    target : the target found
    corners : (4, 2) of it, to a fraction of a pixel
    """
    window = _Window.of(picture, corners)
    others = list(other_orders(target, window.side / LEAST_CELL))
    if not others:
        return None
    left = [window.unexplained(other.target) for other in others]
    if min(left) >= CLEARLY_LESS * window.unexplained(target):
        return None
    # finer squares than lens and pixels resolve make no difference: of orders that explain alike, the nearest
    return next(
        other
        for other, one in zip(others, left, strict=True)
        if one <= min(left) / CLEARLY_LESS
    )


@dataclass(frozen=True, slots=True)
class _Window:
    """A picture around a target: image, with all its pixels; period, after which the colours repeat; target's corners in it."""

    image: Singles
    period: int
    corners: Floats
    inside: Bools

    @classmethod
    def of(cls, picture: Picture, corners: Floats) -> _Window:
        factor = picture.binning(round(mean_side(corners) / COMPARED_SIDE))
        last = np.array(picture.shape)
        low = picture.whole_cells(np.clip(np.floor(corners.min(axis=0)), 0, last))
        high = np.clip(np.ceil(corners.max(axis=0)).astype(int) + 1, 0, last)
        image, period = picture.own_pixels(low, high, factor)
        at = (corners - low + 0.5) / factor - 0.5
        inner = at.mean(axis=0) + INNER * (at - at.mean(axis=0))
        return cls(image, period, at, covered(inner, image.shape) > 0)

    @property
    def side(self) -> float:
        """Mean side of the target, samples."""
        return mean_side(self.corners)

    def unexplained(self, target: Target) -> float:
        """Return the share of the picture's variance that a target leaves, drawn through the likeliest kernel and light.

        Colours of a mosaic are compared apart: each has its own scale, and its own kernel.
        """
        drawn = self._drawn(target)
        light = _polynomials(self.image.shape)
        left = []
        for row, col in np.ndindex(self.period, self.period):
            places = np.s_[row :: self.period, col :: self.period]
            where = self.inside[places]
            seen = self.image[places][where].astype(np.float64)
            one = drawn[len(SHARP_KERNEL_PX) - 1][places][where]
            columns = [of[places][where] for of in (*light, *drawn)]
            columns += [of[places][where] * one for of in light[1:]]
            design = np.stack(columns, axis=1).astype(np.float64)
            fitted = np.linalg.lstsq(design.T @ design, design.T @ seen, rcond=1e-9)[0]
            variance = float(np.var(seen))
            residual = float(np.mean((seen - design @ fitted) ** 2))
            left.append(residual / variance if variance else 1.0)
        return float(np.mean(left))

    def _drawn(self, target: Target) -> list[Singles]:
        """Return the drawn target through each Gaussian."""
        sharp, at = drawn_with_rim(target, DRAWN_FINER * self.side)
        by = homography(at, self.corners)
        size = self.image.shape[::-1]
        fine = [
            single(cv2.warpPerspective(_blurred(sharp, DRAWN_FINER * std), by, size))
            for std in SHARP_KERNEL_PX
        ]
        rest = [np.sqrt(std**2 - SHARP_KERNEL_PX[-1] ** 2) for std in WIDE_KERNEL_PX]
        return [*fine, *(_blurred(fine[-1], std) for std in rest)]


def _blurred(image: Singles, std: float) -> Singles:
    return single(cv2.GaussianBlur(image, (0, 0), std, borderType=cv2.BORDER_REPLICATE))


def _polynomials(shape: tuple[int, ...]) -> list[Singles]:
    """Return the products of powers of row and column up to OWN_LIGHT_DEGREE, constant first, over an image."""
    y, x = np.meshgrid(
        *(np.linspace(-1, 1, n, dtype=np.float32) for n in shape), indexing="ij"
    )
    degrees = range(OWN_LIGHT_DEGREE + 1)
    return [y**i * x**j for i in degrees for j in degrees if i + j <= OWN_LIGHT_DEGREE]
