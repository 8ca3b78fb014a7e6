"""Which arrays are kept beside results.json, of sessions of few fits and of thousands: PSFs and residuals.

Every fit keeps its PSF, and every fit its residuals while there is room. Beyond, windows of PSFs
become narrower, and residuals are kept of doubtful fits and of a sample.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import isqrt
from typing import Any

import numpy as np
import numpy.typing as npt

from labkit.optics.metrics import psf_value
from labkit.optics.wavefront import FittedWavefront
from labkit.results.model import Wavefront
from labkit.types import Floats32

PSF_SAMPLES_PER_AIRY = 6.0  # of the shortest wavelength's lambda N: three times Nyquist, fine enough to interpolate
PSF_HALF_WIDTH_AIRY = (
    32.0  # of the longest wavelength's lambda N: 0.6 % of the light lies beyond
)
LEAST_HALF_WIDTH_AIRY = 8.0  # of thousands of fits: 2.5 % of the light lies beyond
MOST_PSF_BYTES = 2**28
"""Of all PSFs, from which their windows become narrower."""

MOST_RESIDUAL_BYTES = 2**28
"""Of all residuals."""

RESIDUAL_PARTS = ("data", "model", "sigma")  # of residuals
KEPT_NUMBER = np.float32
Named = Iterator[tuple[str, npt.NDArray[Any]]]
Mapped = Callable[[Callable[[Any], Any], Sequence[Any]], Iterable[Any]]
"""`map`, or the same by several processes."""


@dataclass(frozen=True)
class PsfTask:
    """The PSF of a wavefront as a task. size: samples along a side, `spacing_um` apart."""

    wavefront: FittedWavefront
    spacing_um: float
    size: int


def psf_task(task: PsfTask) -> Floats32:
    """Return a PSF as it is kept."""
    return psf_value(task.wavefront, task.spacing_um, task.size).astype(KEPT_NUMBER)


def psfs(wavefronts: Sequence[Wavefront], mapped: Mapped = map) -> Named:
    """Yield the spacing, um, and PSFs of the optics alone on a common grid: unit sum, centred, odd. mapped: draws them."""
    airy_um = [w.wavelength_nm * 1e-3 * w.f_number for w in wavefronts]
    spacing_um = min(airy_um) / PSF_SAMPLES_PER_AIRY
    yield "spacing_um", np.array(spacing_um)
    size = psf_size(max(airy_um) / spacing_um, len(wavefronts))
    tasks = [PsfTask(w.fitted, spacing_um, size) for w in wavefronts]
    for w, psf in zip(wavefronts, mapped(psf_task, tasks), strict=True):
        yield f"psf_{w.key}", psf


def psf_size(samples_per_airy: float, fits: int) -> int:
    """Return the samples along a side of each PSF: fewer where all PSFs would take more than `MOST_PSF_BYTES`."""
    least, most = (
        2 * int(np.ceil(airy * samples_per_airy)) + 1
        for airy in (LEAST_HALF_WIDTH_AIRY, PSF_HALF_WIDTH_AIRY)
    )
    room = isqrt(MOST_PSF_BYTES // (np.dtype(KEPT_NUMBER).itemsize * fits))
    return max(least, min(most, room - (room + 1) % 2))


def residuals(wavefronts: Sequence[Wavefront]) -> Named:
    """Yield data_, model_ and sigma_ of wavefronts, (frames, planes, rows, columns)."""
    for w in with_residuals(wavefronts):
        for part in RESIDUAL_PARTS:
            yield f"{part}_{w.key}", getattr(w.residuals, part).astype(KEPT_NUMBER)


def with_residuals(wavefronts: Sequence[Wavefront]) -> list[Wavefront]:
    """Return the wavefronts whose residuals are kept, in order: all, or doubtful fits and a sample within the room."""
    have = [k for k, w in enumerate(wavefronts) if w.residuals is not None]
    doubtful = [k for k in have if _is_doubtful(wavefronts[k])]
    sound = [k for k in have if not _is_doubtful(wavefronts[k])]
    room = MOST_RESIDUAL_BYTES
    kept = []
    for k in (*doubtful, *_spread(sound)):
        room -= _bytes(wavefronts[k])
        if room < 0:
            break
        kept.append(k)
    return [wavefronts[k] for k in sorted(kept)]


def _spread(numbers: Sequence[int]) -> list[int]:
    """Return numbers in an order of which any beginning is an even sample, by van der Corput's sequence."""
    return sorted(numbers, key=lambda k: int(f"{k:032b}"[::-1], 2))


def _is_doubtful(w: Wavefront) -> bool:
    return w.test is not None and not (w.test.accepted and w.test.explains)


def _bytes(w: Wavefront) -> int:
    """Return the size of a wavefront's residuals in the file."""
    assert w.residuals is not None
    itemsize = np.dtype(KEPT_NUMBER).itemsize
    return len(RESIDUAL_PARTS) * itemsize * w.residuals.data.size
