"""Reduce flats of the white display: each range's illumination, the lens's fall-off, and the response of single pixels.

Illumination is smooth and belongs to a range. Response belongs to the sensor and is
averaged over all ranges' flats. The lens's fall-off, symmetric about the middle of the
frame or of a small part of it, multiplies the blurred image; the target's illumination is
blurred with the target.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labkit.calibration.darks import Dark
from labkit.calibration.masters import (
    Illumination,
    clipped_mean,
    display_around,
    joined_to,
    outliers,
    shrunk,
    smooth_illumination,
)
from labkit.calibration.needed import EVERYTHING, Needed
from labkit.calibration.photon_transfer import ROUNDING_VARIANCE, NoiseEstimate, Scatter
from labkit.calibration.stack import Stack
from labkit.findings.findings import Finding, flats_partly_unlit, found
from labkit.panel.pattern_in_flats import repeating
from labkit.photographs.photograph import WHOLE, Cut, Photograph, overlap
from labkit.types import Bools, Floats, Floats32, Indices

LEAST_DEFECT = 0.05
"""A pixel whose response is nearer than this to its neighbours' is no defect, however well it is measured."""

LEAST_LIT_BETWEEN = 0.2
"""Least light of a pixel between a panel's pixels, as a share of its surroundings', for which its response is determined."""

NEAR_PX = 3.0
"""Pixels of a plane: over so little light is smoothed where a panel is near enough to show its pixels. Its unevenness shows
too; the noise of the mean, a tenth of a pixel's, counts for nothing beside that of a photograph."""

PASSES = 8
"""Of light and the panel's pattern, at most, each found beside the other: where a tenth of the pixels are full they need
as many."""


@dataclass(frozen=True, slots=True, eq=False)
class Flat:
    """The flats of one range, NaN beyond the pixels that the range needs.

    frames: their number; illumination: (rows, cols), mean 1 in each channel, NaN where
    unlit; mean: (rows, cols) counts above dark, NaN where saturated; places: planes of each
    channel; level: counts at illumination 1 in each channel; scatter: from frame to frame,
    of each channel; unlit: share of the targets' pixels without light. panel: (rows, cols)
    relative brightness of each pixel against its surroundings that the panel's own pixels
    cause, NaN where too dark; None if the panel's pixels are not resolved.
    """

    frames: int
    illumination: Floats32
    mean: Floats32
    places: Mapping[str, tuple[Cut, ...]]
    level: Mapping[str, float]
    scatter: Mapping[str, tuple[Scatter, ...]]
    unlit: float
    panel: Floats32 | None


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """(rows, cols) pixels' gain relative to their neighbours', its posterior standard deviation, and the dead pixels."""

    relative: Floats32
    relative_std: Floats32
    dead: Bools


def reduce_flats(
    stack: Stack,
    names: Sequence[str],
    dark: Dark | None,
    box: Cut = WHOLE,
    needed: Needed = EVERYTHING,
) -> Flat:
    """Return the smooth illumination, mean 1 in each channel; two greens keep their ratio.

    names: of the channels; box: of the frame, which the dark shows and the result will,
    the stack's within; needed: by which the stack was cut
    """
    first = stack.first
    box = overlap(box, first.frame_box)
    here = first.slices(first.box, box)
    offset = first.black_map if dark is None else dark.offset[here]
    good = ~stack.saturated if dark is None else dark.usable[here] & ~stack.saturated
    mean = clipped_mean(stack.counts) - offset
    target = needed.target_mask(first)
    display = _display(mean, good, target, first) if needed.outlines else None
    illumination = np.full(mean.shape, np.nan, dtype=np.float32)
    places = {}
    levels = {}
    panel = np.ones(mean.shape, dtype=np.float32)
    for name in names:
        places[name] = stack.first.planes(name)
        found = [
            _light_and_panel(
                mean[plane],
                good[plane],
                stack.saturated[plane],
                None if display is None else display[plane],
            )
            for plane in places[name]
        ]
        smooth = [light for light, _ in found]
        for plane, (_, pattern) in zip(places[name], found, strict=True):
            panel[plane] += pattern
        levels[name] = float(np.mean([part.level for part in smooth]))
        for plane, part in zip(places[name], smooth, strict=True):
            illumination[plane] = np.where(
                part.lit, part.relative * part.level / levels[name], np.nan
            )
    mean[stack.saturated] = np.nan
    seen = bool(np.any(panel != 1))
    panel[panel < LEAST_LIT_BETWEEN] = np.nan
    lit = np.isfinite(illumination)
    where = {name: first.channel_mask(name) & lit & ~stack.saturated for name in names}
    scatter = {name: tuple(stack.scatter(where[name], offset, lit=True)) for name in names}
    lit_shares = [
        np.mean(lit[plane][target[plane]]) for of in places.values() for plane in of
    ]
    shape = stack.first.array_shape(box)
    return Flat(
        len(stack.counts),
        _placed(illumination, here, shape),
        _placed(mean.astype(np.float32), here, shape),
        places,
        levels,
        scatter,
        1 - float(np.mean(lit_shares)),
        _placed(panel, here, shape) if seen else None,
    )


def _placed(part: Floats32, here: Cut, shape: tuple[int, int]) -> Floats32:
    """Return an array that holds a part at these slices, and NaN elsewhere."""
    if part.shape == shape:
        return part
    whole = np.full(shape, np.nan, dtype=np.float32)
    whole[here] = part
    return whole


def _display(mean: Floats, good: Bools, target: Bools, first: Photograph) -> Bools:
    """Return the pixels (rows, cols) that the display around the targets lights in each colour: a room may be as bright in one.

    mean: flat; target: pixels that see one; first: photograph of the same box
    """
    display = np.ones(mean.shape, dtype=np.bool_)
    for plane in first.every_plane:
        found = display_around(mean[plane], good[plane], target[plane])
        for (
            other
        ) in first.every_plane:  # an odd row or column at the end has no cell of its own
            rows, cols = np.minimum(found.shape, display[other].shape)
            display[other][:rows, :cols] &= found[:rows, :cols]
    return joined_to(target, display)


def _light_and_panel(
    flat: Floats, good: Bools, full: Bools, lit: Bools | None
) -> tuple[Illumination, Floats]:
    """Return a plane's smooth light, and the pattern (rows, cols) of the panel's own pixels, mean 0.

    The pattern is zero if there is none. flat: (rows, cols) counts; full: saturated pixels,
    not good; lit: by the display, None where that is to be found.
    """
    light = smooth_illumination(flat, good, lit=lit)
    pattern = np.zeros(flat.shape)
    filled = flat
    for _ in range(PASSES):
        smooth = np.where(light.lit, light.relative * light.level, 1.0)
        more = repeating(filled / smooth - 1 - pattern, (good | full) & light.lit)
        if more is not None:
            pattern += more
        elif not (full & (pattern != 0)).any():
            break
        # the brightest of a pattern may be full: without them light would be too low, so they are what it and pattern say
        filled = np.where(full, np.maximum(flat, smooth * (1 + pattern)), flat)
        # a difference errs as the pattern does, to and fro; a quotient would err to one side
        light = smooth_illumination(filled - smooth * pattern, good | full, lit=lit)
    if pattern.any():
        light = smooth_illumination(
            filled / (1 + np.maximum(pattern, LEAST_LIT_BETWEEN - 1)),
            good | full,
            NEAR_PX,
            lit,
        )
    return light, pattern


def pixel_response(flats: Sequence[Flat], noise: Mapping[str, NoiseEstimate]) -> Response:
    """Return the pixel response from the flats of all ranges; 1 in channels of unknown noise."""
    shape = flats[0].mean.shape
    relative = np.ones(shape, dtype=np.float32)
    std = np.zeros(shape, dtype=np.float32)
    dead = np.zeros(shape, dtype=np.bool_)
    for name, planes in flats[0].places.items():
        if noise[name].gain is None:
            continue  # without the noise a pixel's response cannot be separated from it
        for plane in planes:
            ratio, weights = _mean_ratio(flats, plane, name, noise[name])
            shown = weights > 0
            dead[plane] = outliers(ratio, shown, least=LEAST_DEFECT)
            good = shown & ~dead[plane]
            relative[plane][good], posterior = shrunk(ratio[good], 1 / weights[good])
            std[plane] = relative[plane][
                good
            ].std()  # of a pixel that no flat shows, no more is known
            std[plane][good] = posterior
    return Response(relative, std, dead)


def flat_findings(
    flats: Mapping[float | None, Flat], noise: Mapping[str, NoiseEstimate]
) -> Iterable[Finding]:
    """Return the assumptions about light and pixels made for missing flats, by range."""
    if not flats:
        yield found("no-flat-frames")
        return
    for range_mm, flat in flats.items():
        if flat.unlit > 0.01:
            yield flats_partly_unlit(range_mm, flat.unlit)
    if any(estimate.gain is None for estimate in noise.values()):
        yield found("gain-not-measured")


def _mean_ratio(
    flats: Sequence[Flat], plane: Cut, name: str, noise: NoiseEstimate
) -> tuple[Floats, Floats]:
    """Return measured over expected counts of a plane's pixels, averaged over flats, and its inverse variance."""
    shape = flats[0].mean[plane].shape
    weighted = np.zeros(shape)
    weights = np.zeros(shape)
    floor = (noise.read_noise or 0.0) ** 2 + ROUNDING_VARIANCE
    for flat in flats:
        expected = flat.illumination[plane].astype(np.float64) * flat.level[name]
        if flat.panel is not None:
            expected *= flat.panel[plane]
        weight = np.nan_to_num(
            flat.frames * expected**2 / ((noise.gain or 0.0) * expected + floor)
        )
        weight[np.isnan(flat.mean[plane] + expected)] = 0.0
        weighted += weight * np.nan_to_num(flat.mean[plane] / expected)
        weights += weight
    return np.where(weights > 0, weighted / np.maximum(weights, 1e-300), 1.0), weights


FALLOFF_SAMPLES = 100  # along each side of the frame: light is smooth

LARGE_BOX = 0.5
"""Of a frame's diagonal: in a smaller box the light of the flats is that of a target in a room, and is round about the
target, if about anything. A lens's fall-off from the middle of the frame varies little over so small a part, and where it
is a slope, no flat of a display tells it from the display's own; `Brightness.growth_std` holds that."""


@dataclass(frozen=True, slots=True)
class Falloff:
    """ln of the lens's share of the light: a r^2 + b r^4, r from 0 in the middle to 1 in the corners of a box.

    box: rows and columns in the frame; powers: (a, b).
    """

    box: Cut
    powers: tuple[float, float]

    @classmethod
    def of(
        cls, illumination: Floats32, shape: tuple[int, int], box: Cut = WHOLE
    ) -> Falloff:
        """Fit the fall-off to the relative illumination in a box of a frame, NaN where unlit, by least squares.

        It is round about the middle of the frame (rows, columns), or of a box that is much
        smaller. illumination: evenly spread over the box, such as (rows, columns), or (rows,
        3 columns) of a picture in colours.
        """
        frame = slice(0, shape[0]), slice(0, shape[1])
        box = overlap(box, frame)
        round_in = frame if _diagonal(box) > LARGE_BOX * _diagonal(frame) else box
        places = [
            np.unique(np.linspace(0, n - 1, FALLOFF_SAMPLES).round().astype(int))
            for n in illumination.shape
        ]
        rows, columns = (
            side.start + at // (n // (side.stop - side.start))
            for at, n, side in zip(places, illumination.shape, box, strict=True)
        )
        seen = illumination[np.ix_(*places)].astype(np.float64)
        r2 = _square(round_in, rows, columns)
        lit = seen > 0
        terms = np.stack([np.ones(lit.sum()), r2[lit], r2[lit] ** 2], axis=1)
        _, a, b = np.linalg.lstsq(terms, np.log(seen[lit]), rcond=None)[0]
        return cls(round_in, (float(a), float(b)))

    def at(self, cut: Cut) -> Floats:
        """Return the (rows, columns) relative light of a cut of the frame, 1 in the middle of the box."""
        rows, columns = (np.arange(part.start, part.stop) for part in cut)
        r2 = _square(self.box, rows, columns)
        return np.asarray(np.exp(self.powers[0] * r2 + self.powers[1] * r2**2))


def _diagonal(box: Cut) -> float:
    return float(np.hypot(*(side.stop - side.start for side in box)))


def _square(box: Cut, rows: Indices, columns: Indices) -> Floats:
    """Return r^2 for all pairs of rows and columns of a frame."""
    middle = [(side.start + side.stop - 1) / 2 for side in box]
    corner = sum(((side.stop - side.start - 1) / 2) ** 2 for side in box)
    away = (rows[:, None] - middle[0]) ** 2 + (columns[None, :] - middle[1]) ** 2
    return np.asarray(away / max(corner, 1.0))
