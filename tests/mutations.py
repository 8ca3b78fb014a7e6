"""Damage to files, by chance but always the same for a seed: what parsers must take without a traceback."""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence

import numpy as np

NASTY = (
    b"\0",
    b"\xff",
    b"\x1b[31m",
    b"\xef\xbb\xbf",
    b"\r",
    b"\n",
    b'"',
    b"9" * 5000,
    b"-",
    b"nan",
    b"1e999",
    b"../",
)


def mutated(
    content: bytes, number: int, *, tokens: Sequence[bytes] = NASTY, seed: int = 0
) -> Iterator[bytes]:
    """So many damaged copies: bytes changed, cut, doubled, moved, tokens put in, one to four at a time."""
    rng = np.random.default_rng(seed)
    for _ in range(number):
        damaged = content
        for _ in range(rng.integers(1, 5)):
            damaged = _once(damaged, rng, tokens)
        yield damaged


def _once(content: bytes, rng: np.random.Generator, tokens: Sequence[bytes]) -> bytes:
    start = int(rng.integers(len(content) + 1))
    end = min(len(content), start + int(rng.geometric(0.1)))
    head, part, tail = content[:start], content[start:end], content[end:]
    match rng.integers(6):
        case 0:
            return head + rng.bytes(len(part)) + tail
        case 1:
            return head + tail
        case 2:
            return head + part * int(rng.integers(2, 9)) + tail
        case 3:
            return head + tokens[int(rng.integers(len(tokens)))] + tail
        case 4:
            return (
                head
                + (bytes([part[0] ^ (1 << rng.integers(8))]) + part[1:] if part else b"")
                + tail
            )
        case _:
            return head if rng.random() < 0.2 else tail[: len(tail) // 2] + part + head


def mended_png(png: bytes) -> bytes:
    """A damaged PNG with checksums that fit the damage, as far as its chunks can be followed."""
    at, whole = 8, png[:8]
    while at + 12 <= len(png):
        end = at + 8 + int.from_bytes(png[at : at + 4])
        whole += png[at:end] + zlib.crc32(png[at + 4 : end]).to_bytes(4)
        at = end + 4
    return whole
