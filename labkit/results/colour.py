"""Longitudinal colour: how far the best focus of each channel is from that of a reference channel, and what follows within a
channel."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labkit.optics.wavefront import DEFOCUS
from labkit.results.model import Focus, Lens, Wavefront
from labkit.types import Floats
from labkit.uncertain import Uncertain

REFERENCE = "G"


@dataclass(frozen=True, slots=True)
class ColourShift:
    """Best focus of a channel less that of the reference channel.

    Attributes
    ----------
    channel, reference : names of the channels
    range_shift : difference of the two ranges of best focus, mm; positive where the channel focuses farther away
    sensor_shift : how far the channel's image of a target at the reference's best focus is behind the sensor, um; None where
        no lens was estimated
    """

    channel: str
    reference: str
    range_shift: Uncertain
    sensor_shift: Uncertain | None

    @property
    def name(self) -> str:
        """The two channels, such as "R - G", with a minus sign."""
        return f"{self.channel} \N{MINUS SIGN} {self.reference}"


def longitudinal_colour(focus: Focus | None, lens: Lens | None) -> tuple[ColourShift, ...]:
    """Return the longitudinal colour of a session, with correlated errors.

    The channels of a session share ranges, focal length and f-number, so that errors of their best focus are alike: the error
    of a difference is mostly smaller than that of either.

    Parameters
    ----------
    focus : best focus of each channel, with its covariance; without one, errors count as independent
    lens : the session's lens, for shifts on the sensor

    Returns
    -------
    A shift for every channel but the reference, "G" or else the first; empty with fewer than two channels.

    Notes
    -----
    A target at range r, in a lens whose sensor is d behind the rear principal plane and whose channel focuses at r_c, has its
    image at d_c, 1/d_c - 1/d = 1/r_c - 1/r: to first order d_c - d = d^2 (1/r - 1/r_c).
    """
    if focus is None or len(focus.best_focus_mm) < 2:
        return ()
    names = list(focus.best_focus_mm)
    reference = REFERENCE if REFERENCE in names else names[0]
    return tuple(
        _shift(focus, lens, name, reference) for name in names if name != reference
    )


def _shift(focus: Focus, lens: Lens | None, name: str, reference: str) -> ColourShift:
    best, origin = focus[name], focus[reference]
    names = list(focus.best_focus_mm)
    at = [names.index(name), names.index(reference)]
    covariance = (
        np.diag([best.std**2, origin.std**2])
        if focus.covariance is None
        else focus.covariance[np.ix_(at, at)]
    )
    difference = Uncertain(best.value - origin.value, _std(covariance, 1.0, -1.0), "mm")
    on_sensor = None if lens is None else _on_sensor(best, origin, covariance, lens)
    return ColourShift(name, reference, difference, on_sensor)


def _on_sensor(
    best: Uncertain, origin: Uncertain, covariance: Floats, lens: Lens
) -> Uncertain | None:
    """Return the shift of the image, um; None where the reference has no image."""
    focal_mm, zero_mm = lens.focal_length.value, lens.range_zero.value
    near, far = origin.value + zero_mm, best.value + zero_mm
    if not min(near, far) > focal_mm:
        return None
    distance_mm = focal_mm * near / (near - focal_mm)
    scale = 1e3 * distance_mm**2
    shift = scale * (1 / near - 1 / far)
    of_ranges = _std(covariance, scale / far**2, -scale / near**2)
    of_lens = 2 * shift * lens.focal_length.std / focal_mm
    return Uncertain(shift, float(np.hypot(of_ranges, of_lens)), "um")


def _std(covariance: Floats, *gradient: float) -> float:
    slope = np.array(gradient)
    return float(np.sqrt(max(slope @ covariance @ slope, 0.0)))


def focus_slopes(wavefronts: Sequence[Wavefront]) -> dict[str, float]:
    """Return how defocus changes with the wavelength within each channel, by the channels' defocus at several stations.

    Parameters
    ----------
    wavefronts : those of one range are of one lens at one place: their defocus differs by longitudinal colour alone

    Returns
    -------
    Waves RMS of Noll mode 4, at the reference wavelength, per nm, by channel: the slope of the parabola through the defocus of
    three channels and more, of the line through that of two; means over the ranges. Channels whose sign is open, and those
    alone in their ranges, are left out.
    """
    together = defaultdict[tuple[object, ...], list[Wavefront]](list)
    for w in wavefronts:
        if w.defocus is not None and not w.sign_open:
            together[w.range_mm, w.tile].append(w)
    slopes = defaultdict[str, list[float]](list)
    for group in together.values():
        nm = np.array([w.wavelength_nm for w in group])
        different = np.unique(nm).size
        if different < 2:
            continue
        values = [w[DEFOCUS].value for w in group]
        curve = np.polynomial.Polynomial.fit(nm, values, min(different - 1, 2)).deriv()
        for w in group:
            slopes[w.channel].append(float(curve(w.wavelength_nm)))
    return {channel: float(np.mean(each)) for channel, each in slopes.items()}
