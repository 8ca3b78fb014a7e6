"""Pictures of a fit: the chip beside its model and residual, and the point-spread functions side by side."""

from collections.abc import Sequence
from math import ceil, floor, log10

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Colormap, PowerNorm
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Circle

from labkit.report.quantities import millimetres
from labkit.report.style import DPI, INK, SOFT, WIDTH_IN, channel_inks
from labkit.results import Residuals, Results, Wavefront
from labkit.types import Floats

RESIDUAL_LIMIT = 4.0  # standard deviations
SAMPLES_PER_AIRY = 6.0  # of lambda N: three times Nyquist, so that pixels do not show
MOST_HALF_WIDTH_AIRY = 32.0  # lambda N: 0.6 % of the light lies beyond
LABEL = {"facecolor": "white", "alpha": 0.75, "linewidth": 0, "pad": 1.5}
MASKED = "#8fceaa"  # a pixel left out: neither a grey nor a colour of the residual's scale


def fit_picture(residuals: Residuals, frame: int = 0, plane: int = 0) -> Figure:
    """Raw chip, model on the same scale, and normalised residual, of one plane of one frame."""
    data, model = residuals.data[frame, plane], residuals.model[frame, plane]
    rows, cols = data.shape
    height = float(np.clip(WIDTH_IN * 0.29 * rows / cols, 1.2, 5.0)) + 0.3
    figure = Figure(figsize=(WIDTH_IN, height), layout="constrained")
    raw, fitted, rest = figure.subplots(1, 3)
    finite = np.concatenate([data[np.isfinite(data)], model[np.isfinite(model)]])
    low, high = np.quantile(finite, [0.001, 0.999]) if finite.size else (0.0, 1.0)
    _chip(raw, data, "raw, counts", "gray", low, high)
    image = _chip(fitted, model, "model, same scale", "gray", low, high)
    figure.colorbar(image, cax=fitted.inset_axes((1.03, 0, 0.04, 1)))
    normalised = residuals.normalised[frame, plane]
    image = _chip(rest, normalised, "(raw − model) / σ", "RdBu_r", -RESIDUAL_LIMIT, RESIDUAL_LIMIT)
    figure.colorbar(image, cax=rest.inset_axes((1.03, 0, 0.04, 1)), ticks=[-4, -2, 0, 2, 4])
    return figure


def _chip(axes: Axes, image: Floats, title: str, colours: str, low: float, high: float) -> AxesImage:
    axes.set_title(title, fontweight="normal")
    axes.set(xticks=[], yticks=[])
    axes.grid(False)
    axes.set_facecolor(MASKED)
    for spine in axes.spines.values():
        spine.set_visible(True)
    # nearest shows each pixel as it is; an image finer than the figure has to be averaged
    finer = max(image.shape) > WIDTH_IN * 0.29 * DPI
    return axes.imshow(image, cmap=colours, vmin=low, vmax=high, interpolation="auto" if finer else "nearest")


def psf_half_width_um(results: Results) -> float:
    """Half the side of a square that shows every PSF: nine tenths of the widest one's energy, with context around it."""
    widths = [max(1.3 * _encircled_um(w, 0.9), 4 * airy_radius_um(w)) for w in results]
    return float(min(max(widths), MOST_HALF_WIDTH_AIRY * max(w.wavelength_nm * 1e-3 * w.f_number for w in results)))


def airy_radius_um(wavefront: Wavefront) -> float:
    """Radius of the first dark ring of a perfect lens; the first zero of J1 over pi, times wavelength and f-number."""
    return 1.2197 * wavefront.wavelength_nm * 1e-3 * wavefront.f_number


def _encircled_um(wavefront: Wavefront, share: float) -> float:
    """Radius about the centre that holds a share of the light in the PSF's window; to a sample, to choose a scale by."""
    spacing_um = wavefront.wavelength_nm * 1e-3 * wavefront.f_number / 3
    psf = wavefront.psf(spacing_um)
    at = np.arange(psf.shape[0]) - psf.shape[0] // 2
    radius = np.hypot(at[:, None], at[None, :]).ravel()
    order = np.argsort(radius)
    return float(radius[order][np.searchsorted(np.cumsum(psf.ravel()[order]), share)] * spacing_um)


def psf_picture(results: Results, ranges_mm: Sequence[float | None], half_width_um: float) -> Figure:
    """PSFs on one grid, rows channels and columns ranges, all of one extent; each stretched to its own peak."""
    channels, inks = results.channels, channel_inks(results.channels)
    side = min(WIDTH_IN / max(len(ranges_mm), 4), 2.2)
    figure = Figure(figsize=(side * len(ranges_mm) + 0.3, side * len(channels) + 0.3), layout="constrained")
    grid = figure.subplots(len(channels), len(ranges_mm), squeeze=False)
    by_place = {(w.channel, w.range_mm): w for w in results}
    for i, channel in enumerate(channels):
        for k, range_mm in enumerate(ranges_mm):
            axes, wavefront = grid[i, k], by_place.get((channel, range_mm))
            axes.set(xticks=[], yticks=[])
            axes.grid(False)
            for spine in axes.spines.values():
                spine.set(visible=True, color="#c4c8cc")
            if i == 0:
                axes.set_title(millimetres(range_mm))
            if k == 0:
                axes.set_ylabel(channel, rotation=0, ha="right", va="center", fontweight="bold", fontsize=10)
            if wavefront is None:
                axes.text(0.5, 0.5, "not fitted", color=SOFT, ha="center", va="center", transform=axes.transAxes)
                continue
            _psf(axes, wavefront, half_width_um, inks[channel].ramp)
            axes.add_patch(Circle((0, 0), airy_radius_um(wavefront), fill=False, ec=INK, lw=0.5, ls=(0, (3, 2))))
            axes.text(
                0.97,
                0.03,
                f"{wavefront.strehl.value:.2g}",
                ha="right",
                va="bottom",
                fontsize=8,
                transform=axes.transAxes,
                bbox=LABEL,
            )
    _scale_bar(grid[0, 0], half_width_um)
    return figure


def _psf(axes: Axes, wavefront: Wavefront, half_width_um: float, colours: Colormap) -> None:
    spacing_um = wavefront.wavelength_nm * 1e-3 * wavefront.f_number / SAMPLES_PER_AIRY
    psf = wavefront.psf(spacing_um, 2 * ceil(half_width_um / spacing_um) + 1)
    edge = psf.shape[0] / 2 * spacing_um
    axes.imshow(
        psf,
        cmap=colours,
        norm=PowerNorm(0.5, 0, psf.max(), clip=True),
        interpolation="nearest",
        extent=(-edge, edge, edge, -edge),
    )
    axes.set(xlim=(-half_width_um, half_width_um), ylim=(half_width_um, -half_width_um))


def _scale_bar(axes: Axes, half_width_um: float) -> None:
    wanted = 0.7 * half_width_um
    decade = 10.0 ** floor(log10(wanted))
    length = max(step * decade for step in (1, 2, 5) if step * decade <= wanted)
    left, y = -0.92 * half_width_um, 0.88 * half_width_um
    axes.plot([left, left + length], [y, y], color=INK, lw=2, solid_capstyle="butt")
    axes.text(left, y - 0.05 * half_width_um, f"{length:g} µm", fontsize=8, va="bottom")
