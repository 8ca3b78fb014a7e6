"""Spectra of typical lights and of cameras' colour filters, by name."""

from __future__ import annotations

import math
import re
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from statistics import stdev

from labkit.uncertain import Uncertain

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


__all__ = [
    "LIGHT_KINDS",
    "TYPICAL",
    "ChannelLight",
    "Tables",
    "body_of",
    "channel_light",
    "tables",
]


LED = ("CIE LED-B1", "CIE LED-B2", "CIE LED-B3", "CIE LED-B4", "CIE LED-B5")
RGB_LED = (
    "CIE LED-RGB1",
    "NIST 3-LED-1 (457/540/605)",
    "NIST 3-LED-3 (465/546/614)",
    "NIST 3-LED-4 (455/547/623)",
)
LIGHT_KINDS: dict[str, tuple[str, ...]] = {
    "led": LED,
    "led-panel": (*LED[3:], *RGB_LED[2:]),
    "rgb-led": RGB_LED,
    "ccfl-panel": ("Apple Studio Display, white", "NIST F32T8/TL865"),
    "fluorescent": ("CIE FL2", "CIE FL7", "CIE FL11"),
    "halogen": ("CIE A", "ISO 7589 studio tungsten"),
    "daylight": ("CIE D50", "CIE D65", "CIE D75"),
}
"""Kinds of light, and the spectra that stand for each. Filters of a panel absorb light between its colours: a panel's
spectrum is between a white and a three-colour LED's. No measured spectrum of a panel with a free licence was found."""

TABLE_STD_NM = 1.0
"""Standard error of means and widths by the tables themselves, whose wavelengths are 5 and 10 nm apart."""


@dataclass(frozen=True, slots=True)
class ChannelLight:
    """Light times filter of one channel.

    Attributes
    ----------
    light, filters : name of the kind of light, and of the body
    nm, weights : (n,) samples of the mean of all spectra of the kind; weights sum to 1
    mean : mean wavelength, nm; its error is the standard deviation among the spectra of the
        kind and the bodies
    width : standard deviation of the wavelengths, nm, with such an error
    """

    light: str
    filters: str
    nm: Samples
    weights: Samples
    mean: Uncertain
    width: Uncertain

    def about(self, mean_nm: float) -> ChannelLight:
        """Return the same light, moved to another mean wavelength."""
        moved = tuple(nm + mean_nm - self.mean.value for nm in self.nm)
        return replace(self, nm=moved, mean=Uncertain(mean_nm, self.mean.std, "nm"))


@cache
def channel_light(light: str, filters: str, colour: str) -> ChannelLight:
    """Return the light of a channel.

    Parameters
    ----------
    light : one of `LIGHT_KINDS`
    filters : body in the table, or `TYPICAL` for all of them
    colour : R, G or B
    """
    table = tables()
    bodies = [*table.filters] if filters == TYPICAL else [filters]
    products = [
        _product(table.lights[name], table.filters[body][COLOURS.index(colour)])
        for name in LIGHT_KINDS[light]
        for body in bodies
    ]
    whole = [sum(each) / len(products) for each in zip(*products, strict=True)]
    samples = [(nm, w) for nm, w in zip(table.nm, whole, strict=True) if w > 0]
    nm, weights = zip(*samples, strict=True)
    every = [_moments(table.nm, product) for product in products]
    mean, width = (
        Uncertain(value, math.hypot(stdev(each), TABLE_STD_NM), "nm")
        for value, each in zip(_moments(nm, weights), zip(*every, strict=True), strict=True)
    )
    return ChannelLight(light, filters, nm, weights, mean, width)


def _product(light: Samples, sensitivity: Samples) -> Samples:
    """Return light times filter, with unit sum."""
    product = [a * b for a, b in zip(light, sensitivity, strict=True)]
    whole = sum(product)
    return tuple(each / whole for each in product)


def _moments(nm: Samples, weights: Samples) -> tuple[float, float]:
    """Return mean and standard deviation of the wavelengths, nm, for weights with unit sum."""
    mean = sum(a * w for a, w in zip(nm, weights, strict=True))
    square = sum((a - mean) ** 2 * w for a, w in zip(nm, weights, strict=True))
    return mean, math.sqrt(square)
