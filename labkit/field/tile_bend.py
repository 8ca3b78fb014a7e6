"""How a lens's distortion bends the tiles of one large target, by the places of all tiles.

A fit gives each tile a homography, which keeps lines straight. Distortion is smooth over the
frame: the places of the tiles tell what it does within each.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from labkit.field.geometry import ADOPTED_P
from labkit.field.tile_fit import (
    chosen,
    fit_tiles,
    linear_homography,
    without_outliers,
)
from labkit.field.tile_model import (
    DECENTRE,
    FIFTH,
    RADIAL,
    TILE_GROWTH,
    TileModel,
    distorted,
)
from labkit.field.tile_places import PartsOfTarget, TilePlace
from labkit.imaging.warp import BEND_POWERS, Pose
from labkit.optics.field import FieldFrame
from labkit.types import Floats

ALONG = 7
"""Places along each side of a tile at which its bend is sampled: twice the powers of the polynomials, less one."""

STRAIGHT_STEPS = 12
"""Of the iteration for places without distortion. Each multiplies their error by the distortion's change of sizes, a tenth."""

Straight = Callable[[Floats], Floats]
"""Returns places (n, 2) in pixels as a lens without distortion would show them."""


def lens_distortion(
    frame: FieldFrame, parts: PartsOfTarget, places: Sequence[TilePlace]
) -> Straight | None:
    """Return the inverse of the lens's distortion by the places of one target's tiles; None if it is not significant.

    Parameters
    ----------
    frame : coordinates
    parts : the tiles on the target
    places : of the tiles; photographs have the numbers of their keys' ranges
    """
    photographs = tuple(sorted({place.key.range_mm or 0.0 for place in places}))
    channels = tuple({place.key.channel for place in places})
    far = np.full(len(photographs), np.inf)
    model = TileModel(frame, parts, tuple(places), photographs, channels, far)
    plain, wider = (
        chosen(model, fifth=False, bend=False),
        chosen(model, fifth=True, bend=False),
    )
    # tiles of one target are as large as it is
    plain[model.shared.start + TILE_GROWTH[0]] = False
    wider[model.shared.start + TILE_GROWTH[0]] = False
    fit = without_outliers(model, plain)
    # at this probability distortion is known to a quarter of itself
    if fit.p_value(model.shared.start + np.array([*RADIAL, *DECENTRE])) >= ADOPTED_P:
        return None
    with_fifth = fit_tiles(model, wider, fit.apart)
    if with_fifth.p_value(model.shared.start + np.array(FIFTH)) < ADOPTED_P:
        fit = with_fifth
    shared = fit.numbers[model.shared]

    def straight(places_px: Floats) -> Floats:
        seen = frame.heights_mm(places_px)
        ideal = seen
        for _ in range(STRAIGHT_STEPS):
            ideal = ideal + seen - distorted(ideal, shared)
        return frame.places_px(ideal)

    return straight


def bend_of(pose: Pose, straight: Straight) -> Floats:
    """Return the bend (2, 4, 4) of a tile by a lens's distortion: what the nearest homography leaves of it, see `Pose`.

    Parameters
    ----------
    pose : of the tile, in pixels of the photograph
    straight : the lens
    """
    along = np.linspace(-1, 1, ALONG)
    within = np.stack(np.meshgrid(along, along, indexing="ij"), axis=-1).reshape(-1, 2)
    ideal = straight(pose.to_pixels(*within.T))
    on_target = np.append(linear_homography(ideal, within), 1.0).reshape(3, 3)
    carried = np.column_stack([ideal, np.ones(len(ideal))]) @ on_target.T
    left = within - carried[:, :2] / carried[:, 2:]
    y, x = within.T
    powers = [p for p in np.ndindex(BEND_POWERS, BEND_POWERS) if sum(p) < BEND_POWERS]
    rows = np.stack([y**i * x**j for i, j in powers], axis=1)
    bend = np.zeros((2, BEND_POWERS, BEND_POWERS))
    for (i, j), of in zip(powers, np.linalg.lstsq(rows, left, rcond=None)[0], strict=True):
        bend[:, i, j] = of
    return bend
