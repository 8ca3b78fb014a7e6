"""Decodes one picture in a process of its own, run as a script: python decoder.py FORMAT BYTES SECONDS < file > numbers.

FORMAT is Pillow's name of the only format that is tried, or OpenCV for colours of 16 bit, which Pillow cuts to 8. Writes the
mode, a line feed, and the numbers row by row. It imports nothing of labkit, and NumPy only with OpenCV, so that it starts in
0.1 s and its memory can be limited from the start.
"""

from __future__ import annotations

import sys
from io import BytesIO

TYPES = {
    "L": "u1",
    "RGB": "u1",
    "I;16": "<u2",
    "I;16L": "<u2",
    "I;16B": ">u2",
    "I;16N": "=u2",
    "RGB;16": "=u2",
}
"""Pillow's modes, and the numbers that they write."""

PLAIN = {"1": "L", "P": "RGB"}
"""Modes of less than a byte, or of a palette, and what they are turned into."""


def limit(memory_bytes: int, seconds: int) -> None:
    """End this process rather than let it take more; where the system knows no limits, only its parent's clock does."""
    try:
        import resource
    except ImportError:  # Windows
        return
    for what, most in (
        (resource.RLIMIT_AS, memory_bytes),
        (resource.RLIMIT_CPU, seconds),
        (resource.RLIMIT_CORE, 0),
    ):
        try:
            resource.setrlimit(what, (most, most))
        except (OSError, ValueError):  # macOS takes no limit of memory
            continue


def deep_colours(memory_bytes: int, seconds: int) -> None:
    """Decode a picture of three colours of 16 bit."""
    import cv2
    import numpy as np

    limit(memory_bytes, seconds)
    try:
        numbers = cv2.imdecode(
            np.frombuffer(sys.stdin.buffer.read(), np.uint8), cv2.IMREAD_UNCHANGED
        )
    except cv2.error as error:
        sys.exit(str(error.err))
    if (
        numbers is None
        or numbers.ndim != 3
        or numbers.shape[2] != 3
        or numbers.dtype != np.uint16
    ):
        sys.exit("no colours of 16 bit came out of it")
    sys.stdout.buffer.write(b"RGB;16\n" + numbers[..., ::-1].tobytes())


def main() -> None:
    """Decode standard input to standard output; a line on standard error and status 1 where that fails."""
    name, memory_bytes, seconds = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    if name == "OpenCV":
        deep_colours(memory_bytes, seconds)
        return
    from PIL import Image

    limit(memory_bytes, seconds)
    Image.MAX_IMAGE_PIXELS = None  # the declared size has been looked at
    try:
        with Image.open(BytesIO(sys.stdin.buffer.read()), formats=[name]) as picture:
            picture.load()
            plain = (
                picture.convert(PLAIN[picture.mode]) if picture.mode in PLAIN else picture
            )
            if plain.mode not in TYPES:
                sys.exit(f"numbers of the kind {plain.mode}")
            sys.stdout.buffer.write(plain.mode.encode() + b"\n" + plain.tobytes())
    except MemoryError:
        sys.exit(f"it takes more than {memory_bytes >> 20} MiB to decode")
    except Exception as error:  # of whatever a damaged file breaks
        sys.exit(str(error) or type(error).__name__)


if __name__ == "__main__":
    main()
