"""Light is judged where the target is."""

from __future__ import annotations

import numpy as np
import pytest

from labkit.photographs.exposure import exposure_problem
from labkit.photographs.photograph import Photograph
from labkit.types import Counts

PLACE = slice(100, 160), slice(100, 160)


def photographed(target: float, window: float) -> Photograph:
    """A target of two halves in a room with a window, counts of full scale 4095 over black at 100, with noise."""
    rng = np.random.default_rng(1)
    light = np.full((200, 300), 400.0)
    light[:80] = window
    light[100:160, 100:130] = target
    light[100:160, 130:160] = 0.0
    counts: Counts = np.clip(100 + light + rng.normal(0, 3, light.shape), 0, 4095).astype(
        np.uint16
    )
    return Photograph(counts, np.full((2, 2), 100.0), 4095.0, ("RG", "GB"))


def test_a_window_beside_the_target_may_be_overexposed() -> None:
    seen = photographed(target=2500.0, window=9000.0)
    assert "is overexposed" in (exposure_problem(seen, "target", "RGB") or "")
    assert exposure_problem(seen, "target", "RGB", PLACE) is None


@pytest.mark.parametrize(("target", "words"), [(9000.0, "overexposed"), (0.0, "is black")])
def test_a_target_of_wrong_light_is_refused_whatever_is_around(
    target: float, words: str
) -> None:
    seen = photographed(target=target, window=2000.0)
    assert words in (exposure_problem(seen, "target", "RGB", PLACE) or "")
