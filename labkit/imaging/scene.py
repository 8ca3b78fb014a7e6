"""A target on the torus, at a pose: rendered from geometry, band-limited, warped (thesis 2.36-2.38)."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from labkit.imaging import spline
from labkit.imaging.brightness import Brightness
from labkit.imaging.grid import Torus
from labkit.imaging.warp import Pose
from labkit.panel.drawn_target import PanelTarget
from labkit.target.target import Target
from labkit.types import Complexes64, Floats, Floats32

# Of the raster against the optics' Nyquist rate at the reference: a quintic spline errs by 3e-6 to 6e-6 RMS of white behind a
# perfect lens, a cubic by 1.5e-5 to 7e-5
SUPERSAMPLING = 2.2
# The low-pass filter's pass band ends at this share of the optics' cutoff, where they pass 4 %, and its stop band begins at
# 1.3 times that: farther out it would fold back on a torus whose Nyquist frequency is hardly more than the cutoff.
# tests/physics/test_scene.py holds the whole to the closed form
BAND_SHARE = 0.9
SAMPLES_AT_ONCE = 8_000_000  # samples of a raster that are made together, 64 MB
# Of the torus's sides: raster beyond them. A climb moves a target by less, and by more than 5 % of its size in no case that the
# reference serves
STRAY = 0.1
MARGIN_NYQUIST = 21  # Nyquist intervals of raster around the target: its filter reaches 9.06 / BAND_SHARE * 2 of them


@dataclass(frozen=True, slots=True, eq=False)
class Drawing:
    """The target at the frames' poses, before any blur.

    spectra: half planes, one for each pose, in single precision, which changes a mean by
    2e-8 of white
    """

    poses: tuple[Pose, ...]
    spectra: tuple[Complexes64, ...]


@dataclass(frozen=True, eq=False)
class Scene:
    """Draws a target on a torus.

    cutoff_per_um: incoherent cutoff of the optics, up to which the drawing must be right.
    reference: a pose near the drawn ones. brightness: relative brightness of the target's places
    in the frame; None if even. The target, or what the torus holds of a larger one, is rendered
    once, band-limited, as a raster in its own plane, and warped from there by splines. The raster depends on the reference
    only, so a drawing is a smooth function of its pose. At the conditions of thesis §3.8
    references that differ by 2 % in scale change a log-likelihood by 0.08 and a wavefront
    by 0.1 % of its standard errors; at a pose 5 % larger than the reference the change is
    0.7 %, 10 % larger 4 %.
    """

    torus: Torus
    target: Target
    cutoff_per_um: float
    reference: Pose
    brightness: Brightness | None = None
    _raster: "_Raster" = field(init=False, repr=False)

    def __post_init__(self) -> None:
        around = self.surround
        (raster,) = self._rasters(
            lambda *at: (
                self.target.sample(*at) - around if around else self.target.sample(*at),
            )
        )
        object.__setattr__(self, "_raster", raster)

    def _rasters(
        self, sampled: Callable[[Floats, Floats, float], tuple[Floats, ...]]
    ) -> "tuple[_Raster, ...]":
        return _Raster.draw(
            sampled,
            self.target.size_mm,
            self._seen_mm,
            self.reference,
            self.cutoff_per_um * self.torus.pitch_um,
        )

    @property
    def _seen_mm(self) -> Floats:
        """(2, 2) least and greatest (y, x) on the target drawn: no farther out than the torus at the reference."""
        sides = np.array(self.torus.pixels)
        low = -np.array(self.torus.margin) - STRAY * sides
        rows, columns = np.stack([low, low + (1 + 2 * STRAY) * sides], axis=1)
        at = self.reference.to_target(rows[[0, 0, 1, 1]], columns[[0, 1, 0, 1]])
        own, centre = self.reference.half_size_mm, self.reference.centre_mm
        return np.array(
            [
                [c + h * u.min(), c + h * u.max()]
                for c, h, u in zip(centre, own, at, strict=True)
            ]
        ).T

    @cached_property
    def _slopes(self) -> "tuple[_Raster, ...]":
        """Rasters of the derivatives by the aperture of a panel's stripes."""
        return (
            self._rasters(self.target.slopes)
            if isinstance(self.target, PanelTarget)
            else ()
        )

    @property
    def surround(self) -> float:
        """Radiance around the target; 0 if unknown, its pixels to be masked."""
        return self.target.surround or 0.0

    def image(self, pose: Pose) -> Floats32:
        """Return the fine image (torus.fine) of the radiance above the surround's.

        pose: in the pixels of the frame
        """
        return self._seen(self._raster, pose)

    def _seen(self, raster: "_Raster", pose: Pose) -> Floats32:
        """Return the fine image of a raster at a pose."""
        many, (top, left) = self.torus.oversampling, self.torus.margin
        onto_torus = pose.shifted(-top, -left)
        corners = onto_torus.to_pixels(*raster.outline)
        low = np.floor(corners.min(axis=0) * many).astype(int)
        high = np.ceil(corners.max(axis=0) * many).astype(int) + 1
        low, high = np.clip(low, 0, self.torus.fine), np.clip(high, 0, self.torus.fine)
        image = np.zeros(self.torus.fine, np.float32)
        if np.all(high > low):
            to_torus = np.array(
                [[1 / many, 0, low[0] / many], [0, 1 / many, low[1] / many], [0, 0, 1]]
            )
            window = tuple(slice(*ends) for ends in zip(low, high, strict=True))
            image[window] = raster.at(
                np.linalg.inv(onto_torus.matrix) @ to_torus,
                image[window].shape,
                pose.bend,
            )
            if self.brightness is not None:
                rows, columns = (
                    np.arange(*ends) / many - margin
                    for ends, margin in zip(
                        zip(low, high, strict=True), (top, left), strict=True
                    )
                )
                image[window] *= self.brightness.at(rows, columns)
        return image

    def draw(self, poses: Sequence[Pose]) -> Drawing:
        """Return the half planes of the DFT of `image` at each pose."""
        return Drawing(
            tuple(poses), tuple(self._drawn(self._raster, pose) for pose in poses)
        )

    def slopes(self, poses: Sequence[Pose]) -> list[tuple[Complexes64, ...]]:
        """Return the half planes of the derivatives of `image` by the aperture of a panel's stripes at each
        pose.

        Other targets have none.
        """
        return [
            tuple(self._drawn(raster, pose) for raster in self._slopes) for pose in poses
        ]

    def _drawn(self, raster: "_Raster", pose: Pose) -> Complexes64:
        return self.torus.half_spectrum(self._seen(raster, pose))


@dataclass(frozen=True, eq=False)
class _Raster:
    """Spline coefficients of the band-limited target in its own plane.

    A large target at a small f-number takes hundreds of megabytes in single precision.
    Rounding errs by 1e-7 of white, a thirtieth of the spline's own error, and is the same
    at every pose.
    """

    coefficients: Floats32
    first: Floats  # (y, x) of the first sample, in the coordinates of poses
    step: Floats  # between samples

    @classmethod
    def draw(
        cls,
        sampled: Callable[[Floats, Floats, float], tuple[Floats, ...]],
        size_mm: tuple[float, float],
        seen_mm: Floats,
        reference: Pose,
        cutoff_per_px: float,
    ) -> "tuple[_Raster, ...]":
        """Return rasters of functions sampled like a target of a size, at the reference's scale.

        seen_mm: (2, 2) least and greatest (y, x) needed
        """
        own_mm, centre_mm = np.array(reference.half_size_mm), np.array(reference.centre_mm)
        pixel_per_mm = float(np.max(reference.pixel_per_unit() / own_mm))
        cutoff_per_mm = cutoff_per_px * pixel_per_mm
        step_mm = 1 / (2 * cutoff_per_mm * SUPERSAMPLING)
        around = MARGIN_NYQUIST * SUPERSAMPLING
        most = np.ceil(np.array(size_mm) / 2 / step_mm + around).astype(int)
        seen = np.round(seen_mm / step_mm + [[-around], [around]]).astype(int)
        low = np.clip(seen[0], -most, most - math.ceil(2 * around))
        high = np.clip(seen[1], low + math.ceil(2 * around), most)
        y_mm, x_mm = (np.arange(a, b + 1) * step_mm for a, b in zip(low, high, strict=True))
        rasters = list[Floats32]()
        for first in range(0, len(y_mm), many := max(1, SAMPLES_AT_ONCE // len(x_mm))):
            rows = slice(first, first + many)
            parts = sampled(y_mm[rows], x_mm, BAND_SHARE * cutoff_per_mm)
            rasters = rasters or [
                np.empty((len(y_mm), len(x_mm)), np.float32) for _ in parts
            ]
            for raster, part in zip(rasters, parts, strict=True):
                raster[rows] = spline.along_rows(part)
        for raster in rasters:
            spline.filter_columns(raster)
        first = (low * step_mm - centre_mm) / own_mm
        return tuple(cls(raster, first, step_mm / own_mm) for raster in rasters)

    @property
    def outline(self) -> tuple[Floats, Floats]:
        """Unit coordinates (y, x) of the raster's corners."""
        top, left = self.first
        bottom, right = self.first + self.step * (np.array(self.coefficients.shape) - 1)
        return np.array([top, top, bottom, bottom]), np.array([left, right, right, left])

    def at(
        self, to_target: Floats, shape: tuple[int, int], bend: Floats | None = None
    ) -> Floats32:
        """Return values on a grid whose (i, j, 1) a homography (3, 3) maps to unit coordinates (y, x, 1), from which
        a bend is subtracted; 0 outside.
        """
        (y, x), (down, across) = -self.first / self.step, 1 / self.step
        return spline.read(
            self.coefficients,
            np.array([[down, 0, y], [0, across, x], [0, 0, 1]]) @ to_target,
            shape,
            None if bend is None else self._in_samples(bend),
        )

    def _in_samples(self, bend: Floats) -> Floats:
        """Return polynomials in unit coordinates as polynomials in the raster's samples, both ways."""
        powers = range(bend.shape[1])
        # (first + step k)^i by powers of k
        down, across = (
            np.array(
                [
                    [math.comb(i, k) * first ** max(i - k, 0) * step**k for i in powers]
                    for k in powers
                ]
            )
            for first, step in zip(self.first, self.step, strict=True)
        )
        return np.asarray(down @ bend @ across.T / self.step[:, None, None])
