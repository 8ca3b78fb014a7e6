"""A target as a file to print or to show: PNG or PDF at its true size."""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from labkit.errors import TargetError
from labkit.files import write_atomically
from labkit.target import CellTarget, Target, open_target

MM_PER_INCH = 25.4
PRINT_DPI = 600.0
MAX_PIXELS = 400_000_000


@dataclass(frozen=True, slots=True)
class Rendering:
    """A written target: (rows, cols) pixels over (height, width) mm, and notes for the user."""

    path: Path
    pixels: tuple[int, int]
    size_mm: tuple[float, float]
    notes: tuple[str, ...]


def render_target(
    target: Target | str,
    path: Path | str,
    *,
    dpi: float | None = None,
    pixels: int | None = None,
) -> Rendering:
    """Write a target as PNG or PDF at its true size; the file is written whole or not at all.

    Grey levels are linear radiance.

    Parameters
    ----------
    target : a target, or what `labkit.open_target` takes
    path : the file, with the suffix .png or .pdf
    dpi : raster in dots per inch
    pixels : dots along the height, instead of `dpi`; with neither, three dots a cell (one in
        a PDF), or 600 dpi for a target without cells

    Raises
    ------
    TargetError
        another suffix, or an impossible raster
    InputError
        the file cannot be written

    >>> labkit.render_target("sierpinski:order=5,size_mm=46.8", "carpet.pdf").pixels
    (243, 243)
    """
    target = open_target(target) if isinstance(target, str) else target
    path = Path(path)
    if path.suffix.lower() not in (".png", ".pdf"):
        raise TargetError(
            f"cannot write a target as {path.name!r}: the name must end in .png or .pdf"
        )
    rows, cols = _raster(
        target, dpi, pixels, default_dots=3 if path.suffix.lower() == ".png" else 1
    )
    height, width = target.size_mm
    y = ((np.arange(rows) + 0.5) / rows - 0.5) * height
    x = ((np.arange(cols) + 0.5) / cols - 0.5) * width
    grey = np.rint(255 * np.clip(target.radiance(y[:, None], x[None, :]), 0, 1)).astype(
        np.uint8
    )
    if path.suffix.lower() == ".png":
        dots = (cols * MM_PER_INCH / width, rows * MM_PER_INCH / height)
        content = BytesIO()
        Image.fromarray(grey).save(content, format="png", dpi=dots)
        write_atomically(path, content.getvalue())
    else:
        write_atomically(path, _pdf(grey, height, width))
    return Rendering(path, (rows, cols), (height, width), tuple(_notes(target, grey)))


def _raster(
    target: Target, dpi: float | None, pixels: int | None, default_dots: int
) -> tuple[int, int]:
    height, width = target.size_mm
    if dpi is not None and pixels is not None:
        raise TargetError("a target's raster is given by dpi or by pixels, not by both")
    if pixels is None and dpi is None:
        if isinstance(target, CellTarget):
            pixels = default_dots * target.cells.shape[0]
        else:
            dpi = PRINT_DPI
    wanted = float(pixels) if pixels is not None else height / MM_PER_INCH * float(dpi or 0)
    if not (
        np.isfinite(wanted)
        and wanted >= 1
        and wanted * wanted * width / height <= MAX_PIXELS
    ):
        raise TargetError(
            f"a raster of {wanted:g} pixels over {height:g} mm: allowed are 1 to {MAX_PIXELS:.0e} in all"
        )
    rows = round(wanted)
    return rows, max(1, round(rows * width / height))


def _notes(target: Target, grey: NDArray[np.uint8]) -> list[str]:
    notes = []
    if isinstance(target, CellTarget):
        dots = grey.shape[0] / target.cells.shape[0]
        if any(
            have % cells for have, cells in zip(grey.shape, target.cells.shape, strict=True)
        ):
            whole = max(1, round(dots)) * target.cells.shape[0]
            dpi = whole * MM_PER_INCH / target.size_mm[0]
            notes.append(
                f"a cell is {dots:.3g} pixels, so edges move by up to half a pixel: "
                f"{whole} pixels ({dpi:.2f} dpi) would make it whole"
            )
    else:
        notes.append(
            f"what is not upright is drawn in steps of a dot, {1000 * target.size_mm[0] / grey.shape[0]:.3g} um"
        )
    if np.any((grey != 0) & (grey != 255)):
        notes.append(
            "grey levels are linear in radiance: show them on a linearised display"
        )
    if target.surround == 0:
        notes.append("black surrounds the target in the plan: mount it on black")
    return notes


def _pdf(grey: NDArray[np.uint8], height_mm: float, width_mm: float) -> bytes:
    """Return a page as large as the target with the raster in it, not resampled."""
    page = Figure(figsize=(width_mm / MM_PER_INCH, height_mm / MM_PER_INCH))
    axes = page.add_axes((0, 0, 1, 1))
    axes.set_axis_off()
    axes.imshow(grey, cmap="gray", vmin=0, vmax=255, interpolation="none", aspect="auto")
    content = BytesIO()
    page.savefig(content, format="pdf")
    return content.getvalue()
