"""The tables of lights and of filters, whose files name their sources and licences."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

COLOURS = "RGB"
TYPICAL = "typical"
"""Name of the filters of all bodies in the table together."""

OTHER_NAMES = {
    "Canon EOS 400D": "Canon Digital Rebel XTi",
    "Canon Kiss Digital X": "Canon Digital Rebel XTi",
}
"""Bodies of other names with the same filters, by the aliases of rawtoaces-data."""

SAY_NOTHING = {"corporation", "digital", "eos"}
"""Words, in small letters, that some names of a camera have and others lack."""

Samples = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Tables:
    """Spectra on one grid of wavelengths. Plans are checked by them: they need no numpy.

    Attributes
    ----------
    nm : (n,) wavelengths, evenly spaced
    lights : (n,) relative power by the light's name
    filters : (3, n) relative sensitivities to red, green and blue of a sensor with its
        filters, by the body's name
    """

    nm: Samples
    lights: dict[str, Samples]
    filters: dict[str, tuple[Samples, ...]]


@cache
def tables() -> Tables:
    """Return the tables, filters interpolated linearly to the wavelengths of the lights."""
    nm, lights = _columns("lights.csv")
    coarse, columns = _columns("filters.csv")
    bodies = dict.fromkeys(name.rpartition(":")[0] for name in columns)
    filters = {
        body: tuple(
            _interpolated(nm, coarse, columns[f"{body}:{colour}"]) for colour in COLOURS
        )
        for body in bodies
    }
    return Tables(nm, lights, filters)


def body_of(camera: str) -> str | None:
    """Return the body in the table that photographs or a plan name; None for other cameras."""
    known = {name: name for name in tables().filters} | OTHER_NAMES
    words = _words(camera)
    return next((body for name, body in known.items() if _words(name) == words), None)


def _words(camera: str) -> tuple[str, ...]:
    """Return the words that distinguish a camera, each once, in small letters."""
    words = re.findall(r"[a-z0-9]+", camera.lower())
    return tuple(dict.fromkeys(word for word in words if word not in SAY_NOTHING))


def _columns(file: str) -> tuple[Samples, dict[str, Samples]]:
    """Return the first column of a table, and the others by their names."""
    text = files("labkit.spectra").joinpath(file).read_text(encoding="utf-8")
    head, *lines = [line for line in text.splitlines() if not line.startswith("#")]
    rows = [map(float, line.split(";")) for line in lines]
    first, *others = zip(*rows, strict=True)
    return first, dict(zip(head.split(";")[1:], others, strict=True))


def _interpolated(at: Sequence[float], known: Samples, values: Samples) -> Samples:
    """Interpolate linearly within the range of `known`."""
    found = []
    for x in at:
        k = min(bisect_right(known, x), len(known) - 1)
        share = (x - known[k - 1]) / (known[k] - known[k - 1])
        found.append((1 - share) * values[k - 1] + share * values[k])
    return tuple(found)
