"""Whether a photograph that was just taken can be used: readable, of the same camera as the others, well exposed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labkit.errors import DataError, InputError, RawError
from labkit.lab.raw import Mosaic, read_raw
from labkit.lab.session import Kind
from labkit.plan import Plan

BRIGHTEST = 0.01
"""Share of a channel's pixels that may be brighter than the level that is judged: hot pixels and glints."""

FULL, FAINT, LEAK = 0.99, 0.04, 0.02
"""Shares of full scale: the brightest may not be above, the white not below, a dark frame's middle not above."""


class FrameCheck:
    """Judges photographs of one session, one after another."""

    def __init__(self, plan: Plan, exposure_s: float) -> None:
        self._plan = plan
        self._exposure_s = exposure_s
        self._like: tuple[str, tuple[int, ...], str] | None = None

    def learn(self, path: Path) -> None:
        """Take an accepted photograph as the one that all others must resemble."""
        self._like = _likeness(read_raw(path, self._plan.sensor))

    def problem(self, path: Path, kind: Kind, range_mm: float | None) -> InputError | None:
        """Why the photograph is useless, as the error to raise; None if it is good."""
        what = kind if range_mm is None else f"{kind} at {range_mm:g} mm"
        try:
            mosaic = read_raw(path, self._plan.sensor)
        except RawError as error:
            return error
        likeness = _likeness(mosaic)
        self._like = self._like or likeness
        if likeness != self._like:
            return RawError(f"the {what} is {_words(likeness)}; the session's frames are {_words(self._like)}")
        for channel in self._plan.channel:
            try:
                shares = _share_of_scale(mosaic, channel.name)
            except RawError as error:
                return error
            if fault := self._misexposed(shares, kind):
                return DataError(f"the {what} is {fault} in channel {channel.name}; then go on with --resume")
        return None

    def _misexposed(self, shares: NDArray[np.float64], kind: Kind) -> str | None:
        middle, bright = np.quantile(shares, [0.5, 1 - BRIGHTEST])
        if kind == "dark" and middle > LEAK:
            return f"at {middle:.0%} of full scale: light leaks in; cover the lens"
        if kind in ("flat", "target") and bright > FULL:
            return (
                f"overexposed at {self._exposure_s:g} s: over {BRIGHTEST:.0%} of its pixels are full; dim the display"
            )
        if kind in ("flat", "target") and bright < FAINT:
            return f"too dark at {self._exposure_s:g} s: white reaches {bright:.1%} of full scale; brighten the display"
        return None


def _share_of_scale(mosaic: Mosaic, channel: str) -> NDArray[np.float64]:
    """A channel's pixels on a scale from black, 0, to full, 1."""
    mask, black = mosaic.channel_mask(channel), mosaic.black_map()
    return np.asarray((mosaic.counts[mask] - black[mask]) / (mosaic.white - black[mask]), dtype=np.float64)


def _likeness(mosaic: Mosaic) -> tuple[str, tuple[int, ...], str]:
    return mosaic.camera, mosaic.counts.shape, mosaic.cfa


def _words(likeness: tuple[str, tuple[int, ...], str]) -> str:
    camera, shape, cfa = likeness
    return f"{shape[0]} × {shape[1]} {cfa} of {camera or 'an unnamed camera'}"
