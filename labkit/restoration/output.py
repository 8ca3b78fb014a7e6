"""Write a restoration: restored.tif, std.tif, restored.png, restore.json."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from PIL import Image

from labkit.errors import InputError
from labkit.restoration.canvas import BAND_ROWS, Canvas
from labkit.storage.files import replacing, write_atomically, writing
from labkit.types import Floats32

RESTORED, STD, SHOWN, RESTORATION_JSON, SIXTEEN = (
    "restored.tif",
    "std.tif",
    "restored.png",
    "restore.json",
    "restored16.tif",
)
WHITEST = 99.7  # percentile of a colour that the picture to look at shows as white
WHITE_16 = 65535
MOST_SHOWN_PX = 4096  # longer sides are shown smaller


def refuse_full(folder: Path) -> None:
    """Raise InputError where an earlier restoration lies in a folder: nothing is overwritten."""
    if (folder / RESTORATION_JSON).exists():
        raise InputError(
            f"{folder} holds a restoration already: give another folder with --out"
        )


def made(folder: Path) -> Path:
    """Return a folder, made if necessary. Raises InputError."""
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    return folder


def write(
    folder: Path, canvas: Canvas, about: Mapping[str, Any], white: float | None
) -> None:
    """Write a scene, its errors if there are some, and `about`, last.

    Parameters
    ----------
    folder : to write to, made if necessary
    canvas : scene and errors
    about : content of restore.json
    white : counts above black at the greatest 16-bit number; None for no such file

    Raises
    ------
    InputError
    """
    made(folder)
    _write_tiff(folder / RESTORED, canvas, 0)
    if canvas.shape[0] > 1:
        _write_tiff(folder / STD, canvas, 1)
    if white is not None:
        _write_tiff(folder / SIXTEEN, canvas, 0, white)
    step = -(-max(canvas.shape[2:]) // MOST_SHOWN_PX)
    write_atomically(folder / SHOWN, picture(canvas.opened()[0, :, ::step, ::step]))
    content = json.dumps(dict(about), indent=1, allow_nan=False).encode() + b"\n"
    write_atomically(folder / RESTORATION_JSON, content)


def picture(scene: Floats32) -> bytes:
    """Return the PNG of a scene, each colour up to its own brightest parts, in sRGB; unknown samples are white."""
    shown = scene if len(scene) in (1, 3) else scene[:1]
    whites = [
        max(float(np.nanpercentile(colour, WHITEST)), 1e-6)
        if np.isfinite(colour).any()
        else 1.0
        for colour in shown
    ]
    linear = np.nan_to_num(
        shown / np.array(whites, np.float32)[:, None, None], nan=1.0
    ).clip(0, 1)
    curved = np.where(
        linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055
    )
    grey = np.rint(255 * curved).astype(np.uint8)
    file = io.BytesIO()
    Image.fromarray(grey[0] if len(grey) == 1 else np.moveaxis(grey, 0, -1)).save(
        file, "PNG"
    )
    return file.getvalue()


def _write_tiff(path: Path, canvas: Canvas, layer: int, white: float | None = None) -> None:
    """Write a layer in strips, as 32-bit numbers, or as 16-bit numbers up to `white`."""
    _, colours, rows, columns = canvas.shape

    def strips() -> Iterator[np.ndarray[Any, Any]]:
        for band in canvas.bands(layer):
            strip = np.moveaxis(band, 0, -1)
            if white is not None:
                whole = np.nan_to_num(strip, nan=white) * (WHITE_16 / white)
                strip = np.clip(np.rint(whole), 0, WHITE_16).astype(np.uint16)
            yield np.ascontiguousarray(strip)

    with replacing(path) as file:
        tifffile.imwrite(
            file,
            strips(),
            shape=(rows, columns, colours),
            dtype=np.float32 if white is None else np.uint16,
            photometric="rgb" if colours == 3 else "minisblack",
            planarconfig="contig" if colours > 1 else None,
            rowsperstrip=BAND_ROWS,
            metadata=None,
        )
