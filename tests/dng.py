"""Raw files of cameras labkit has never met, written by the DNG specification."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

CFA, LINEAR_RAW = 32803, 34892
COLOURS = {"R": 0, "G": 1, "B": 2}


def write_dng(
    path: Path,
    counts: NDArray[np.uint16],
    *,
    cfa: str = "RGGB",
    black: int | tuple[int, ...] = 600,
    white: int = 16383,
    orientation: int = 1,
    model: str = "Acme D1",
    exposure: tuple[int, int] = (1, 50),
    more: Sequence[tuple[Any, ...]] = (),
) -> Path:
    """A minimal DNG by the Adobe DNG 1.4 specification; cfa "mono" makes it LinearRaw of one sample. more: tags, first."""
    blacks = (black,) if isinstance(black, int) else black
    tags: list[tuple[Any, ...]] = [
        (271, "s", 0, "Acme", True),
        (272, "s", 0, model, True),
        (274, "H", 1, orientation, True),
        (33434, "2I", 1, exposure, True),
        (34855, "H", 1, 200, True),
        (50706, "B", 4, b"\1\4\0\0", True),
        (50707, "B", 4, b"\1\1\0\0", True),
        (50708, "s", 0, model, True),
        (50714, "H", len(blacks), blacks if len(blacks) > 1 else blacks[0], True),
        (50717, "I", 1, white, True),
        (50721, "2i", 9, (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1), True),
        (50778, "H", 1, 21, True),
        *([(50713, "H", 2, (2, 2), True)] if len(blacks) == 4 else []),
    ]
    if cfa != "mono":
        pattern = bytes(COLOURS[colour] for colour in cfa)
        tags += [(33421, "H", 2, (2, 2), True), (33422, "B", 4, pattern, True)]
    own = {tag[0] for tag in more}
    tags = [*more, *(tag for tag in tags if tag[0] not in own)]
    with tifffile.TiffWriter(path) as writer:
        photometric = "minisblack" if cfa == "mono" else CFA
        writer.write(
            counts,
            photometric=photometric,
            extratags=tags,
            metadata=None,
            rowsperstrip=counts.shape[0],
        )
    if cfa == "mono":
        with tifffile.TiffFile(path, mode="r+") as file:
            file.pages.first.tags[262].overwrite(LINEAR_RAW)
    return path
