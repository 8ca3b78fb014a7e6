"""A session's lens, in each colour, carried to another range (thesis (4.40) corrected)."""

from __future__ import annotations

import numpy as np

from labkit.errors import DataError
from labkit.optics.lens import defocus_waves
from labkit.results import Results, Wavefront
from labkit.types import Floats

SAME_MM = 0.5  # ranges closer than this are that of the fit


def nearest(results: Results, channel: str, range_mm: float | None) -> Wavefront:
    """Return the wavefront of a channel measured nearest to a range. Raises DataError for a channel without one."""
    every = results.of_channel(channel)
    if not every:
        raise DataError(
            f"{results.folder}: no PSF of channel {channel}: measured are {', '.join(results.channels)}; "
            "give one of these with --channel, or --force to take another's"
        )
    if range_mm is None:
        return every[0]
    return min(
        every,
        key=lambda w: abs((w.range_mm if w.range_mm is not None else range_mm) - range_mm),
    )


def waves_at(results: Results, wavefront: Wavefront, range_mm: float | None) -> Floats:
    """Return the modes (modes,) of a wavefront carried to a range: its defocus by the lens's law, the others unchanged.

    Raises DataError where the session tells no law.
    """
    waves, at = wavefront.waves.copy(), wavefront.range_mm
    if (
        range_mm is None
        or at is None
        or abs(range_mm - at) < SAME_MM
        or 4 not in wavefront.noll
    ):
        return waves
    if results.focus is None or wavefront.channel not in results.focus.best_focus_mm:
        raise DataError(
            f"{results.folder}: best focus was not determined, so its lens cannot be carried from {at:g} to {range_mm:g} mm; "
            "give a range that was measured, or fit the photograph's own defocus with --fit-defocus"
        )
    lens = results.thin_lens
    zero = results.range_zero_mm
    if range_mm + zero <= 1.05 * lens.focal_length_mm:
        raise DataError(
            f"--range {range_mm:g}: more than the focal length is needed, {lens.focal_length_mm:.4g} mm"
        )
    focus = results.focus[wavefront.channel].value + zero
    law = defocus_waves(
        lens,
        np.array([range_mm, at]) + zero,
        focus,
        results.reference_wavelength_nm,
        results.plan.fit.convention,
    )
    waves[wavefront.noll.index(4)] += float(law[0] - law[1])
    return waves
