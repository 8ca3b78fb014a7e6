"""Simulate images of general scenes, without the model that restores them: squares, transformed exactly.

The scene is a periodic array of squares; its Fourier transform is the array's times a
square's. The lens's transfer function is the autocorrelation of a finely sampled pupil.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.fft

from labkit.experiments.camera import Camera
from labkit.types import Complexes, Floats


@dataclass(frozen=True, eq=False)
class PictureCamera:
    """A camera in front of a periodic scene of squares.

    scene: (n, n) radiance of squares, `squares` of them to a pixel along a side. camera: n
    = squares times its pixels. waves: (modes,) RMS at the camera's wavelength. The centre
    of square (0, 0) is that of the torus's pixel (0, 0).
    """

    scene: Floats
    squares: int
    camera: Camera
    waves: Floats
    noll: tuple[int, ...]

    def __post_init__(self) -> None:
        side = self.squares * self.camera.pixels
        if self.scene.shape != (side, side):
            raise ValueError(
                f"a scene of {self.scene.shape} squares; {(side, side)} fill the camera's torus"
            )

    def mean(self, shift_px: tuple[float, float] = (0.0, 0.0)) -> Floats:
        """Return (frame, frame) mean radiance in every pixel, the scene moved down and right."""
        camera = self.camera
        rows, columns = self._frequencies
        moved = np.exp(-2j * np.pi * (rows * shift_px[0] + columns * shift_px[1]))
        image = scipy.fft.irfft2(
            self._blurred * moved, s=2 * (camera.pixels * camera.oversampling,)
        )
        first = (camera.pixels - camera.frame) // 2 * camera.oversampling
        last = first + camera.frame * camera.oversampling
        return np.asarray(
            image[first : last : camera.oversampling, first : last : camera.oversampling]
        )

    def truth(self, samples: int) -> Floats:
        """Return (samples frame, samples frame) mean radiance over squares about samples, the first in the
        first pixel's centre.
        """
        count = self.camera.pixels * samples
        edges = (
            (np.arange(count + 1) - 0.5) / samples * self.squares + 0.5
        )  # in squares of the scene, from the first one's edge
        low, high = edges[:-1, None], edges[1:, None]
        share = np.zeros((count, len(self.scene)))
        for turn in (-len(self.scene), 0, len(self.scene)):  # it repeats itself
            at = np.arange(len(self.scene))[None, :] + turn
            share += np.clip(np.minimum(high, at + 1) - np.maximum(low, at), 0, None)
        share *= samples / self.squares
        first = (self.camera.pixels - self.camera.frame) // 2 * samples
        shown = share[first : first + self.camera.frame * samples]
        return np.asarray(shown @ self.scene @ shown.T)

    @cached_property
    def _frequencies(self) -> tuple[Floats, Floats]:
        """Cycles a pixel."""
        fine = self.camera.pixels * self.camera.oversampling
        step = 1 / self.camera.oversampling
        return scipy.fft.fftfreq(fine, step)[:, None], scipy.fft.rfftfreq(fine, step)[
            None, :
        ]

    @cached_property
    def _blurred(self) -> Complexes:
        """Transform of the scene behind lens and pixel."""
        rows, columns = self._frequencies
        at = [
            np.rint(axis * self.camera.pixels).astype(int) % len(self.scene)
            for axis in (rows, columns)
        ]
        square = np.sinc(rows / self.squares) * np.sinc(columns / self.squares)
        finer = self.camera.pixels * self.camera.oversampling / len(self.scene)
        scene = scipy.fft.fft2(self.scene)[at[0], at[1]] * square * finer**2
        pixel = np.sinc(rows) * np.sinc(columns)
        return np.asarray(scene * pixel * self.camera.transfer(self.waves, self.noll))
