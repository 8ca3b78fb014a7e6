"""The target's surround in the photographs: whether it is as the plan states it, and clean enough to be fitted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labkit.estimation.climb import NoisePrior
from labkit.estimation.observation import Observation
from labkit.finder.cut import is_surround_even, surround_level
from labkit.findings.findings import Finding, found
from labkit.imaging.warp import Pose
from labkit.target.target import SURROUNDS, Target
from labkit.types import Bools, Floats


def is_surround_clean(
    counts: Floats,
    used: Bools,
    pose: Pose,
    target: Target,
    noise: NoisePrior,
    rounding: Floats | float = 0.0,
) -> bool:
    """Return whether pixels around a target see the surround stated, and nothing else.

    Parameters
    ----------
    counts : (rows, columns) less the dark level, where no flat shows the light
    used : (rows, columns) mask of usable pixels
    pose : of the target
    target : states the surround
    noise : of the counts; a standard error more than stated is allowed
    rounding : counts², its variance beside the read noise
    """
    if (surround := target.surround) is None:
        return False
    level = surround_level(counts, used, pose)
    if level is not None and is_contradicted(level, surround):
        surround = 1 - surround  # if that is clean, the plan is wrong: `surround_findings`
    gain = noise.gain * (1 + noise.gain_std)
    read_variance = noise.read_variance * (1 + noise.read_variance_std)
    variance = gain * np.maximum(counts, 0.0) + read_variance + rounding
    return is_surround_even(counts, used, pose, surround, variance)


def is_contradicted(level: float, surround: float) -> bool:
    """Return whether the radiance around a target is nearer to the other level than to the stated one."""
    return abs(level - surround) >= 0.5


def surround_findings(
    surround: str, target: Target, observations: Sequence[Observation]
) -> list[Finding]:
    """Report a surround that is lighter or darker in the photographs than the plan states.

    surround : as the plan names it
    """
    stated = SURROUNDS[surround]
    levels = [
        level
        for o in observations
        for frame, pose in zip(o.frames, o.poses, strict=True)
        if (
            level := surround_level(
                frame.counts / frame.illumination,
                frame.used,
                pose.of_target(target.size_mm),
            )
        )
        is not None
    ]
    if stated is None or not levels:
        return []
    seen = float(np.median(levels))
    if not is_contradicted(seen, stated):
        return []
    other = "white" if surround == "black" else "black"
    words = {"surround": surround, "other": other}
    return [found("surround-contradicted", None, words, level=seen)]
