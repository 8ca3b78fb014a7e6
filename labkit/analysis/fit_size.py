"""The size of a fit before it begins, for the time that it will take."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labkit.analysis.observe import selected
from labkit.optics.lens import ThinLens, ground_sample_mm
from labkit.plan import Plan
from labkit.session.frame import Frame

USUAL_TARGET_PX = 120.0
"""Side of a target of which nothing says how large its picture is."""

PIXELS_LIKE_A_FIT = 1e5
"""Pixels of the target that take as long as what each fit takes whatever the target's size: a range of 222 pixels and two
photographs takes as long as one of 62 pixels and one photograph, and larger ones more."""

USUAL_S = 2.0
"""Seconds of one processor for a fit of few pixels, where the plan describes the session: measured 1.1 and 2.7."""


def fit_size(
    frames: Sequence[Frame],
    plan: Plan,
    ranges_mm: float | Sequence[float] | None,
    channels: str | Sequence[str] | None,
    workers: int,
) -> float:
    """Return the number of fits that each process makes, a fit of many pixels for more.

    Raises DataError where there is nothing to fit.
    """
    photographs, names = selected(frames, plan, ranges_mm, channels)
    ranges = {frame.range_mm for frame in photographs}
    pixels = sum(target_px(plan, frame.range_mm) ** 2 for frame in photographs)
    fits = len(ranges) * len(names)
    return (fits + pixels * len(names) / PIXELS_LIKE_A_FIT) / min(workers, fits)


def target_px(plan: Plan, range_mm: float | None) -> float:
    """Return the side of the target's picture in pixels, as plan and range have it."""
    if plan.target.corners_px is not None:
        return float(np.ptp(plan.target.corners_px, axis=0).max())
    if range_mm is None or range_mm <= plan.lens.focal_length_mm:
        return USUAL_TARGET_PX
    lens = ThinLens(plan.lens.focal_length_mm, plan.lens.f_number)
    sample_mm = float(ground_sample_mm(lens, range_mm, plan.sensor.pixel_pitch_um))
    return plan.target.size_mm / sample_mm
