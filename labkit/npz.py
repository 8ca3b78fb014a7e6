"""Arrays as NPZ files, which a damaged or forged file cannot make to take more memory than is allowed.

NumPy's own reader unpacks whatever a file declares, and reads headers as Python.
"""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Callable, Iterable, Mapping
from math import prod
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from labkit.errors import shown

Arrays = dict[str, NDArray[Any]]

SUFFIX = ".npy"

HEADER = re.compile(
    rb"\x93NUMPY\x01\0..\{'descr': '([<>|][biuf]\d{1,2})', 'fortran_order': (True|False), "
    rb"'shape': \(((?:\d{1,12}, ?)*(?:\d{1,12})?)\), \} *\n",
    re.DOTALL,
)
"""Of NumPy's format 1.0, as NumPy writes it for arrays of numbers: no fields, no objects, no texts."""

MOST_HEADER_BYTES = 1024


def packed(arrays: Mapping[str, NDArray[Any]], *, compressed: bool = True) -> bytes:
    """Return the content of an NPZ file of some arrays."""
    buffer = io.BytesIO()
    save = np.savez_compressed if compressed else np.savez
    save(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()


def write(file: BinaryIO, arrays: Iterable[tuple[str, NDArray[Any]]]) -> None:
    """Write an NPZ file, not compressed, of arrays by name; one array is in memory at a time."""
    with zipfile.ZipFile(file, "w") as archive:
        for name, array in arrays:
            with archive.open(name + SUFFIX, "w", force_zip64=True) as entry:
                np.lib.format.write_array(entry, array, allow_pickle=False)


def unpacked(content: bytes, most_bytes: Callable[[str], int | None]) -> Arrays:
    """Return the arrays of an NPZ file.

    Parameters
    ----------
    content : the file
    most_bytes : largest size of an array, by its name; None leaves an array out

    Raises
    ------
    ValueError
        The file is damaged, an array is larger than allowed, or holds something else than numbers.
    """
    arrays: Arrays = {}
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            for entry in archive.infolist():
                name = entry.filename.removesuffix(SUFFIX)
                if (most := most_bytes(name)) is None:
                    continue
                with archive.open(entry) as file:
                    data = file.read(most + MOST_HEADER_BYTES + 1)
                if len(data) > most + MOST_HEADER_BYTES:
                    raise ValueError(f"{shown(name)} takes more than {most} bytes")
                arrays[name] = _array(data)
    except ValueError:
        raise
    except Exception as error:  # zipfile lets through whatever a damaged entry breaks
        raise ValueError(f"it is damaged ({shown(str(error))})") from error
    return arrays


def _array(data: bytes) -> NDArray[Any]:
    """Return the array in a file of NumPy's own format."""
    header = HEADER.match(data)
    if header is None:
        raise ValueError("it is damaged: an array's header cannot be read")
    dtype = np.dtype(header[1].decode())
    shape = tuple(int(side) for side in header[3].split(b",") if side.strip())
    if len(data) - header.end() != prod(shape) * dtype.itemsize:
        raise ValueError(f"it is damaged: an array of {shape} is not whole")
    numbers = np.frombuffer(data, dtype, offset=header.end()).copy()
    by_columns = header[2] == b"True"
    return numbers.reshape(shape[::-1]).T if by_columns else numbers.reshape(shape)
