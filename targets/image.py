"""A target from an image file: its values are relative radiance, its pixels are cells."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from labkit.errors import TargetError
from labkit.target import SURROUNDS, CellTarget
from labkit.types import Floats

if TYPE_CHECKING:
    from labkit.plan import TargetSpec


def open_target(spec: TargetSpec) -> CellTarget:
    """The picture ``spec.file``, its first axis (rows) ``spec.size_mm`` long, its pixels square.

    Raises TargetError if the file is missing or is no 8- or 16-bit grey PNG, PGM or TIFF.
    """
    if spec.file is None:
        raise TargetError('[target] kind = "image" needs file = "picture.png"')
    cells = read_radiance(Path(spec.file))
    return CellTarget(cells, (spec.size_mm, spec.size_mm * cells.shape[1] / cells.shape[0]), SURROUNDS[spec.surround])


def read_radiance(path: Path) -> Floats:
    """(rows, cols) relative radiance 0..1 of a grey picture: full scale of its bit depth (or PGM maximum) is 1."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise TargetError(f"target picture {path}: {error.strerror}") from error
    picture = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED) if content else None
    if picture is None or picture.dtype not in (np.uint8, np.uint16):
        raise TargetError(f"target picture {path}: not a readable 8- or 16-bit PNG, PGM or TIFF")
    if picture.ndim == 3:
        if picture.shape[2] != 3 or np.any(picture != picture[..., :1]):
            raise TargetError(f"target picture {path}: it has colours or transparency; it must be grey")
        picture = picture[..., 0]
    return np.asarray(picture, dtype=np.float64) / _full_scale(content, picture.dtype.itemsize)


def _full_scale(content: bytes, item_bytes: int) -> float:
    """The value that means radiance 1; a PGM states its own (cv2 leaves its values as they are)."""
    header = re.match(rb"P[25](?:\s+|#[^\n]*\n)+\d+(?:\s+|#[^\n]*\n)+\d+(?:\s+|#[^\n]*\n)+(\d+)\s", content)
    return float(header[1]) if header else float(256**item_bytes - 1)
