"""Whether the entries of results.json that belong together agree: lengths, errors, keys, scales.

Each value by itself is checked by its type, in `labkit.results.schema`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from labkit.key import Key, same_range
from labkit.plan import Plan
from labkit.results.model import refuse_no_covariance
from labkit.types import Floats

if TYPE_CHECKING:
    from labkit.results.schema import Content, WavefrontEntry

WRITTEN_ROUNDING = 1e-6
"""Relative, of numbers that a file states in two ways."""


def refuse_disagreement(content: Content, plan: Plan) -> None:
    """Raise ValueError naming the first entries of results.json that contradict one another, or the plan."""
    for problem in _problems(content, plan):
        raise ValueError(problem)


def _problems(content: Content, plan: Plan) -> Iterator[str]:
    for entry in content.wavefronts:
        yield from (f"{entry.identity.label} has {words}" for words in _of_wavefront(entry))
    yield from _keys([entry.identity for entry in content.wavefronts])
    reference_nm = content.reference_wavelength_nm
    if (
        content.plan is not None
        and reference_nm is not None
        and not _close(reference_nm, plan.reference_wavelength_nm)
    ):
        yield (
            f"reference_wavelength_nm = {reference_nm:g}: the plan in it has {plan.reference_wavelength_nm:g}"
        )


def _of_wavefront(entry: WavefrontEntry) -> Iterator[str]:
    """Yield what a wavefront has that contradicts something else of it."""
    yield from _lengths(entry)
    if entry.covariance is not None:
        refuse_no_covariance(f"the covariance of {entry.identity.label}", entry.covariance)
        if not _close(entry.std**2, np.diagonal(entry.covariance)):
            yield "std other than the roots of its covariance's diagonal"
    if entry.key is not None and not (
        entry.key.channel == entry.channel
        and same_range(entry.key.range_mm, entry.range_mm)
    ):
        yield f"the key of {entry.key.label}"
    if entry.lambda_n is None or entry.f_number is None:
        return
    product = 1e-3 * entry.wavelength_nm * entry.f_number
    if not _close(entry.lambda_n.value, product):
        yield (
            f"lambda_n_um = {entry.lambda_n.value:g}; its wavelength times its f-number is {product:g}"
        )


def _lengths(entry: WavefrontEntry) -> Iterator[str]:
    """Yield lists whose length contradicts the number of modes, or of photographs."""
    modes = len(entry.noll)
    by_mode = {"waves_rms": entry.waves, "std": entry.std, "pulls": entry.pulls}
    if entry.test is not None:
        by_mode |= {
            f"global_test.others.{k}.waves_rms": other.waves
            for k, other in enumerate(entry.test.others)
        }
    for name, values in by_mode.items():
        if values is not None and values.shape != (modes,):
            yield f"{values.size} numbers in {name} for {modes} modes"
    if entry.covariance is not None and entry.covariance.shape != (modes, modes):
        yield f"a covariance of shape {entry.covariance.shape} for {modes} modes"
    if entry.poses is None:
        return
    photographs = len(entry.poses)
    by_photograph = {"frames": entry.frames, "corners_px": entry.corners_px}
    for name, held in by_photograph.items():
        if held is not None and len(held) not in (0, photographs):
            yield f"{len(held)} {name} and {photographs} poses"


def _keys(keys: Sequence[Key]) -> Iterator[str]:
    """Yield keys that several wavefronts have."""
    known = set[Key]()
    for key in keys:
        if key in known:
            yield f"two wavefronts are of {key.label}"
        known.add(key)


def _close(stated: float | Floats, other: float | Floats) -> bool:
    return bool(np.allclose(stated, other, rtol=WRITTEN_ROUNDING, atol=0, equal_nan=True))
