"""Observations of a session, by the laws of a lens as physics.md §10 and §15 print them: nothing here is labkit's formula."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from labkit.estimation.candidate import Candidate, Measured, Observed, Reading
from labkit.estimation.laws import Laws
from labkit.estimation.lens_fit import LensFit
from labkit.estimation.select import exact_lens
from labkit.estimation.stated import Stated
from labkit.key import Key
from labkit.types import Floats
from labkit.uncertain import Uncertain

REFERENCE_MM = 450e-6
COLOURS = ("R", "G", "B")
DEFOCUS_STD, F_NUMBER_STD, SIZE_STD = 3e-4, 4e-3, 1.5e-5
"""Of one fit, physics.md §15: waves with the cone known; relative errors of cone and size."""
MODE_STD = 1e-3
"""Of a mode above defocus, waves RMS."""
NEAR = tuple(np.linspace(470.0, 494.0, 5).tolist())
"""mm, about a best focus at 482 mm."""


def laws(
    range_mm: Any, focus_mm: Any, reference_mm: Any, f: Any, n: Any, mp: Any
) -> list[Any]:
    """Waves RMS of defocus, ln of the cone's f-number, ln of the scale; of real numbers or complex ones.

    All ranges are true; reference_mm: best focus of the colour that sizes are held to, and whose f and n are given. Others have
    the same aperture and sensor, so that what they focus on tells their focal length.
    """
    sensor = reference_mm * f / (reference_mm - f)
    own = sensor * focus_mm / (sensor + focus_mm)

    def sagitta(r: Any) -> Any:
        radius, half = r * own / (r - own) + (mp - 1) * own, mp * f / n / 2
        return half**2 / (radius + np.sqrt(radius**2 - half**2))

    waves = (sagitta(range_mm) - sagitta(focus_mm)) / np.sqrt(12) / REFERENCE_MM
    cone = (sensor + (mp - 1) * own) / (mp * f / n)
    scale = (sensor + (mp - 1) * f) / (mp * (range_mm - f + f / mp))
    return [waves, np.log(cone), np.log(scale)]


def covariance(waves: float, *, size_std: float = SIZE_STD) -> Floats:
    """(3, 3) of defocus, ln cone, ln scale of one fit: defocus times cone is known better than either."""
    slope = np.array([-waves, 1.0, 0.0])
    return np.diag([DEFOCUS_STD**2, 0.0, size_std**2]) + F_NUMBER_STD**2 * np.outer(
        slope, slope
    )


def measured(
    values: Floats, modes: Mapping[int, float] | None = None, *, size_std: float = SIZE_STD
) -> Measured:
    """What one fit measures. values: (3,) of the laws; modes: waves RMS above defocus, by Noll index."""
    modes = modes or {}
    inserted = [1] * len(modes)
    cov = np.diag(np.insert(np.zeros(3), inserted, MODE_STD**2))
    of = [0, -2, -1]
    cov[np.ix_(of, of)] = covariance(float(values[0]), size_std=size_std)
    return Measured(
        (4, *modes), np.insert(values, inserted, [*modes.values()]), cov, np.zeros_like(cov)
    )


def reading(
    range_mm: float,
    channel: str,
    tile: tuple[int, int] | None = None,
    tiles: tuple[int, int] = (2, 2),
) -> Reading:
    """The rail at a range, read as planned; the tile's place is on a lattice of (rows, columns) that fills a square frame."""
    of = Reading(Key(range_mm, channel, tile), range_mm, range_mm)
    if tile is None:
        return of
    y, x = ((2 * k + 1 - n) / n / np.sqrt(2) for k, n in zip(tile, tiles, strict=True))
    return replace(of, place=(float(y), float(x)))


def over_the_field(
    rng: np.random.Generator, noll: Sequence[int], place: tuple[float, float]
) -> dict[int, float]:
    """Modes at a place, waves RMS: polynomials of second degree, the same for the same generator's state."""
    y, x = place
    powers = np.array([1.0, y, x, y * y, x * y, x * x])
    terms = rng.normal(0, 0.05, (len(noll), len(powers)))
    return dict(zip(noll, (terms @ powers).tolist(), strict=True))


def observed(
    range_mm: float, channel: str, optimum: Measured, *others: Candidate
) -> Observed:
    """An observation with an optimum that explains its frames, and with others."""
    return Observed(reading(range_mm, channel), (Candidate(optimum), *others))


def members(
    ranges_mm: Sequence[float],
    focus_mm: float,
    f: float,
    n: float,
    mp: float = 1.0,
    *,
    modes: Mapping[int, float] | None = None,
    size_std: float = SIZE_STD,
) -> list[Observed]:
    """Of three colours, all focused at one range, ranges as stated."""
    return [
        observed(
            r,
            colour,
            measured(
                np.array(laws(r, focus_mm, focus_mm, f, n, mp)), modes, size_std=size_std
            ),
        )
        for r in ranges_mm
        for colour in COLOURS
    ]


def measured_of(one: Observed) -> Measured:
    """Of the first candidate."""
    return one.candidates[0].measured


def with_measured(one: Observed, of: Measured) -> Observed:
    """The observation with another Gaussian in its first candidate."""
    first, *others = one.candidates
    return replace(one, candidates=(replace(first, measured=of), *others))


def with_values(one: Observed, values: Floats) -> Observed:
    """The observation with other values in its first candidate."""
    return with_measured(one, replace(measured_of(one), values=values))


def moved(
    one: Observed, waves: float = 0.0, cone: float = 0.0, modes: float = 0.0
) -> Observed:
    """A fit that ended elsewhere, by waves of defocus, by ln of its cone, by waves of each mode above defocus."""
    values = measured_of(one).values.copy()
    values[0] += waves
    values[1:-2] += modes
    values[-2] += cone
    return with_values(one, values)


def turned(one: Observed) -> Observed:
    """The observation with the twin of its first candidate in place of it."""
    return with_measured(one, measured_of(one).twin())


def stated(f: float, n: float, **changed: Any) -> Stated:
    """Engravings, 1 % and free; tape, 5 mm; steps, 1 µm; the rest exact."""
    fields: dict[str, Any] = {
        "focal_length": Uncertain(f, 0.01 * f, "mm"),
        "f_number": Uncertain(n, n),
        "size_std": 0.0,
        "range_std_mm": 1e-3,
        "range_zero_std_mm": 5.0,
        "homing_std_mm": 0.0,
        "wavelength_std": dict.fromkeys(COLOURS, 0.0),
        "reference_nm": 450.0,
    }
    return Stated(**fields | changed)


def lens_of(every: Sequence[Observed], plan: Stated, of: Laws | None = None) -> LensFit:
    """The lens of observations that all belong, with the signs that they have, under given laws: the strictest, if none."""
    return exact_lens(
        [one.reading for one in every],
        [measured_of(one) for one in every],
        np.ones(len(every), bool),
        plan,
        laws=of or Laws(),
    )


def best_focus(lens: LensFit, channel: str) -> Uncertain:
    """Best focus of a channel, mm on the rail's scale."""
    combination = lens.model.best_focus(channel)
    variance = lens.errors_of(combination[None])[0, 0]
    return Uncertain(float(combination @ lens.theta), float(np.sqrt(variance)), "mm")
