"""Compress raw counts as cameras do: lossless JPEG, predicted by the left neighbour, in Huffman's code.

ITU-T T.81, process 14, annexes C, H and K.2. A library that writes this form, imagecodecs,
takes 79 MB on the disk.
"""

from __future__ import annotations

import heapq
import struct
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from labkit.types import Counts

CATEGORIES = 17
"""Lengths of a difference in bits: 0 to 16."""

LONGEST_CODE = 16
LEAST_BITS, MOST_BITS = 2, 16
MOST_SIDE = 65535

COUNTS_AT_ONCE = 1 << 18
"""Differences are packed in strips of so many, whose tables stay in a processor's cache."""

SOI, SOF3, DHT, SOS, EOI = 0xFFD8, 0xFFC3, 0xFFC4, 0xFFDA, 0xFFD9
"""Markers of a JPEG file, by the names of the standard."""

Table = NDArray[np.int64]


def compress_counts(counts: Counts, bits: int, colours_in_row: int = 1) -> bytes:
    """Compress a table of counts to a JPEG file.

    Parameters
    ----------
    counts : (rows, columns)
    bits : of the largest count, 2 to 16
    colours_in_row : 2 for a mosaic with two colours in each row: the neighbour of the same
        colour predicts a count, and the file has two components of half the columns

    Raises
    ------
    ValueError
        the table is empty or too large, its counts need more bits, or its columns are no
        multiple of the colours
    """
    rows, cols = counts.shape
    if not (0 < rows <= MOST_SIDE and 0 < cols <= MOST_SIDE) or cols % colours_in_row:
        raise ValueError(
            f"a table of {rows} × {cols} counts with {colours_in_row} colours in a row: "
            f"allowed are 1 to {MOST_SIDE} rows, and columns in multiples of the colours"
        )
    if not LEAST_BITS <= bits <= MOST_BITS or int(counts.max()) >> bits:
        raise ValueError(
            f"counts up to {counts.max()} in {bits} bits: allowed are {LEAST_BITS} to {MOST_BITS} that hold them"
        )
    occurrences = np.zeros(1 << 16, dtype=np.int64)
    for some in _differences(counts, bits, colours_in_row):
        occurrences += np.bincount(some, minlength=occurrences.size)
    lengths = code_lengths(
        np.bincount(_category_of(), occurrences, CATEGORIES).astype(np.int64)
    )
    symbols = sorted(np.flatnonzero(lengths).tolist(), key=lambda one: int(lengths[one]))
    packed = _packed(_differences(counts, bits, colours_in_row), lengths, symbols)
    return _head(counts, bits, colours_in_row, lengths, symbols) + packed


def _differences(counts: Counts, bits: int, step: int) -> Iterator[Counts]:
    """Yield each count less its prediction, modulo 2^16, in strips of rows.

    The count `step` places to the left predicts; at the left border the count above; at
    the first row's half of the scale.
    """
    rows, cols = counts.shape
    at_once = max(1, COUNTS_AT_ONCE // cols)
    above = np.full(step, 1 << (bits - 1), dtype=np.uint16)
    for top in range(0, rows, at_once):
        strip = counts[top : top + at_once]
        some = np.empty(strip.shape, dtype=np.uint16)
        np.subtract(strip[:, step:], strip[:, :-step], out=some[:, step:])
        some[:, :step] = np.diff(strip[:, :step], axis=0, prepend=above[None])
        above = strip[-1, :step]
        yield some.ravel()


def _category_of() -> NDArray[np.uint8]:
    """Return the length in bits of the size of each difference modulo 2^16, (65536,): 16 for half of 2^16."""
    size = np.abs(np.arange(1 << 16).astype(np.int16).astype(np.int64))
    return np.frexp(size)[1].astype(np.uint8)


def code_lengths(occurrences: Table) -> Table:
    """Return the length in bits of each category's Huffman code, 16 at most; 0 for categories without
    occurrences.

    The code of ones only, which the standard reserves, belongs to none.
    """
    weight = np.append(occurrences, 0)
    while True:
        heap = [(int(n), [one]) for one, n in enumerate(weight) if n or one == CATEGORIES]
        heapq.heapify(heap)
        lengths = np.zeros(weight.size, dtype=np.int64)
        while len(heap) > 1:
            rare = heapq.heappop(heap)
            less_rare = heapq.heappop(heap)
            joined = rare[1] + less_rare[1]
            lengths[joined] += 1
            heapq.heappush(heap, (rare[0] + less_rare[0], joined))
        if lengths.max() <= LONGEST_CODE:
            return lengths[:CATEGORIES]
        # flatter weights have shorter codes
        weight = (weight + 1) // 2


def _codes(lengths: Table, symbols: list[int]) -> tuple[NDArray[np.uint64], Table]:
    """Return the code and its length, bits, of each difference modulo 2^16: its category's code and its own low bits."""
    codes = np.zeros(CATEGORIES, dtype=np.int64)
    code = 0
    last = 0
    for symbol in symbols:
        # codes count up, and grow by zeros where they get longer
        code <<= int(lengths[symbol]) - last
        last = int(lengths[symbol])
        codes[symbol] = code
        code += 1
    category = _category_of().astype(np.int64)
    # a single difference has 16 bits, which its category tells in full
    own_bits = np.where(category == MOST_BITS, 0, category)
    signed = np.arange(1 << 16).astype(np.int16).astype(np.int64)
    low = np.where(signed < 0, signed - 1, signed) & ((1 << own_bits) - 1)
    whole = (codes[category] << own_bits) | low
    return whole.astype(np.uint64), lengths[category] + own_bits


def _packed(strips: Iterator[Counts], lengths: Table, symbols: list[int]) -> bytes:
    """Return the entropy-coded data of all differences, and the end of the file.

    A code has 31 bits at most: a word of 32 bits has the start of a code in it, and
    codes that start in one word end in the next.
    """
    code_of, bits_of = _codes(lengths, symbols)
    parts = list[bytes]()
    held = np.uint64(0)
    held_bits = 0
    for some in strips:
        bits = bits_of[some]
        end = held_bits + np.cumsum(bits)
        start = end - bits
        word = start >> 5
        turned = code_of[some] << (64 + (word << 5) - end).astype(np.uint64)
        first = np.flatnonzero(np.diff(word, prepend=-1))
        pairs = np.bitwise_or.reduceat(turned, first)
        pairs[0] |= held << np.uint64(32)
        words = np.zeros(pairs.size + 1, dtype=np.uint64)
        words[:-1] = pairs >> np.uint64(32)
        words[1:] |= pairs & np.uint64(0xFFFFFFFF)
        whole = int(end[-1]) >> 5
        held, held_bits = words[whole], int(end[-1]) & 31
        parts.append(words[:whole].astype(">u4").tobytes())
    # ones fill the last byte
    ones = (1 << (32 - held_bits)) - 1
    rest = struct.pack(">I", int(held) | ones)[: (held_bits + 7) // 8]
    stuffed = b"".join([*parts, rest]).replace(b"\xff", b"\xff\x00")
    return stuffed + struct.pack(">H", EOI)


def _head(
    counts: Counts, bits: int, components: int, lengths: Table, symbols: list[int]
) -> bytes:
    """Return the markers before the entropy-coded data: frame, Huffman table, scan."""
    rows, cols = counts.shape
    every = range(1, components + 1)
    frame = struct.pack(">BHHB", bits, rows, cols // components, components)
    frame += b"".join(bytes((one, 0x11, 0)) for one in every)
    of_length = np.bincount(lengths[lengths > 0], minlength=LONGEST_CODE + 1)[1:]
    table = bytes((0, *of_length.tolist(), *symbols))
    scan = bytes((components,)) + b"".join(bytes((one, 0)) for one in every)
    scan += bytes((1, 0, 0))  # the left neighbour predicts
    return struct.pack(">H", SOI) + b"".join(
        struct.pack(">HH", marker, len(content) + 2) + content
        for marker, content in ((SOF3, frame), (DHT, table), (SOS, scan))
    )
