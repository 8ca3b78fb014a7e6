"""Fit a wavefront to photographs in memory, without session or folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from labkit.analysis.session_results import as_wavefront
from labkit.analysis.surround import is_surround_clean
from labkit.analysis.target_tiles import middle_part, target_parts
from labkit.analysis.tile_registration import bends_of_parts, register_part
from labkit.arrays import mask_array, positive, real_array
from labkit.calibration.photon_transfer import (
    UNKNOWN_NOISE_STD,
    usual_gain,
    usual_read_variance,
)
from labkit.errors import DataError
from labkit.estimation.climb import NoisePrior
from labkit.estimation.estimate import LocalFit
from labkit.estimation.likelihood import FrameData, low_orders
from labkit.estimation.local import Guesses, Views, find_optima
from labkit.estimation.observation import Observation
from labkit.finder.cut import cut_around, cut_within, sees_target_only
from labkit.finder.find_target import find_target
from labkit.finder.picture import Picture
from labkit.imaging.optics import Optics
from labkit.imaging.warp import Pose
from labkit.jobs.threads import one_thread
from labkit.plan import FieldSettings
from labkit.plan.sensor import ChannelPixels, channel_pixels, pattern_of
from labkit.results import Wavefront
from labkit.target.target import Target
from labkit.types import Bools, Floats

GIVEN_NOISE_STD = 0.05  # relative error of a gain and a read variance that the caller gives: priors of the fit


@one_thread
def fit_image(
    counts: ArrayLike,
    target: Target,
    optics: Optics,
    *,
    cfa_pattern: str = "mono",
    channel: str = "M",
    mask: ArrayLike | None = None,
    corners_px: ArrayLike | None = None,
    mm_per_pixel: float | None = None,
    gain: float | None = None,
    read_noise: float | None = None,
) -> Wavefront:
    """Fit the wavefront of one colour to photographs in memory, of a target at one range.

    Uneven illumination is estimated, for there are no flats. Of two twins, the returned one has a positive largest even mode.
    Of a target wider than 360 pixels one tile is fitted, that nearest to its middle where it has detail: a session has all.

    Parameters
    ----------
    counts : (rows, columns) or (frames, rows, columns), black level removed, nothing demosaiced
    target : the target that the photographs show
    optics : lens, light and sensor; the f-number is held
    cfa_pattern : "mono", or the 2 × 2 cell row by row, such as "RGGB"
    channel : the colour to fit
    mask : of the shape of `counts`, True for good pixels
    corners_px : (4, 2) or (frames, 4, 2) [row, column] of the target's corners; None to search for the target
    mm_per_pixel : approximate size of a pixel on the target
    gain, read_noise : counts per electron, and counts; estimated from the photographs if None

    Raises
    ------
    ValueError
        An array has another shape.
    TargetError
        A photograph does not show the target.
    DataError
        No usable pixel shows the target, or the counts are no photograph's.

    >>> w = labkit.fit_image(counts, labkit.open_target("sierpinski:order=4,size_mm=15.6"), optics)
    """
    shape = np.shape(counts)
    if len(shape) not in (2, 3):
        raise ValueError(
            f"counts has shape {shape}; (rows, columns) or (frames, rows, columns) is needed (counts)"
        )
    images = real_array("counts", counts, None, "counts").reshape(-1, *shape[-2:])
    good = np.ones(images.shape, bool)
    if mask is not None:
        good = mask_array("mask", np.reshape(mask, images.shape), images.shape)
    pattern = pattern_of(cfa_pattern)
    corners = _corners(images, pattern, target, corners_px, mm_per_pixel)
    pixels = channel_pixels(pattern, channel)
    noise = _noise(images, gain, read_noise)
    observation = _observation(images, good, target, corners, channel, pixels, noise)
    views = Views(observation.frames, observation.poses, noise)
    found = find_optima(optics, target, views, Guesses(deep=True, alone=True))
    return as_wavefront(LocalFit(observation, found.best.canonical(), found))


def _observation(
    images: Floats,
    good: Bools,
    target: Target,
    corners: Sequence[Floats],
    channel: str,
    pixels: ChannelPixels,
    noise: NoisePrior,
) -> Observation:
    """Return the frames, cut to the target."""
    shape = images.shape[1], images.shape[2]
    parts = target_parts(corners, FieldSettings(), target, shape)
    part = middle_part(parts) if parts else None
    bend = None
    rows, columns = cut_around(corners, shape)
    if part is not None:
        inside = [part.corners(Pose.from_corners(c, target.size_mm)) for c in corners]
        rows, columns = cut_within(inside, shape)
        registered = {
            each: [
                register_part(image, pixels.period, target, each, c)
                for image, c in zip(images, corners, strict=True)
            ]
            for each in parts
        }
        corners = registered[part]
        bend = bends_of_parts(shape, target.size_mm, registered).get(part)
    cut = images[:, rows, columns]
    usable = good[:, rows, columns] & pixels.mask(cut.shape[1:])
    poses = tuple(
        Pose.from_corners(c, target.size_mm).shifted(rows.start, columns.start)
        for c in corners
    )
    return Observation(
        range_mm=None,
        measured_range_mm=None,
        channel=channel,
        names=(),
        frames=tuple(
            _frame(*of_frame, target, noise)
            for of_frame in zip(cut, usable, poses, strict=True)
        ),
        poses=poses
        if part is None
        else tuple(replace(part.of(pose), bend=bend) for pose in poses),
        noise=noise,
        places=pixels.places,
        period=pixels.period,
        origin_px=(rows.start, columns.start),
    )


def _corners(
    images: Floats,
    pattern: Sequence[str],
    target: Target,
    given: ArrayLike | None,
    mm_per_pixel: float | None,
) -> list[Floats]:
    """Return the target's corners (4, 2) in each frame, given or found by a search."""
    if given is not None:
        corners = np.asarray(given, float)
        corners = np.broadcast_to(corners, (len(images), *corners.shape[-2:]))
        return list(real_array("corners_px", corners, (len(images), 4, 2), "pixels"))
    return [
        find_target(Picture(image, pattern), target, mm_per_pixel=mm_per_pixel)
        for image in images
    ]


def _frame(
    image: Floats, used: Bools, pose: Pose, target: Target, noise: NoisePrior
) -> FrameData:
    if not is_surround_clean(image, used, pose, target, noise):
        used = used & sees_target_only(pose, used.shape)
    if not used.any():
        raise DataError("no usable pixel on the target: look at mask and corners_px")
    one = np.ones(image.shape)
    return FrameData(image, used, one, 0 * one, departures=low_orders(*image.shape))


def _noise(images: Floats, gain: float | None, read_noise: float | None) -> NoisePrior:
    """Return a prior for the noise from the caller's numbers, or a wide prior without them."""
    white = float(np.percentile(images, 99.5))
    if white <= 0:
        raise DataError(
            f"counts up to {white:g} are no photograph: give them with the black level removed"
        )
    return NoisePrior(
        usual_gain(white)
        if gain is None
        else positive("gain", gain, "counts per electron"),
        UNKNOWN_NOISE_STD if gain is None else GIVEN_NOISE_STD,
        usual_read_variance(white)
        if read_noise is None
        else positive("read_noise", read_noise, "counts") ** 2,
        UNKNOWN_NOISE_STD if read_noise is None else GIVEN_NOISE_STD,
    )
