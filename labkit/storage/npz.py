"""Arrays as NPZ files, which a damaged or forged file cannot make to take more memory than is allowed.

NumPy's own reader unpacks whatever a file declares, and reads headers as Python.
"""

from __future__ import annotations

import io
import re
import struct
import zipfile
from collections.abc import Callable, Iterable, Mapping
from math import prod
from typing import IO, Any, BinaryIO

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

MOST_BYTES = 2**30
"""Of all arrays of a file: the covariance of a field of four channels with every mode that a plan allows takes as much."""

MOST_DIRECTORY_BYTES = 2**23
"""Of a file's list of arrays, 50 bytes or more each."""

PART_BYTES = 2**20

LAST_RECORD = struct.Struct("<4s8xI4xH")
"""The last record of an archive: its signature, the size of the list of entries, and the length of a comment."""

LOCATOR_BYTES = 20
"""Of the record before the last, which only archives of more than 4 GB or 65,535 entries have."""


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
        The file is damaged, an array is larger than allowed, all arrays together are larger than `MOST_BYTES`, or one
        holds something else than numbers.
    """
    arrays: Arrays = {}
    room = MOST_BYTES
    try:
        _refuse_long_directory(content)
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            for entry in archive.infolist():
                name = entry.filename.removesuffix(SUFFIX)
                if (most := most_bytes(name)) is None:
                    continue
                with archive.open(entry) as file:
                    arrays[name] = _array(file, name, most, room)
                room -= arrays[name].nbytes
    except ValueError:
        raise
    except Exception as error:  # zipfile lets through whatever a damaged entry breaks
        raise ValueError(f"it is damaged ({shown(str(error))})") from error
    return arrays


def _refuse_long_directory(content: bytes) -> None:
    """Raise ValueError for a file whose list of entries alone takes long to read; APPNOTE.TXT, 4.3.16."""
    end = content[-LAST_RECORD.size :]
    if len(end) < LAST_RECORD.size:
        raise ValueError("it is damaged: it is no archive")
    signature, size, comment = LAST_RECORD.unpack(end)
    zip64 = content[-LAST_RECORD.size - LOCATOR_BYTES : -LAST_RECORD.size].startswith(
        b"PK\6\7"
    )
    if signature != b"PK\5\6" or comment or zip64 or size > MOST_DIRECTORY_BYTES:
        raise ValueError("it is damaged: its list of arrays cannot be read")


def _array(file: IO[bytes], name: str, most: int, room: int) -> NDArray[Any]:
    """Return the array in a file of NumPy's own format. most, room: bytes that the array and all further arrays may take."""
    head = file.read(MOST_HEADER_BYTES)
    header = HEADER.match(head)
    if header is None:
        raise ValueError("it is damaged: an array's header cannot be read")
    dtype = np.dtype(header[1].decode())
    shape = tuple(int(side) for side in header[3].split(b",") if side.strip())
    size = prod(shape) * dtype.itemsize
    if size > most:
        raise ValueError(f"{shown(name)} takes more than {most} bytes")
    if size > room:
        raise ValueError(f"its arrays take more than {MOST_BYTES} bytes together")
    data = bytearray(head[header.end() :])
    # no more than is needed is unpacked, and one byte more shows that the file goes on
    while len(data) <= size and (part := file.read(min(PART_BYTES, size + 1 - len(data)))):
        data += part
    if len(data) != size:
        raise ValueError(f"it is damaged: an array of {shape} is not whole")
    numbers = np.frombuffer(data, dtype)
    by_columns = header[2] == b"True"
    return numbers.reshape(shape[::-1]).T if by_columns else numbers.reshape(shape)
