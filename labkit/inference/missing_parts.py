"""What frames say of parts of the camera that their model lacks: score tests at the optimum without them.

A part's numbers are such that the likelihood is regular where they are 0 (`labkit.imaging.parts`), so its slope there says
what the part would gain, to second order, and no climb with it is needed: C. R. Rao, Proc. Camb. Phil. Soc. 44, 50 (1948).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labkit.imaging.model import Optics
from labkit.imaging.parts import Diffusion, LowPass, Part, Smear, Veil
from labkit.inference.cone import Expansion
from labkit.inference.identifiability import inverse
from labkit.optics.spectrum import Spectrum
from labkit.types import Floats

SPECTRUM = "spectrum"
KNOWN: dict[str, Part] = {part.name: part for part in (LowPass(), Diffusion(), Veil(), Smear(), LowPass(turned=True))}
"""Parts of a camera that may be missing, the simplest and commonest first. The width of its light's spectrum may be too."""


@dataclass(frozen=True)
class Call:
    """Of one part, from one fit: slope (n,) and information (n, n) of the log-likelihood by its numbers, all else refitted."""

    slope: Floats
    information: Floats

    def __add__(self, other: Call) -> Call:
        """Of two fits that share the part."""
        return Call(self.slope + other.slope, self.information + other.information)

    @property
    def step(self) -> Floats:
        """(n,) to the numbers that are called for."""
        return inverse(self.information) @ self.slope

    @property
    def gain(self) -> float:
        """Log-likelihood that the part would gain; 0 where it would need numbers that no camera has."""
        step = self.step
        return float(0.5 * step @ self.slope) if step.max() > 0 and step.sum() > 0 else 0.0


def with_part(optics: Optics, name: str) -> Optics:
    """The optics with a part, or with a spectrum of a width, that does nothing yet and is to be fitted."""
    if name == SPECTRUM:
        return replace(optics, spectrum=Spectrum.of_width(0.0))
    return replace(optics, parts=(*optics.parts, KNOWN[name]))


def without_parts(optics: Optics, names: Sequence[str]) -> Optics:
    """The optics without some parts that were fitted, the width of the spectrum among them."""
    parts = tuple(part for part in optics.parts if part.name not in names)
    return replace(optics, parts=parts, spectrum=Spectrum() if SPECTRUM in names else optics.spectrum)


def lacking(optics: Optics) -> list[str]:
    """Parts that optics do not have, nor a plan gives."""
    have = {part.name for part in (*optics.parts, *optics.given)}
    names = [name for name in KNOWN if name not in have]
    return [*names, SPECTRUM] if optics.spectrum == Spectrum() and not optics.spectrum.stated else names


def calls(expansion: Expansion, names: Sequence[str], f_number_std: float) -> dict[str, Call]:
    """What frames say of parts that their model lacks, by the likelihood about its optimum without them.

    f_number_std: relative, of the cone.
    """
    if not names:
        return {}
    without = optics = expansion.optics
    for name in names:
        optics = with_part(optics, name)
    wider = expansion.with_parts(optics)
    first, added = wider.shape.start, _added(without, optics, names)
    kept = np.setdiff1d(np.arange(len(wider.gradient)), first + np.concatenate([*added.values()]))
    information, gradient = wider.information.copy(), wider.gradient
    cone = wider.shape.stop - 1
    information[cone, cone] += max(f_number_std, 1e-6) ** -2
    others = np.arange(first, first + without.shape.size - 1)  # parts that are there already: as usual, as in a climb
    information[others, others] += without.usual_shape[:-1] ** -2
    rest = inverse(information[np.ix_(kept, kept)])
    result = {}
    for name, places in added.items():
        at = first + places
        pulled = information[np.ix_(at, kept)] @ rest
        slope = gradient[at] - pulled @ gradient[kept]
        result[name] = Call(slope, information[np.ix_(at, at)] - pulled @ information[np.ix_(kept, at)])
    return result


def _added(without: Optics, optics: Optics, names: Sequence[str]) -> dict[str, NDArray[np.intp]]:
    """Where the numbers of each named part stand in the wider shape."""
    at, places = sum(len(part.labels) for part in without.parts), dict[str, NDArray[np.intp]]()
    for name in names:
        first, many = (len(optics.shape) - 2, 1) if name == SPECTRUM else (at, len(KNOWN[name].labels))
        places[name] = np.arange(first, first + many)
        at += many
    return places
