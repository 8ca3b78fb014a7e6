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
"""In whatever precision they are."""

Integers = NDArray[np.signedinteger]
Indices = NDArray[np.intp]
Bools = NDArray[np.bool_]
Counts = NDArray[np.uint16]
"""Numbers as a raw file holds them."""

JSON = None | bool | int | float | str | Sequence["JSON"] | Mapping[str, "JSON"]
"""What a JSON file can hold."""

FrameKind = Literal["target", "flat", "dark", "bias"]
"""What a photograph of a session is for."""

FRAME_KINDS: tuple[FrameKind, ...] = ("target", "flat", "dark", "bias")

Progress = Callable[[int, int, str], None]
"""Called with (steps done, steps in all, the step that begins) as work goes on; 0 in all where that is not known yet."""


def no_progress(done: int, total: int, step: str) -> None:
    """Ignore the progress of some work."""
