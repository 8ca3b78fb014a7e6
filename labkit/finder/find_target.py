"""Find the target in a photograph without help: the start of every fit (thesis §2.4.2).

Likely places come from a carpet's squares, or from correlation over scale and direction, in coarse copies of the
photograph. Registration with the rendered target refines each in the photograph's own pixels; a place is accepted only if
the photograph agrees with the target everywhere. Whatever else is in the frame plays no part.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import ArrayLike

from labkit.errors import TargetError
from labkit.finder.carpet_search import BATCH, Likely, is_carpet, likely_carpets
from labkit.finder.mark_search import places_by_marks
from labkit.finder.other_targets import Other, other_targets, shown_in_place
from labkit.finder.picture import LEAST_CONTRAST, Picture
from labkit.finder.registration import (
    BEYOND_DOUBT,
    CLEAR_AGREEMENT,
    HOPELESS,
    LEAST_AGREEMENT,
    OWN_CORNERS,
    Agreement,
    homography,
    light_range,
    mapped,
    mean_side,
    parents,
    register,
)
from labkit.finder.template_search import likely_places
from labkit.photographs.photograph import Photograph
from labkit.target.grid import TargetGrid
from labkit.target.target import Target
from labkit.types import Floats

SCALE_TOLERANCE = 0.15
"""How far `mm_per_pixel` may be off."""

LEAST_TARGET_SIDE_PX = 12.0
"""A quadrilateral with a shorter side is a sliver: stretched, any edge of a picture looks like a target far out of focus.
The search looks for targets of 20 pixels and more; registration may shrink one by a third of that."""

USUAL_PX, SMALLEST_PX = 48.0, 20.0
"""Smallest side of a carpet searched for, and where none is found: a fit wants 60 pixels. In a frame of 24 million
pixels a search takes 0.5 s of a processor without the smallest, 1.4 s with them (`python -m benchmarks.rooms`)."""

SMALLEST_FITTED_PX = 36.0
"""Side below which a target says nothing: a carpet's squares of the third order have 1.3 pixels."""

MOST_SHOWN = 6
"""Likely places that a picture of a search in vain shows."""

MOST_REGISTERED = 8
"""Likely places without a clear target looked at in the photograph's own pixels."""

MOST_OUTSIDE = 0.05
"""Largest share of a target's side outside the frame, where the drawing is known and modelled."""

REFLECTED = 0.5
"""Light of another target, relative to the found one's, below which it is a reflection of it."""

ALIKE_SIDES = 0.5
"""Side of another target, relative to the found one's, below which it is none that could be meant."""


def margin_px(corners: Floats, shape: tuple[int, ...]) -> float:
    """Return the distance of a target's corners (..., 2) from the frame's edge; negative outside."""
    last = np.array(shape) - 0.5
    return -max(float(np.max(-0.5 - corners)), float(np.max(corners - last)))


def find_target(
    image: ArrayLike | Photograph | Picture,
    target: Target,
    *,
    mm_per_pixel: float | None = None,
) -> Floats:
    """Return the target's four corners in a photograph, to about half a pixel.

    If several poses look the same (a carpet has eight), the pose of least rotation is
    returned.

    Parameters
    ----------
    image : a decoded photograph of any size, or a grey image (rows, cols), linear or nearly so, of any scale and
        offset; NaN where there is no value
    target : the target; with marks as a grid of one, and of several targets the marked one is returned
    mm_per_pixel : millimetres on the target for each pixel, within 15 %. Of several carpets the one of this size is
        returned; other targets are searched for at this size

    Returns
    -------
    (4, 2) corners (row, col), pixel centres at integers, in the order of the target's own
    (0, 0), (0, w), (h, w), (h, 0)

    Raises
    ------
    TargetError
        The target is not in the frame, or outside by more than 5 % of its side, or there are several; or another one is shown.
    """
    alone, marked = (
        (target.tile, target) if isinstance(target, TargetGrid) else (target, None)
    )
    search = _Search(Picture.of(image), alone)
    try:
        found = search.found_by_marks(marked) if marked is not None else []
        found = found or search.found(mm_per_pixel)
    except TargetError as error:
        if (other := search.other_shown()) is None:
            raise
        raise TargetError(other.message, error.likely_px) from error
    corners = _meant(found, alone, mm_per_pixel)
    if (other := shown_in_place(search.picture, alone, corners)) is not None:
        raise TargetError(other.message, [corners])
    return corners


def likely_targets(
    picture: Picture, target: Target, mm_per_pixel: float | None
) -> Iterator[list[Likely]]:
    """Yield likely places of a target, batch by batch, the likeliest first; of a carpet those of usual size first.

    Parameters are those of `find_target`.
    """
    if is_carpet(target):
        found = likely_carpets(picture, target, USUAL_PX)
        yield found[: sum(one.is_clear for one in found) + MOST_REGISTERED]
        yield likely_carpets(picture, target, SMALLEST_PX, USUAL_PX, BATCH)[
            :MOST_REGISTERED
        ]
        return
    if mm_per_pixel is not None:
        middle = target.size_mm[0] / mm_per_pixel
        ends = (middle * (1 - SCALE_TOLERANCE), middle * (1 + SCALE_TOLERANCE))
        yield from likely_places(picture, target, ends)
    yield from likely_places(picture, target, None)


@dataclass(slots=True)
class _Search:
    """The search for a target in a photograph.

    best: agreement at the likeliest place looked at; likely: all those places, the likeliest first; complaints: why
    targets found are none to fit.
    """

    picture: Picture
    target: Target
    best: Agreement = field(default_factory=lambda: Agreement(0.0, ()))
    likely: list[Floats] = field(default_factory=list)
    complaints: list[TargetError] = field(default_factory=list)

    def accepted(self, start: Floats) -> Floats | None:
        """Return the corners of the whole target near likely ones; None where it is not, or not wholly in the frame."""
        corners, agreement = register(self.picture, self.target, start)
        if not is_target_shaped(corners):
            return None
        self.best = max(self.best, agreement, key=lambda one: one.credit)
        if not any(contains(other, corners) for other in self.likely):
            self.likely.append(corners)
        if not agreement.is_believable:
            return None
        if self.complaints and agreement.whole < BEYOND_DOUBT:
            return None
        try:
            return self._whole(corners)
        except TargetError as complaint:  # of a blurred picture a wrong pose may be believed: there may be a better one
            self.complaints.append(complaint)
            if agreement.whole > CLEAR_AGREEMENT:
                raise self.complaints[0] from None
            return None

    def _whole(self, corners: Floats) -> Floats:
        """Return the corners of the whole target. Raises TargetError where it is not nearly inside the frame."""
        beyond = -margin_px(corners, self.picture.shape)
        if beyond > MOST_OUTSIDE * np.ptp(corners, axis=0).max():
            raise TargetError(
                f"the target reaches {beyond:.0f} pixels out of the frame: move it, or the camera, back in",
                [corners],
            )
        if not is_carpet(self.target):
            return corners
        large, likeness = max(
            parents(self.picture, self.target, corners), key=lambda parent: parent[1]
        )
        if likeness > HOPELESS:
            around, agreement = register(self.picture, self.target, large)
            if is_target_shaped(around) and agreement.is_believable:
                return self._whole(around)
        if likeness <= LEAST_AGREEMENT:
            return corners
        side_px, shape = float(np.ptp(large, axis=0).max()), self.picture.shape
        if (np.ptp(large, axis=0) > shape).any():
            raise TargetError(
                f"the target is larger than the frame: it would span {side_px:.0f} of {shape[0]} × {shape[1]} pixels; "
                "move the camera back, or show a smaller target",
                [large],
            )
        raise TargetError(
            "only a part of the target is in the frame: move it, or the camera, back in",
            [large],
        )

    def others(self, corners: Floats, likely: Sequence[Likely]) -> list[Floats]:
        """Return the corners of other clear targets, as light and about as large as the one that was found."""
        least_px = ALIKE_SIDES * mean_side(corners)
        least_light = REFLECTED * light_range(self.picture, corners)
        found = [corners]
        for one in likely:
            seen = any(contains(f, one.corners) or contains(one.corners, f) for f in found)
            if seen or not one.is_clear or one.side_px < least_px:
                continue
            at, agreement = register(self.picture, self.target, one.corners)
            if is_target_shaped(at) and agreement.is_believable:
                found.append(at)
        return [at for at in found[1:] if light_range(self.picture, at) > least_light]

    def found(self, mm_per_pixel: float | None) -> list[Floats]:
        """Return the corners of the target, and of others as clear. Raises TargetError where none is found whole."""
        for batch in likely_targets(self.picture, self.target, mm_per_pixel):
            for number, likely in enumerate(batch):
                corners = self.accepted(likely.corners)
                if corners is not None:
                    return [corners, *self.others(corners, batch[number + 1 :])]
        raise self.failure()

    def found_by_marks(self, marked: TargetGrid) -> list[Floats]:
        """Return the corners of the targets that have marks beside them, in the coarsest copy that shows one; or none."""
        for places in places_by_marks(self.picture, marked):
            found: list[Floats] = []
            for place in places:
                if any(contains(one, place) for one in found):
                    continue
                if (corners := self.accepted(place)) is not None:
                    found.append(corners)
            if found:
                return found
        return []

    def other_shown(self) -> Other | None:
        """Return the target that is in the frame in place of the one that is not found; None if there is none either."""
        if self.picture.contrast() < LEAST_CONTRAST:
            return None
        for other in other_targets(self.target):
            picture = self.picture.negative() if other.in_negative else self.picture
            with suppress(TargetError):
                if _Search(picture, other.target).found(None):
                    return other
        return None

    def failure(self) -> TargetError:
        """Return why no target was found."""
        if self.complaints:
            return self.complaints[0]
        contrast = self.picture.contrast()
        if contrast == 1:
            return TargetError(
                "no target found in the frame: it is of one grey all over; check exposure and lens cap"
            )
        if contrast < LEAST_CONTRAST:
            return TargetError(
                f"no target found in the frame: it is nearly even, bright parts {contrast:.2f} times as bright as dark ones; "
                "is the target shown, or white?"
            )
        return TargetError(
            f"no target found in the frame: the likeliest place correlates {max(self.best.credit, 0.0):.2f} with it, "
            f"{LEAST_AGREEMENT:g} is needed; check [target] in the plan, focus and light, or give its corners_px",
            self.likely[:MOST_SHOWN],
        )


def _meant(targets: list[Floats], target: Target, mm_per_pixel: float | None) -> Floats:
    """Return the corners of the only target, or of the only one of the stated scale. Raises TargetError for several."""
    side = max(map(mean_side, targets))
    if side < SMALLEST_FITTED_PX:
        raise TargetError(
            f"the target spans {side:.0f} pixels: a fit wants 60 and more; come nearer, or show a larger one",
            targets,
        )
    of_scale = [
        corners for corners in targets if right_scale(corners, target, mm_per_pixel)
    ]
    meant = of_scale or targets
    if len(meant) == 1:
        return meant[0]
    places = " and ".join(
        f"[{row:.0f}, {col:.0f}]" for row, col in (c.mean(axis=0) for c in meant)
    )
    raise TargetError(
        f"{len(meant)} targets are in the frame, at [row, column] {places}: cover all but one, or give its corners_px",
        meant,
    )


def is_target_shaped(corners: Floats) -> bool:
    """Return whether a quadrilateral is convex, and no sliver."""
    shortest = float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).min())
    return shortest >= LEAST_TARGET_SIDE_PX and cv2.isContourConvex(
        corners.astype(np.float32)
    )


def contains(corners: Floats, other: Floats) -> bool:
    """Return whether the middle of another quadrilateral is within a quadrilateral."""
    by = homography(corners, OWN_CORNERS)
    return bool(np.all(np.abs(mapped(by, other.mean(axis=0)[None])) < 0.5))


def right_scale(
    corners: Floats, target: Target, mm_per_pixel: float | None, slack: float = 1.3
) -> bool:
    """Return whether a target's size agrees with the scale, if known."""
    if mm_per_pixel is None:
        return True
    ratio = (
        np.linalg.norm(corners[0] - corners[2]) * mm_per_pixel / np.hypot(*target.size_mm)
    )
    tolerance = 1 + slack * SCALE_TOLERANCE
    return bool(1 / tolerance < ratio < tolerance)
