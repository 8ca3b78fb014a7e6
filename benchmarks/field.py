"""Selecting and solving a field: `python -m benchmarks.field`, 1,000 tiles at three ranges in three colours, 5 % of them wrong.

Defocus and modes of a tile are polynomials of second degree in its place, and follow the laws that tests hold the estimate
to; a wrong fit departs by 0.05 waves and more in each mode, and half of all fits are given as their twins.
"""

from __future__ import annotations

import resource
from dataclasses import replace
from time import perf_counter

import numpy as np

from labkit.estimation.candidate import Candidate, Observed
from labkit.estimation.select import select
from labkit.jobs.execute import pin_threads
from labkit.key import Key
from tests.lens_samples import (
    COLOURS,
    laws,
    measured,
    moved,
    over_the_field,
    reading,
    stated,
    turned,
)

TILES = (25, 40)
RANGES_MM = (2000.0, 2080.0, 2160.0)
MODES = tuple(range(5, 16))
WRONG_SHARE = 0.05


def drawn_field(rng: np.random.Generator) -> tuple[list[Observed], set[Key]]:
    """Draw the observations, and the keys of the wrong ones: two of a tile's three ranges are right."""
    every, wrong = list[Observed](), set[Key]()
    for tile in np.ndindex(*TILES):
        place = reading(RANGES_MM[0], "G", tile, TILES).place
        modes = over_the_field(np.random.default_rng(3), (4, *MODES), place)
        defocus = modes.pop(4)
        for channel in COLOURS:
            off = int(rng.integers(3)) if rng.random() < 3 * WRONG_SHARE else None
            for k, range_mm in enumerate(RANGES_MM):
                lens = np.array(laws(range_mm, 2060.0, 2060.0, 70.0, 2.8, 0.985))
                lens[0] += defocus
                of = measured(lens, modes)
                values = rng.multivariate_normal(of.values, of.covariance)
                one = Observed(
                    reading(range_mm, channel, tile, TILES),
                    (Candidate(replace(of, values=values)),),
                )
                if k == off:
                    one = moved(
                        one, rng.normal(0, 0.3), modes=0.05 + abs(rng.normal(0, 0.3))
                    )
                    wrong.add(one.reading.key)
                every.append(turned(one) if rng.random() < 0.5 else one)
    return every, wrong


def selected() -> tuple[float, float, str]:
    """Select and solve: seconds, GB at most, and what was named."""
    every, wrong = drawn_field(np.random.default_rng(7))
    began = perf_counter()
    selection = select(every, stated(70.0, 2.8))
    seconds = perf_counter() - began
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    named = set(selection.outliers)
    return (
        seconds,
        most,
        f"{len(wrong & named)} of {len(wrong)}, {len(named - wrong)} right",
    )


if __name__ == "__main__":
    pin_threads()
    seconds, most, named = selected()
    print(f"{seconds:.1f} s, {most:.2f} GB at most; wrong fits named: {named}")
