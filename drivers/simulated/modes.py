"""The lens's fixed aberration: stated and drawn modes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labkit.drivers.simulated.world import HIGHER_MODES, TrueLens

Modes = dict[str, dict[int, float]]
"""Of each colour, {Noll mode: waves RMS at REFERENCE_NM}."""


def drawn_modes(
    lens: TrueLens, rng: np.random.Generator, higher: np.random.Generator
) -> Modes:
    """Return the modes of every colour, in Noll's order; `higher` draws modes of the higher orders.

    If a mode is drawn twice the usual draw counts, and a stated mode is as stated.
    """
    usual = _random_modes(lens, lens.noll, lens.aberration_waves, rng)
    modes = usual
    if lens.higher_waves:
        beyond = _random_modes(lens, HIGHER_MODES, lens.higher_waves, higher)
        modes = {colour: beyond[colour] | usual[colour] for colour in usual}
    stated = dict(lens.stated_waves)
    return {colour: dict(sorted((own | stated).items())) for colour, own in modes.items()}


def _random_modes(
    lens: TrueLens, noll: Sequence[int], waves_rms: float, rng: np.random.Generator
) -> Modes:
    """Return modes of an RMS in every colour, largely common to all colours."""
    shared = rng.normal(size=len(noll))
    modes = Modes()
    for colour in lens.wavelength_nm:
        own = shared + lens.colour_share * rng.normal(size=shared.size)
        amounts = own * waves_rms / np.linalg.norm(own)
        modes[colour] = dict(zip(noll, amounts.tolist(), strict=True))
    return modes
