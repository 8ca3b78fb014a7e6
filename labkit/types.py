"""Names of types that many modules share: arrays by content, kinds of photographs, progress."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Complexes = NDArray[np.complex128]
Complexes64 = NDArray[np.complex64]
AnyFloats = NDArray[np.floating]
AnyComplexes = NDArray[np.complexfloating]
"""Arrays of any precision."""

Integers = NDArray[np.signedinteger]
Indices = NDArray[np.intp]
Bools = NDArray[np.bool_]
Counts = NDArray[np.uint16]
"""Numbers as a raw file holds them."""

JSON = None | bool | int | float | str | Sequence["JSON"] | Mapping[str, "JSON"]
"""Contents of a JSON file."""

FrameKind = Literal["target", "flat", "dark", "bias"]
"""Purpose of a session's photograph."""

FRAME_KINDS: tuple[FrameKind, ...] = ("target", "flat", "dark", "bias")

Progress = Callable[[int, int, str], None]
"""Called with (steps done, steps in all, the step that begins) as work goes on; 0 in all while the number is unknown."""


def no_progress(done: int, total: int, step: str) -> None:
    """Ignore the progress of some work."""
