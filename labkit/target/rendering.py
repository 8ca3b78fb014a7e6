"""A target as a file to print or to show: PNG or PDF at its true size."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from labkit.errors import TargetError
from labkit.plan.tables import PRINTED_SIZE
from labkit.storage.files import write_atomically
from labkit.target.grid import TargetGrid, whole_target
from labkit.target.target import CellTarget, Target, on_dots
from labkit.types import Floats

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
    target = whole_target(target) if isinstance(target, str) else target
    path = Path(path)
    if path.suffix.lower() not in (".png", ".pdf"):
        raise TargetError(
            f"cannot write a target as {path.name!r}: the name must end in .png or .pdf"
        )
    default_dots = 3 if path.suffix.lower() == ".png" else 1
    dots = _raster(target, dpi, pixels, default_dots)
    if isinstance(target, TargetGrid):
        radiance, dot_mm, pitch_mm = _gridon_dots(target, dots[0])
        height, width = radiance.shape[0] * dot_mm, radiance.shape[1] * dot_mm
    else:
        pitch_mm = None
        radiance = on_dots(target, dots)
        height, width = target.size_mm
    rows, cols = radiance.shape
    grey = np.rint(255 * np.clip(radiance, 0, 1)).astype(np.uint8)
    if path.suffix.lower() == ".png":
        dpis = (cols * MM_PER_INCH / width, rows * MM_PER_INCH / height)
        content = BytesIO()
        Image.fromarray(grey).save(content, format="png", dpi=dpis)
        write_atomically(path, content.getvalue())
    else:
        write_atomically(path, _pdf(grey, height, width))
    return Rendering(
        path, (rows, cols), (height, width), tuple(_notes(target, grey, pitch_mm))
    )


def _gridon_dots(grid: TargetGrid, rows: int) -> tuple[Floats, float, float]:
    """Return a grid's radiance in whole dots a cell and from target to target, a dot's side and the pitch, both in mm.

    rows: about how many dots.
    """
    tile = grid.tile
    cells = tile.cells.shape if isinstance(tile, CellTarget) else (1, 1)
    cell_dots = rows * tile.size_mm[0] / grid.size_mm[0] / cells[0]
    down = cells[0] * max(1, round(cell_dots))
    dot_mm = tile.size_mm[0] / down
    across = cells[1] * max(1, round(tile.size_mm[1] / dot_mm / cells[1]))
    drawn = grid.in_dots(on_dots(tile, (down, across)), dot_mm)
    return drawn.radiance_of_dots(), dot_mm, drawn.pitch_mm * dot_mm


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


def _notes(target: Target, grey: NDArray[np.uint8], pitch_mm: float | None) -> list[str]:
    """Return remarks for a user; pitch_mm: of a grid as drawn."""
    notes: list[str] = []
    if isinstance(target, TargetGrid) and pitch_mm is not None and not target.is_marked_one:
        notes += _pitch_notes(target.pitch_mm, pitch_mm)
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
    elif not isinstance(target, TargetGrid):
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


def _pitch_notes(asked_mm: float, drawn_mm: float) -> Iterator[str]:
    """Yield by how much whole dots change the distance of a grid's targets, if that counts."""
    if abs(drawn_mm / asked_mm - 1) > PRINTED_SIZE:
        yield (
            f"in whole dots the targets are {drawn_mm:.6g} mm apart instead of {asked_mm:.6g}: "
            f"state pitch_mm = {drawn_mm:.6g} in the plan"
        )


def _pdf(grey: NDArray[np.uint8], height_mm: float, width_mm: float) -> bytes:
    """Return a page as large as the target with the raster in it, not resampled."""
    page = Figure(figsize=(width_mm / MM_PER_INCH, height_mm / MM_PER_INCH))
    axes = page.add_axes((0, 0, 1, 1))
    axes.set_axis_off()
    axes.imshow(grey, cmap="gray", vmin=0, vmax=255, interpolation="none", aspect="auto")
    content = BytesIO()
    page.savefig(content, format="pdf")
    return content.getvalue()
