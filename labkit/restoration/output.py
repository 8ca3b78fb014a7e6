"""Write a restoration: restored.tif, std.tif, restored.png, restore.json."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from PIL import Image

from labkit.errors import InputError
from labkit.files import write_atomically, writing
from labkit.types import Floats32

RESTORED, STD, SHOWN, RESTORATION_JSON, SIXTEEN = (
    "restored.tif",
    "std.tif",
    "restored.png",
    "restore.json",
    "restored16.tif",
)
WHITEST = 99.7  # percentile of a colour that the picture to look at shows as white
MOST_SHOWN_PX = 4096  # longer sides are shown smaller


def refuse_full(folder: Path) -> None:
    """Raise InputError where an earlier restoration lies in a folder: nothing is overwritten."""
    if (folder / RESTORATION_JSON).exists():
        raise InputError(
            f"{folder} holds a restoration already: give another folder with --out"
        )


def write(
    folder: Path,
    scene: Floats32,
    std: Floats32 | None,
    about: Mapping[str, Any],
    white: float | None,
) -> None:
    """Write a scene (colours, rows, columns), its errors, and what is to be said of it, that last.

    white: counts above black that 16-bit numbers reach to; None for no such file. Raises InputError.
    """
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    write_atomically(folder / RESTORED, _tiff(np.moveaxis(scene, 0, -1)))
    if std is not None:
        write_atomically(folder / STD, _tiff(np.moveaxis(std, 0, -1)))
    if white is not None:
        whole = np.nan_to_num(scene, nan=white) * (65535 / white)
        write_atomically(
            folder / SIXTEEN,
            _tiff(np.moveaxis(np.clip(np.rint(whole), 0, 65535).astype(np.uint16), 0, -1)),
        )
    write_atomically(folder / SHOWN, picture(scene))
    write_atomically(
        folder / RESTORATION_JSON,
        json.dumps(dict(about), indent=1, allow_nan=False).encode() + b"\n",
    )


def picture(scene: Floats32) -> bytes:
    """Return the PNG of a scene, each colour up to its own brightest parts, in sRGB; unknown samples are white."""
    step = -(-max(scene.shape[1:]) // MOST_SHOWN_PX)
    shown = scene[:, ::step, ::step]
    if len(shown) not in (1, 3):
        shown = shown[:1]
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


def _tiff(numbers: np.ndarray[Any, Any]) -> bytes:
    file = io.BytesIO()
    colours = numbers.shape[-1]
    kind, planar = (
        "rgb" if colours == 3 else "minisblack",
        "contig" if colours > 1 else None,
    )
    tifffile.imwrite(
        file,
        np.ascontiguousarray(numbers),
        photometric=kind,
        planarconfig=planar,
        metadata=None,
    )
    return file.getvalue()
