"""Draws the figures of the pages on the method: python -m docs.generators.figures"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.signal import fftconvolve

from labkit.figure_style import SOFT_INK, png, styled
from labkit.optics.lens import ThinLens, defocus_waves
from labkit.optics.metrics import opd_map, psf_value
from labkit.optics.wavefront import FittedWavefront
from labkit.target.target import open_target
from labkit.types import Floats

FOLDER = Path(__file__).parents[1] / "method" / "figures"
PITCH_UM, FINER, SIDE_PX = 4.78, 8, 72
"""Pixel pitch; samples of the light to a pixel; pixels along a side of what is drawn."""

SIZE_MM, PER_MM = 13.1, 70 / (3000 - 70)
"""Of the target, and of its picture for each millimetre of it: 70 mm, 3 m."""


def wavefront() -> FittedWavefront:
    """A quarter of a wave of astigmatism, coma and spherical aberration, slightly defocused."""
    noll = (4, 5, 6, 7, 8, 11)
    waves = np.array([0.14, 0.08, -0.1, 0.09, 0.08, 0.1])
    waves *= 0.25 / np.linalg.norm(waves)
    return FittedWavefront(noll, waves, np.zeros((6, 6)), 550.0, 450.0, 2.87)


def chain() -> Figure:
    """Target, wavefront, PSF, light, counts."""
    spacing_um = PITCH_UM / FINER
    at_mm = (
        (np.arange(SIDE_PX * FINER) - SIDE_PX * FINER / 2 + 0.5)
        * spacing_um
        * 1e-3
        / PER_MM
    )
    target = open_target(f"sierpinski:order=4,size_mm={SIZE_MM}")
    scene = target.sample(at_mm, at_mm, 0.4 / (at_mm[1] - at_mm[0]))
    psf = psf_value(wavefront(), spacing_um, 161)
    light = fftconvolve(scene, psf, mode="same")
    pixels = light.reshape(SIDE_PX, FINER, SIDE_PX, FINER).mean(axis=(1, 3))[::2, ::2]
    counts = np.random.default_rng(1).poisson(np.clip(pixels, 0, None) * 4000 + 40)
    figure = Figure(figsize=(9.0, 2.2), layout="constrained")
    pictures: list[tuple[str, Floats, str]] = [
        ("target", target.radiance(at_mm[:, None], at_mm), "gray"),
        ("wavefront", opd_map(wavefront(), 128).value, "RdBu_r"),
        ("point-spread function", np.sqrt(np.clip(psf[50:111, 50:111], 0, None)), "gray"),
        ("light on the sensor", light, "gray"),
        ("counts, one colour", counts.astype(float), "gray"),
    ]
    for axes, (title, picture, colours) in zip(
        figure.subplots(1, 5), pictures, strict=True
    ):
        axes.imshow(picture, cmap=colours, interpolation="nearest")
        axes.set_title(title)
        axes.set_axis_off()
    return figure


def defocus_against_range() -> Figure:
    """Three ranges of one lens, and the twins of their fits."""
    lens, focus_mm = ThinLens(70.0, 2.8, 0.985), 3060.0
    ranges, at = np.array([3000.0, 3200.0, 3300.0]), np.linspace(2950, 3350, 300)
    waves = np.asarray(defocus_waves(lens, ranges, focus_mm, 450.0))
    figure = Figure(figsize=(6.5, 2.8), layout="constrained")
    axes = figure.subplots()
    axes.plot(at, defocus_waves(lens, at, focus_mm, 450.0), color=SOFT_INK)
    axes.axhline(0, color=SOFT_INK, linewidth=0.6)
    axes.plot(ranges, waves, "o", color="#1f5fa8", label="as measured, signs by the law")
    axes.plot(
        ranges, -waves, "o", color="#1f5fa8", markerfacecolor="white", label="their twins"
    )
    axes.axvline(focus_mm, color=SOFT_INK, linestyle=":")
    axes.annotate("best focus", (focus_mm, -1.2), xytext=(6, 0), textcoords="offset points")
    axes.set_xlabel("range / mm")
    axes.set_ylabel("defocus / waves RMS")
    axes.legend(loc="upper left")
    return figure


def main() -> None:
    """Write both."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    with styled():
        for name, figure in (("chain", chain()), ("range", defocus_against_range())):
            (FOLDER / f"{name}.png").write_bytes(png(figure))


if __name__ == "__main__":
    main()
