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


@pytest.mark.parametrize("clipped_share", [0.3, 1.0])
@pytest.mark.parametrize("pattern", [("M",), ("RG", "GB")])
def test_light_clipped_below_the_stated_white_level_is_named(
    clipped_share: float, pattern: tuple[str, ...]
) -> None:
    rng = np.random.default_rng(2)
    ramp = np.linspace(0.0, 2400 / (1 - 0.99 * clipped_share), 200) + 500
    if clipped_share == 1.0:
        ramp[:] = 9000.0
    counts = np.clip(ramp + rng.normal(0, 8, (160, 200)), 0, 2600).astype(np.uint16)
    seen = Photograph(counts, np.full((2, 2), 256.0), 4095.0, pattern)
    problem = exposure_problem(seen, "flat", "M" if pattern == ("M",) else "RGB") or ""
    assert "is clipped" in problem
    assert "are 2600, below the white level of 4095" in problem


@pytest.mark.parametrize("noise", [0.0, 0.4, 1.5, 20.0])
def test_an_even_light_of_any_noise_is_not_called_clipped(noise: float) -> None:
    rng = np.random.default_rng(3)
    light = np.full((160, 200), 100.0)
    light[40:120, 40:160] = 2000.0
    counts = np.clip(light + rng.normal(0, noise, light.shape), 0, 4095).astype(np.uint16)
    seen = Photograph(counts, np.full((2, 2), 20.0), 4095.0, ("M",))
    assert exposure_problem(seen, "target", "M") is None
