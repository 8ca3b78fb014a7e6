"""Distortion, lateral colour and the target's pose, by the places of the target's tiles.

>>> geometry = fit_geometry(frame, grid, tile_places(results), lens)
>>> print(geometry.k1_per_mm2, geometry.lateral_colour["R"].scale)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import ArrayLike

from labkit.field.tile_fit import (
    COMPLEX_STEP,
    MIDDLE,
    TileFit,
    chosen,
    fit_tiles,
    prior_std,
    without_outliers,
)
from labkit.field.tile_model import (
    BEND,
    DECENTRE,
    DEPTHS,
    FIFTH,
    HOMOGRAPHY,
    RADIAL,
    TILE_GROWTH,
    Numbers,
    TileModel,
    distorted,
    sag_mm,
)
from labkit.field.tile_places import CORNERS, TileGrid, TilePlace, affine_rows
from labkit.key import Key
from labkit.optics.field import FieldFrame
from labkit.optics.lens import ThinLens
from labkit.results.geometry import Distortion, ImageGeometry, LateralColour
from labkit.types import Floats
from labkit.uncertain import Uncertain

ADOPTED_P = 1e-3
"""Probability that chance makes a fit take in k2, or the print's curvatures, that are not there."""

SURE_ERRORS = 3.0
"""Standard errors that k1 has to be from zero for the distortion to have a centre."""

UNKNOWN_SHARE = 0.5
"""Share of its prior standard deviation that the error of an undetermined number keeps."""


@dataclass(frozen=True, eq=False)
class Bend:
    """A print that is not flat.

    Parameters
    ----------
    curvatures_per_mm : (3,) down, right, mixed; positive where the print's edges are farther from the camera
    covariance : (3, 3)
    depth_mm : distance between the print's nearest and farthest corners or middle, without the plane
    p_value : probability that a flat print looks as bent
    """

    curvatures_per_mm: Floats
    covariance: Floats
    depth_mm: Uncertain
    p_value: float


@dataclass(frozen=True, eq=False)
class FieldGeometry:
    """The target's tiles as the lens images them.

    Parameters
    ----------
    fit : of a plane homography for each range, distortion and lateral colour
    fifth_p_value : probability that a lens without k2 seems to need it
    bend : of the print; None where a flat print explains the places
    bend_p_value : probability that a flat print looks as bent
    bent_fit : the same with the print's curvatures free; its errors hold for a print that nobody knows to be flat
    """

    fit: TileFit
    fifth_p_value: float
    bend: Bend | None
    bend_p_value: float
    bent_fit: TileFit

    @property
    def model(self) -> TileModel:
        """The frame, the tiles, and which number is which."""
        return self.fit.model

    @property
    def k1_per_mm2(self) -> Uncertain:
        """Radial distortion: relative growth of the image for each mm² of image height squared."""
        return _shared(self.fit, RADIAL[0], "/mm²")

    @property
    def k1_of_any_print_per_mm2(self) -> Uncertain:
        """The same for a print that may be bent: ranges that differ little hardly tell a dome from distortion."""
        return _shared(self.bent_fit, RADIAL[0], "/mm²")

    @property
    def k2_per_mm4(self) -> Uncertain | None:
        """Distortion of fifth order; None where the places do not ask for it."""
        fitted = self.fifth_p_value < ADOPTED_P
        return _shared(self.fit, FIFTH[0], "/mm⁴") if fitted else None

    @property
    def tile_growth(self) -> Uncertain:
        """Size of the tiles over that of the plan, less 1, with the pitch as stated."""
        return _shared(self.fit, TILE_GROWTH[0], "")

    @property
    def centre_px(self) -> tuple[Floats, Floats] | None:
        """Centre (2,) of the distortion, and its covariance (2, 2); None for a lens without significant distortion."""
        k1 = self.k1_per_mm2
        if not abs(k1.value) > SURE_ERRORS * k1.std:
            return None
        return self.linear(self._centre)

    def _centre(self, numbers: Numbers) -> Numbers:
        shared = numbers[self.model.shared]
        pitch_mm = 1e-3 * self.model.frame.pixel_pitch_um
        middle = self.model.frame.centre_px
        offset_mm = -shared[list(DECENTRE)] / shared[RADIAL[0]]
        return np.asarray(middle + offset_mm / pitch_mm)

    def distortion_px(self, places_px: ArrayLike) -> tuple[Floats, Floats]:
        """Return how far (n, 2) distortion moves places (n, 2) without distortion, px, and covariances (n, 2, 2)."""
        at = self.model.frame.heights_mm(places_px)
        pitch_mm = 1e-3 * self.model.frame.pixel_pitch_um

        def moved(numbers: Numbers) -> Numbers:
            away = distorted(at, numbers[self.model.shared]) - at
            return np.ravel(away) / pitch_mm

        return self._places(moved, len(at))

    def percent(self, height_mm: float) -> Uncertain:
        """Return the distortion at an image height, relative, in %, without the centre's offset."""

        def relative(numbers: Numbers) -> Numbers:
            shared = numbers[self.model.shared]
            square = height_mm**2
            growth = shared[list(RADIAL)] + shared[list(FIFTH)] * square
            return np.asarray(100 * growth * square)

        value, covariance = self.linear(relative)
        return Uncertain(value[0], sqrt(covariance[0, 0]), "%")

    @property
    def lateral_colour(self) -> dict[str, LateralColour]:
        """Lateral colour of each channel but the reference."""
        found = {}
        for channel in self.model.channels[1:]:
            at = self.model.colour(channel)
            value = self.fit.numbers[at]
            covariance = self.fit.covariance[at, at]
            scale = Uncertain(value[0], sqrt(covariance[0, 0]))
            shift = 1e3 * value[1:]
            found[channel] = LateralColour(scale, shift, 1e6 * covariance[1:, 1:])
        return found

    def lateral_px(self, channel: str, places_px: ArrayLike) -> tuple[Floats, Floats]:
        """Return how far (n, 2) a channel's image is from the reference's at places (n, 2), and covariances (n, 2, 2)."""
        at = self.model.frame.heights_mm(places_px)
        pitch_mm = 1e-3 * self.model.frame.pixel_pitch_um

        def moved(numbers: Numbers) -> Numbers:
            own = numbers[self.model.colour(channel)]
            own = own if own.size else np.zeros(3)
            return np.ravel(at * own[0] + own[1:]) / pitch_mm

        return self._places(moved, len(at))

    @property
    def residual_px(self) -> float:
        """RMS of the coordinates of the tiles' middles about the model, px, without what was set apart."""
        corners = np.stack([place.corners_px for place in self.model.places])
        left = affine_rows(corners)[:, MIDDLE] @ self.fit.residual_px[..., None]
        return float(np.sqrt(np.mean(left[~self.fit.apart] ** 2)))

    @property
    def pulls(self) -> Floats:
        """(n, 6) residuals of each tile in standard errors, independent of each other but for the fit."""
        return self.fit.pulls

    @property
    def outliers(self) -> tuple[Key, ...]:
        """Tiles that contradict the others, and were left out."""
        both = zip(self.model.places, self.fit.apart, strict=True)
        return tuple(place.key for place, apart in both if apart)

    @property
    def unknown(self) -> tuple[str, ...]:
        """Numbers that these tiles do not determine, in words."""
        prior = prior_std(self.model)
        share = np.sqrt(np.diag(self.fit.covariance)) / prior
        bent = np.sqrt(np.diag(self.bent_fit.covariance)) / prior
        poses = share[: self.model.shared.start].reshape(-1, HOMOGRAPHY)
        lens = share[self.model.shared]
        words = {
            "the target's tilt": poses[:, list(DEPTHS)],
            "the distortion": lens[list(RADIAL)],
            "the distortion's centre": lens[list(DECENTRE)],
            "how far the print is bent": bent[self.model.shared][list(BEND)],
        }
        return tuple(name for name, at in words.items() if np.any(at > UNKNOWN_SHARE))

    def linear(self, of: Callable[[Numbers], Numbers]) -> tuple[Floats, Floats]:
        """Return the value (n,) and the covariance (n, n) of a function of the fit's numbers that accepts complex ones."""
        numbers = self.fit.numbers
        value = np.real(of(numbers.astype(complex)))
        rows = np.zeros((len(value), len(numbers)))
        for k in np.flatnonzero(np.diag(self.fit.covariance)):
            moved = numbers.astype(complex)
            moved[k] += 1j * COMPLEX_STEP
            rows[:, k] = np.imag(of(moved)) / COMPLEX_STEP
        return value, rows @ self.fit.covariance @ rows.T

    @property
    def image(self) -> ImageGeometry:
        """Distortion and lateral colour, as results keep them."""
        distortion = Distortion(
            self.k1_per_mm2, self.k2_per_mm4, self.centre_px, self.residual_px
        )
        return ImageGeometry(distortion, self.lateral_colour)

    def _places(
        self, moved: Callable[[Numbers], Numbers], count: int
    ) -> tuple[Floats, Floats]:
        """Return displacements (n, 2) and their covariances (n, 2, 2), without those between places."""
        value, covariance = self.linear(moved)
        own = covariance.reshape(count, 2, count, 2)
        each = np.arange(count)
        return value.reshape(count, 2), own[each, :, each]


def fit_geometry(
    frame: FieldFrame,
    grid: TileGrid,
    places: Sequence[TilePlace],
    lens: ThinLens,
    reference: str = "G",
) -> FieldGeometry:
    """Fit the places of tiles at all ranges and in all channels.

    k2 and a bend of the print are taken in where a flat print and k1 do not explain the
    places. Tiles that contradict the others are left out, and named.

    Parameters
    ----------
    frame : coordinates
    grid : the tiles on the target
    places : of the tiles, one for each range, channel and tile
    lens : of the distances from its entrance pupil
    reference : channel that the others are compared with; the first one where it is missing

    Raises
    ------
    ValueError : no places
    """
    if not places:
        raise ValueError("no tile was found: their places are needed")
    model = _model(frame, grid, places, lens, reference)
    plain = without_outliers(model, chosen(model, fifth=False, bend=False))
    with_fifth = fit_tiles(model, chosen(model, fifth=True, bend=False), plain.apart)
    shared = np.arange(model.shared.start, model.shared.stop)
    fifth_p = with_fifth.p_value(shared[list(FIFTH)])
    fifth = fifth_p < ADOPTED_P
    bent = fit_tiles(model, chosen(model, fifth, bend=True), plain.apart)
    bend_p = bent.p_value(shared[list(BEND)])
    if bend_p < ADOPTED_P:
        return FieldGeometry(bent, fifth_p, _bend(bent, bend_p), bend_p, bent)
    return FieldGeometry(with_fifth if fifth else plain, fifth_p, None, bend_p, bent)


def _model(
    frame: FieldFrame,
    grid: TileGrid,
    places: Sequence[TilePlace],
    lens: ThinLens,
    reference: str,
) -> TileModel:
    """Return the model of some places, the reference channel first."""
    ranges = {p.key.range_mm for p in places}
    in_order = sorted(ranges, key=lambda r: -1.0 if r is None else r)
    names = dict.fromkeys(p.key.channel for p in places)
    channels = sorted(names, key=lambda name: name != reference)
    behind = lens.focal_length_mm * (1 / lens.pupil_magnification - 1)
    distances = [np.inf if r is None else r + behind for r in in_order]
    return TileModel(
        frame,
        grid,
        tuple(places),
        tuple(in_order),
        tuple(channels),
        np.array(distances),
    )


def _shared(fit: TileFit, which: int, unit: str) -> Uncertain:
    """Return a number that all stations share."""
    at = fit.model.shared.start + which
    return Uncertain(fit.numbers[at], sqrt(fit.covariance[at, at]), unit)


def _bend(fit: TileFit, p_value: float) -> Bend:
    """Return the bend that a fit estimates."""
    model = fit.model
    at = np.arange(model.shared.start, model.shared.stop)[list(BEND)]
    curvatures = fit.numbers[at]
    covariance = fit.covariance[np.ix_(at, at)]
    middles = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]])
    rim = np.concatenate([CORNERS, middles]) * np.array(model.grid.whole_mm) / 2
    rows = np.stack([sag_mm(rim, unit) for unit in np.eye(3)], axis=1)
    sags = rows @ curvatures
    between = rows[np.argmax(sags)] - rows[np.argmin(sags)]
    std = sqrt(between @ covariance @ between)
    depth = Uncertain(float(between @ curvatures), std, "mm")
    return Bend(curvatures, covariance, depth, p_value)
