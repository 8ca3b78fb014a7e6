"""A target from an image file: its values are relative radiance, its pixels are cells."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from labkit.errors import InputError, TargetError
from labkit.photographs.picture_file import read_picture
from labkit.target.target import SURROUNDS, CellTarget
from labkit.types import Floats

if TYPE_CHECKING:
    from labkit.plan import TargetSpec

MOST_TARGET_PIXELS = 2**26
"""67 million, half a gigabyte of radiances: a carpet of the highest order has 43 million cells."""


def open_target(spec: TargetSpec) -> CellTarget:
    """Return the picture ``spec.file``, its first axis (rows) ``spec.size_mm`` long, its pixels square.

    Raises TargetError if the file is missing or is no 8- or 16-bit grey PNG, PGM or TIFF.
    """
    if spec.file is None:
        raise TargetError('[target] kind = "image" needs file = "picture.png"')
    cells = read_radiance(Path(spec.file))
    return CellTarget(
        cells,
        (spec.size_mm, spec.size_mm * cells.shape[1] / cells.shape[0]),
        SURROUNDS[spec.surround],
    )


def read_radiance(path: Path) -> Floats:
    """Return (rows, cols) relative radiance 0..1 of a grey picture.

    Full scale of the bit depth (or the PGM maximum) is 1. A picture in colours with three
    equal numbers everywhere is grey. Raises TargetError.
    """
    try:
        picture = read_picture(path, MOST_TARGET_PIXELS)
    except OSError as error:
        raise TargetError(f"target picture {path}: {error.strerror}") from error
    except InputError as error:
        raise TargetError(f"target picture {path}: {error}") from error
    numbers = picture.numbers
    if numbers.ndim == 3:
        if np.any(numbers != numbers[..., :1]):
            raise TargetError(f"target picture {path}: has colours; it must be grey")
        numbers = numbers[..., 0]
    return numbers / float(picture.white)
