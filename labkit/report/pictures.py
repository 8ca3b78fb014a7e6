"""Figures made of pixels, and plates of figures: wavefront maps, PSFs, the target in the frame, data and model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from math import ceil
from re import sub
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Circle
from numpy.typing import NDArray
from PIL import Image

from labkit.figure_style import HALF_IN, INK, THIRD_IN, Ink, png, round_length, scaling, svg
from labkit.optics.lens import blur_per_wave_um
from labkit.optics.metrics import opd_map, psf_value
from labkit.optics.wavefront import FittedWavefront
from labkit.report.photographs import Photographs
from labkit.report.table import millimetres
from labkit.results import Residuals, Results, Wavefront
from labkit.types import Floats

MOST_COLOURS = 256


@dataclass(frozen=True, slots=True)
class Panel:
    """An encoded figure.

    name: of its file, without the extension; kind: of its text in templates/figures.html.j2;
    of: the subject of this text; pixels: whether samples are shown as squares
    """

    name: str
    kind: str
    content: bytes
    media_type: str = "image/png"
    of: Any = None
    pixels: bool = False

    @property
    def file(self) -> str:
        """Name of the file."""
        stem = sub(r"[^A-Za-z0-9.+_-]", "-", self.name)
        return f"{stem}.{'svg' if 'svg' in self.media_type else 'png'}"


@dataclass(frozen=True, slots=True)
class Plate:
    """Panels with a common caption.

    kind: of the caption in templates/figures.html.j2; across: number of panels side by side
    on a wide page; width_um: width of each panel on the sensor
    """

    kind: str
    panels: Sequence[Panel]
    across: int = 2
    width_um: float = 0.0


def drawing(kind: str, figure: Figure, of: Any = None, key: str = "") -> Panel:
    """Return a figure made of lines. key: follows the kind in the file's name."""
    return Panel(_name(kind, key), kind, svg(figure), "image/svg+xml", of)


def picture(kind: str, figure: Figure, of: Any = None, key: str = "") -> Panel:
    """Return a figure made of pixels, in 256 colours: a quarter of the bytes, and no visible difference."""
    image = Image.open(BytesIO(png(figure))).convert("RGB")
    buffer = BytesIO()
    image.quantize(MOST_COLOURS, dither=Image.Dither.NONE).save(buffer, "PNG")
    return Panel(_name(kind, key), kind, buffer.getvalue(), of=of)


def chip(fit: Wavefront, residuals: Residuals) -> Panel:
    """Return data, model and residual of a fit, pixel by pixel."""
    content, low, high = chip_image(residuals)
    with np.errstate(invalid="ignore"):
        rms = np.sqrt(np.nanmean(residuals.normalised**2, axis=(2, 3)))
    of = {"fit": fit, "shape": residuals.data.shape, "low": low, "high": high, "rms": rms}
    return Panel(_name("fit", fit.key), "fit", content, of=of, pixels=True)


def _name(kind: str, key: object) -> str:
    return f"{kind}_{key}" if key else kind


RESIDUAL_LIMIT = 4.0  # standard deviations
MAP_SAMPLES = 161  # across the pupil
LEAST_PER_AIRY, MOST_PER_AIRY = (
    3.0,
    16.0,
)  # samples to lambda N: Nyquist has two, and more show no pixels
HALF_SAMPLES = 100
MOST_HALF_WIDTH_AIRY = 32.0  # lambda N: 0.6 % of the light lies beyond
FOCUSED_HALF_WIDTH_AIRY = 6.0
MASKED = (
    143,
    206,
    170,
)  # a pixel left out: neither a grey nor a colour of the residual's scale
GREYS, GREY_SHADES, GAP = 128, 127, 3  # of a chip's palette; pixels between its parts
LIMIT_MARGIN = 0.01  # waves: of a scale, where a wavefront is flat


def map_limit(wavefronts: Sequence[FittedWavefront]) -> float:
    """Return the limit of a colour scale symmetric about zero: the greatest path difference of all, waves."""
    return (
        max(
            (float(np.nanmax(np.abs(opd_map(w, 41).value))) for w in wavefronts),
            default=0.0,
        )
        or LIMIT_MARGIN
    )


def opd_picture(
    wavefronts: dict[str, FittedWavefront],
    limit: float,
    reference_nm: float,
    title: str = "",
) -> Figure:
    """Path difference over the pupil of channels side by side, one colour scale, in waves and nanometres."""
    figure, sides, height = _side_by_side(
        len(wavefronts), 0.47, 0.85 if title else 0.7, title
    )
    for axes, (channel, w) in zip(sides, wavefronts.items(), strict=True):
        axes.set_axis_off()
        path = opd_map(w, MAP_SAMPLES).value
        image = axes.imshow(
            path, cmap="RdBu_r", vmin=-limit, vmax=limit, interpolation="nearest"
        )
        axes.text(
            0.02, 0.98, channel, fontweight="bold", va="top", transform=axes.transAxes
        )
    _colour_bar(figure, image, height, reference_nm)
    return figure


def _side_by_side(
    count: int, below_in: float, more_in: float, title: str
) -> tuple[Figure, list[Axes], float]:
    """Return a figure, square axes in a row, and its height. below_in, more_in: room below them, and in all."""
    side = (THIRD_IN - 0.1) / count
    height = side + more_in
    figure = Figure(figsize=(THIRD_IN, height))
    if title:
        figure.text(
            0.02, 1 - 0.13 / height, title, fontweight="bold", fontsize=9, va="center"
        )
    width = 0.96 * side / THIRD_IN
    axes = [
        figure.add_axes(
            ((0.05 + k * side) / THIRD_IN, below_in / height, width, side / height)
        )
        for k in range(count)
    ]
    return figure, axes, height


def _colour_bar(
    figure: Figure, image: AxesImage, height: float, reference_nm: float
) -> None:
    """Draw a colour bar below the maps, with waves below and nanometres above."""
    bar = figure.colorbar(
        image,
        cax=figure.add_axes((0.2, 0.24 / height, 0.6, 0.07 / height)),
        orientation="horizontal",
    )
    bar.ax.tick_params(labelsize=7, pad=1)
    nanometres = bar.ax.secondary_xaxis("top", functions=scaling(reference_nm))
    nanometres.tick_params(labelsize=7, pad=1)
    bar.ax.text(1.07, -0.2, "waves", va="top", fontsize=7, transform=bar.ax.transAxes)
    bar.ax.text(1.07, 1.2, "nm", va="bottom", fontsize=7, transform=bar.ax.transAxes)
    bar.ax.grid(False)


def psf_half_width_um(wavefronts: Sequence[Wavefront]) -> float:
    """Return half the side of a square with room for every PSF: geometric blur and rings."""
    widths = []
    for w in wavefronts:
        airy_um = w.wavelength_nm * 1e-3 * w.f_number
        waves = 0.0 if w.defocus is None else abs(w.defocus.value)
        radius_um = (
            waves * blur_per_wave_um(w.f_number, w.reference_wavelength_nm * 1e-3) / 2
        )
        widths.append(min(1.25 * radius_um + 6 * airy_um, MOST_HALF_WIDTH_AIRY * airy_um))
    return max(widths)


def psf_picture(
    wavefronts: dict[str, FittedWavefront],
    half_width_um: float,
    inks: dict[str, Ink],
    title: str,
) -> Figure:
    """PSFs of channels side by side, all of one extent; each stretched to its own peak; the first has a scale."""
    figure, sides, _ = _side_by_side(len(wavefronts), 0.05, 0.31, title)
    for axes, (channel, w) in zip(sides, wavefronts.items(), strict=True):
        axes.set(xticks=[], yticks=[])
        axes.grid(False)
        for spine in axes.spines.values():
            spine.set(visible=True, color="#c4c8cc")
        _psf(axes, w, half_width_um, inks[channel])
        if len(sides) > 1:
            axes.text(
                0.03, 0.97, channel, fontweight="bold", va="top", transform=axes.transAxes
            )
    _scale_bar(sides[0], half_width_um)
    return figure


def _psf(axes: Axes, w: FittedWavefront, half_width_um: float, ink: Ink) -> None:
    airy_um = w.wavelength_um * w.f_number
    # of a wide picture each sample is less than a pixel of the screen at Nyquist's spacing
    spacing_um = float(
        np.clip(
            half_width_um / HALF_SAMPLES, airy_um / MOST_PER_AIRY, airy_um / LEAST_PER_AIRY
        )
    )
    psf = psf_value(w, spacing_um, 2 * ceil(half_width_um / spacing_um) + 1)
    edge = psf.shape[0] / 2 * spacing_um
    axes.imshow(
        psf,
        cmap=ink.ramp,
        norm=PowerNorm(0.5, 0, psf.max(), clip=True),
        interpolation="nearest",
        extent=(-edge, edge, edge, -edge),
    )
    axes.add_patch(
        Circle((0, 0), 1.2197 * airy_um, fill=False, ec=INK, lw=0.5, ls=(0, (3, 2)))
    )
    axes.set(xlim=(-half_width_um, half_width_um), ylim=(half_width_um, -half_width_um))


def _scale_bar(axes: Axes, half_width_um: float) -> None:
    length = round_length(0.7 * half_width_um)
    left, y = -0.92 * half_width_um, 0.88 * half_width_um
    axes.plot([left, left + length], [y, y], color=INK, lw=2, solid_capstyle="butt")
    axes.text(left, y - 0.05 * half_width_um, f"{length:g} µm", fontsize=8, va="bottom")


def place_picture(results: Results, photographs: Photographs) -> Figure | None:
    """The frame with the photograph nearest to focus, and the target's outline at each range; None without any."""
    placed = [(w.range_mm, w.placement) for w in results if w.placement is not None]
    if not placed:
        return None
    rows, cols = photographs.size_px or np.max(
        [np.add(p.origin_px, p.shape_px) for _, p in placed], axis=0
    )
    height = float(np.clip((HALF_IN - 0.2) * rows / cols, 1.5, 3.4))
    figure = Figure(figsize=(HALF_IN, height + 0.2))
    axes = figure.add_axes(
        (0.1 / HALF_IN, 0.1 / (height + 0.2), 1 - 0.2 / HALF_IN, height / (height + 0.2))
    )
    axes.set(xticks=[], yticks=[], aspect="equal", anchor="W")
    axes.grid(False)
    for spine in axes.spines.values():
        spine.set(visible=True)
    show_frame(axes, (rows, cols), photographs, -0.25, 1.25)
    axes.plot([(cols - 1) / 2], [(rows - 1) / 2], "+", color="#e69f00", ms=9, mew=1)
    ranges = sorted({r for r, _ in placed if r is not None})
    for range_mm, placement in reversed(placed):
        shade = (
            ranges.index(range_mm) / max(len(ranges) - 1, 1)
            if range_mm is not None
            else 0.0
        )
        outline = placement.corners_px[0][[0, 1, 2, 3, 0]]
        colour = colormaps["viridis"](0.35 + 0.6 * shade)
        axes.plot(
            outline[:, 1], outline[:, 0], color=colour, lw=1.1, label=millimetres(range_mm)
        )
    return figure


def show_frame(
    axes: Axes,
    shape_px: tuple[int, int],
    photographs: Photographs,
    black: float,
    white: float,
) -> None:
    """Set the limits of axes to a frame's pixels, and show its photograph where one is at hand.

    black, white: the shares of white drawn black and white
    """
    rows, columns = shape_px
    axes.set(xlim=(-0.5, columns - 0.5), ylim=(rows - 0.5, -0.5))
    if photographs.preview is None:
        return
    shown, block = photographs.preview, photographs.preview_px
    edges = (-0.5, shown.shape[1] * block - 0.5, shown.shape[0] * block - 0.5, -0.5)
    axes.imshow(shown, cmap="gray", vmin=black, vmax=white, extent=edges)


def chip_image(
    residuals: Residuals, frame: int = 0, plane: int = 0
) -> tuple[bytes, float, float]:
    """Return raw chip, model and normalised residual side by side as a PNG, and the black and white levels.

    A palette of greys for counts and of red and blue for the residual, from -4 to +4 standard deviations.
    """
    data, model = residuals.data[frame, plane], residuals.model[frame, plane]
    finite = np.concatenate([data[np.isfinite(data)], model[np.isfinite(model)]])
    low, high = np.quantile(finite, [0.001, 0.999]) if finite.size else (0.0, 1.0)
    rest = (residuals.normalised[frame, plane] / RESIDUAL_LIMIT + 1) / 2
    grey = [_indices((x - low) / max(high - low, 1e-9), GREYS, 0) for x in (data, model)]
    gap = np.full((data.shape[0], GAP), GREYS - 1, np.uint8)
    joined = np.hstack([grey[0], gap, grey[1], gap, _indices(rest, GREY_SHADES, GREYS)])
    return _palette_png(joined), float(low), float(high)


def _indices(share: Floats, count: int, first: int) -> NDArray[np.uint8]:
    """Return entries of the palette for shares 0..1; masked pixels are the last entry."""
    entries = first + np.round(np.clip(np.nan_to_num(share), 0, 1) * (count - 1))
    return np.where(np.isfinite(share), entries, GREYS + GREY_SHADES).astype(np.uint8)


def _palette_png(indices: NDArray[np.uint8]) -> bytes:
    greys = np.repeat(np.linspace(0, 255, GREYS), 3).reshape(-1, 3)
    shades = 255 * colormaps["RdBu_r"](np.linspace(0, 1, GREY_SHADES))[:, :3]
    palette = np.vstack([greys, shades, [MASKED]]).round().astype(np.uint8)
    image = Image.fromarray(indices, mode="P")
    image.putpalette(palette.ravel().tolist())
    buffer = BytesIO()
    image.save(buffer, "PNG", optimize=False, compress_level=9)
    return buffer.getvalue()
