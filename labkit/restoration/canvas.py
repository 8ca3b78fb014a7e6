"""A picture under work: in memory, or in a file where it is larger than memory should hold."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from tempfile import NamedTemporaryFile

import numpy as np

from labkit.storage.files import writing
from labkit.types import Floats32

BAND_ROWS = 128  # rows of a picture that are held in memory at once


class Canvas:
    """An array of zeros (layers, colours, rows, columns), each change of which is kept.

    The file goes with this object. Its space is reserved first: a full disk ends a program as it writes to
    mapped memory.

    Parameters
    ----------
    shape : of the array
    folder : of the file; None for memory

    Raises
    ------
    InputError
        The folder cannot be written to.
    """

    def __init__(self, shape: tuple[int, ...], folder: Path | None = None) -> None:
        self.shape = shape
        self._array: Floats32 | None = None
        if folder is None:
            self._array = np.zeros(shape, np.float32)
            return
        with writing(folder):
            self._file = NamedTemporaryFile(dir=folder, prefix=".picture.", suffix=".part")  # noqa: SIM115
            size = 4 * int(np.prod(shape))
            if hasattr(os, "posix_fallocate"):  # a full disk is noticed now
                os.posix_fallocate(self._file.fileno(), 0, size)
            else:
                self._file.truncate(size)

    def opened(self) -> Floats32:
        """Return the array; memory that a file's takes is free again when it is dropped."""
        if self._array is not None:
            return self._array
        return np.memmap(self._file.name, np.float32, "r+", shape=self.shape)

    @classmethod
    def of(cls, layers: Floats32) -> Canvas:
        """Return the canvas of an array (layers, colours, rows, columns)."""
        canvas = cls((0, 0, 0, 0), None)
        canvas.shape, canvas._array = layers.shape, layers
        return canvas

    def bands(self, layer: int) -> Iterator[Floats32]:
        """Yield a layer's samples (colours, rows, columns), some rows at a time, from the top."""
        for first in range(0, self.shape[2], BAND_ROWS):
            yield np.array(self.opened()[layer, :, first : first + BAND_ROWS])
