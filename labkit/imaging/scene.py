"""A target on the torus, seen from a pose: rendered from geometry, band-limited, warped (thesis 2.36-2.38)."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import scipy.ndimage

from labkit.imaging.grid import Torus
from labkit.imaging.warp import Pose
from labkit.target import Target
from labkit.types import Complexes, Floats

SUPERSAMPLING = 2.0  # of the raster against the optics' Nyquist rate
SPLINE: Literal[5] = (
    5  # order: errs by 1.5e-5 RMS of white behind a perfect lens, a cubic by 1.3e-4 (tests/physics/test_scene.py)
)
MARGIN_NYQUIST = 20  # Nyquist intervals of raster around the target, for the skirts of its low-pass filter


@dataclass
class Scene:
    """Draws a target on a torus.

    cutoff_per_um: incoherent cutoff of the optics, the frequency up to which the drawing must be right.
    The target is rendered once, band-limited, as a raster in its own plane, and warped from there by splines; the
    raster is rendered anew when the scale changes by more than 2 %.
    """

    torus: Torus
    target: Target
    cutoff_per_um: float
    _raster: "_Raster | None" = field(default=None, repr=False)
    _drawn: dict[bytes, Complexes] = field(default_factory=dict, repr=False)

    @property
    def surround(self) -> float:
        """Radiance around the target; an unknown one counts as 0, its pixels are to be masked."""
        return self.target.surround or 0.0

    def image(self, pose: Pose) -> Floats:
        """Fine image (torus.fine) of the radiance above the surround's. pose: in the pixels of the frame."""
        raster = self._raster_for(pose)
        many, (top, left) = self.torus.oversampling, self.torus.margin
        onto_torus = pose.shifted(-top, -left)
        corners = onto_torus.to_pixels(*raster.outline)
        low = np.floor(corners.min(axis=0) * many).astype(int)
        high = np.ceil(corners.max(axis=0) * many).astype(int) + 1
        low, high = np.clip(low, 0, self.torus.fine), np.clip(high, 0, self.torus.fine)
        image = np.zeros(self.torus.fine)
        if np.all(high > low):
            rows = np.arange(low[0], high[0])[:, None] / many
            columns = np.arange(low[1], high[1])[None, :] / many
            image[low[0] : high[0], low[1] : high[1]] = raster.at(*onto_torus.to_target(rows, columns))
        return image

    def spectra(self, poses: Sequence[Pose]) -> list[Complexes]:
        """Half planes of the DFT of `image` at each pose. Those of the last call are kept: a climb asks for each twice."""
        keys = [pose.v.tobytes() for pose in poses]
        self._drawn = {key: self._drawn[key] for key in keys if key in self._drawn}
        for key, pose in zip(keys, poses, strict=True):
            if key not in self._drawn:
                self._drawn[key] = self.torus.half_spectrum(self.image(pose))
        return [self._drawn[key] for key in keys]

    def _raster_for(self, pose: Pose) -> "_Raster":
        scale = np.array(pose.pixel_per_unit())
        if self._raster is None or np.any(np.abs(scale / self._raster.pixel_per_unit - 1) > 0.02):
            self._raster = _Raster.draw(self.target, scale, self.cutoff_per_um * self.torus.pitch_um)
        return self._raster


@dataclass(frozen=True)
class _Raster:
    """Spline coefficients of the band-limited target in its own plane."""

    coefficients: Floats
    pixel_per_unit: Floats
    first: Floats  # unit coordinate of the first sample along y and x
    step: Floats  # between samples

    @classmethod
    def draw(cls, target: Target, pixel_per_unit: Floats, cutoff_per_px: float) -> "_Raster":
        half_mm = np.array(target.size_mm) / 2
        pixel_per_mm = float(np.max(pixel_per_unit / half_mm))
        bandwidth_per_mm = (
            1.03 * cutoff_per_px * pixel_per_mm
        )  # the margin covers perspective and later changes of scale
        step_mm = 1 / (2 * bandwidth_per_mm * SUPERSAMPLING)
        counts = np.ceil(half_mm / step_mm + MARGIN_NYQUIST * SUPERSAMPLING).astype(int)
        y_mm, x_mm = (np.arange(-n, n + 1) * step_mm for n in counts)
        values = target.sample(y_mm, x_mm, bandwidth_per_mm) - (target.surround or 0.0)
        return cls(
            scipy.ndimage.spline_filter(values, order=SPLINE, mode="mirror"),
            pixel_per_unit,
            -counts * step_mm / half_mm,
            step_mm / half_mm,
        )

    @property
    def outline(self) -> tuple[Floats, Floats]:
        """Unit coordinates (y, x) of the raster's corners."""
        y, x = -self.first
        return np.array([-y, -y, y, y]), np.array([-x, x, x, -x])

    def at(self, y: Floats, x: Floats) -> Floats:
        """Values at unit coordinates; 0 outside."""
        where = np.stack([(y - self.first[0]) / self.step[0], (x - self.first[1]) / self.step[1]])
        return np.asarray(
            scipy.ndimage.map_coordinates(
                self.coefficients, where, order=SPLINE, mode="constant", cval=0.0, prefilter=False
            )
        )
