"""Strehl ratio and MTF against defocus, and the depth of focus.

All modes but defocus stay as they are: over the depth of focus a lens's other aberrations
hardly change. Defocus is in waves RMS of Noll 4 at the reference wavelength;
`sensor_shift_um` converts to a movement of the sensor.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from scipy.interpolate import CubicSpline

from labkit.arrays import real_array
from labkit.optics.known_bias import in_any_light, widened
from labkit.optics.lens import blur_per_wave_um
from labkit.optics.mtf import Direction, azimuth_deg, modulus, nodes_for, transfer_function
from labkit.optics.strehl import Climber, Peak, brightest_tilts, mean_square
from labkit.optics.wavefront import DEFOCUS, FittedWavefront
from labkit.optics.zernike import modes_at
from labkit.types import Complexes, Floats
from labkit.uncertain import Uncertain

DEPTH = 0.8
"""Of the highest Strehl ratio, which the depth of focus keeps to: for a perfect lens Rayleigh's quarter wave. Born and Wolf,
Principles of Optics, 7th ed., §9.3."""


SPLITS_WAVES = 0.1
"""RMS in the channel's own wavelength below which the image of a point has a single peak at every defocus."""


@dataclass(frozen=True, slots=True, eq=False)
class ThroughFocus:
    """A number against defocus, (n,) each: waves RMS, value, standard error, slope by defocus.

    slopes: (modes, n) by the other modes
    """

    defocus_waves: Floats
    value: Floats
    std: Floats
    slopes: Floats
    slope: Floats


@dataclass(frozen=True, slots=True)
class FocusDepth:
    """Defocus of the highest Strehl ratio, and the limits within which the ratio is 0.8 of the highest; waves
    RMS.

    span: far less near limit, whose errors are correlated
    """

    near: Uncertain
    far: Uncertain
    highest: Uncertain
    span: Uncertain


@in_any_light
def strehl_through_focus(wavefront: FittedWavefront, defocus_waves: Floats) -> ThroughFocus:
    """Return the Strehl ratio of a wavefront with its defocus replaced by others, (n,) ascending, 0 among them.

    The maximum is followed from best focus on. If aberrations may split the image, the
    maximum is searched anew at each defocus, because the highest may change.
    """
    defocus = _grid(defocus_waves)
    rest = wavefront.without((2, 3, DEFOCUS))
    centre = int(np.argmin(np.abs(defocus)))
    rms = float(np.linalg.norm(rest.waves))
    split = rms * rest.reference_um / rest.wavelength_um > SPLITS_WAVES
    brightest = (
        [brightest_tilts(_with_defocus(rest, float(waves))) for waves in defocus]
        if split
        else []
    )
    most_tilt = max((float(np.linalg.norm(tilts)) for tilts in brightest), default=rms)
    climber = Climber(_with_defocus(rest, float(np.abs(defocus).max())), most_tilt)
    peaks: dict[int, Peak] = {}
    for k in (*range(centre, -1, -1), *range(centre + 1, len(defocus))):
        beside = peaks.get(k - 1, peaks.get(k + 1))
        starts = [np.zeros(2) if beside is None else beside.tilts, *brightest[k : k + 1]]
        ends = [
            climber.peak(np.array([*rest.waves, defocus[k]]), start) for start in starts
        ]
        peaks[k] = max(ends, key=lambda end: end.value)
    found = [peaks[k] for k in range(len(defocus))]
    full = _with_defocus(rest, 0.0)
    std = np.sqrt([mean_square(full, peak) for peak in found])
    slopes = np.array([peak.slope for peak in found]).T
    value = np.array([peak.value for peak in found])
    return ThroughFocus(defocus, value, std, slopes[:-1], slopes[-1])


@in_any_light
def mtf_through_focus(
    wavefront: FittedWavefront,
    frequency_per_mm: float,
    direction: Direction | float,
    defocus_waves: Floats,
) -> ThroughFocus:
    """Return the MTF of the optics alone at one frequency along a direction, for modes and defocus as in
    `strehl_through_focus`.
    """
    defocus = _grid(defocus_waves)
    rest = wavefront.without((2, 3, DEFOCUS))
    if not rest.rim.is_round:
        at = np.array([frequency_per_mm])
        along = azimuth_deg(direction)
        every = [
            transfer_function(_with_defocus(rest, float(waves)), at, along)
            for waves in defocus
        ]
        return _modulus(
            rest,
            defocus,
            np.array([value[0] for value, _ in every]),
            np.array([slopes[:, 0] for _, slopes in every]).T,
        )
    steepest = _with_defocus(rest, float(np.abs(defocus).max()))
    transfer = np.zeros(len(defocus), complex)
    by_mode = np.zeros((len(steepest.noll), len(defocus)), complex)
    for share, light in steepest.lights:
        apart = min(2 * abs(frequency_per_mm) / light.cutoff_per_mm, 2.0)
        area, differences = _overlap(light, apart, azimuth_deg(direction))
        factor = 1j * light.radians_per_wave
        phase = rest.waves @ differences[:-1] + np.outer(
            defocus, differences[-1]
        )  # (n, points)
        turned: Complexes = share * area * np.exp(factor * phase)
        transfer += turned.sum(axis=1)
        by_mode += factor * (differences @ turned.T)
    return _modulus(rest, defocus, transfer, by_mode)


def _modulus(
    rest: FittedWavefront, defocus: Floats, transfer: Complexes, by_mode: Complexes
) -> ThroughFocus:
    """Return the modulus of a transfer function (n,), with its derivatives (modes and defocus, n)."""
    value, slopes = modulus(transfer, by_mode)
    std = np.sqrt(rest.variance(slopes[:-1]))
    return ThroughFocus(defocus, value, std, slopes[:-1], slopes[-1])


def depth_of_focus(wavefront: FittedWavefront, curve: ThroughFocus) -> FocusDepth | None:
    """Return the depth of focus of a curve of Strehl ratios; None if the curve ends within the depth."""
    depth = _depth(wavefront, curve)
    if depth is None:
        return None
    others = [
        there
        for light in wavefront.in_possible_lights
        if (there := _depth(light, strehl_through_focus(light, curve.defocus_waves)))
    ]
    return FocusDepth(
        *(
            widened(getattr(depth, f.name), *(getattr(there, f.name) for there in others))
            for f in fields(depth)
        )
    )


def _depth(wavefront: FittedWavefront, curve: ThroughFocus) -> FocusDepth | None:
    """Return the depth in a wavefront's own light."""
    rest = wavefront.without((2, 3, DEFOCUS))
    x = curve.defocus_waves
    spline = CubicSpline(curve.defocus_waves, curve.value)
    slopes = CubicSpline(x, curve.slopes, axis=1)
    turns = [at for at in spline.derivative().roots(extrapolate=False) if spline(at, 2) < 0]
    if not turns:
        return None
    top = max(turns, key=spline)
    ends = spline.solve(DEPTH * float(spline(top)), extrapolate=False)
    near, far = ends[ends < top], ends[ends > top]
    if not (near.size and far.size):
        return None
    # of a place where S falls to a level: the slope of both by the modes, over that of S
    pulls = [
        (DEPTH * slopes(top) - slopes(end)) / float(spline(end, 1))
        for end in (float(near[-1]), float(far[0]))
    ]
    of_top = -slopes(top, 1) / float(spline(top, 2))

    def uncertain(value: float, pull: Floats) -> Uncertain:
        return Uncertain(value, float(np.sqrt(rest.variance(pull))), "waves")

    return FocusDepth(
        uncertain(float(near[-1]), pulls[0]),
        uncertain(float(far[0]), pulls[1]),
        uncertain(float(top), of_top),
        uncertain(float(far[0] - near[-1]), pulls[1] - pulls[0]),
    )


def sensor_shift_um(wavefront: FittedWavefront, defocus_waves: float) -> float:
    """Return the distance of the sensor from focus, um, for a defocus: 8 N^2 times its peak to valley."""
    per_wave = blur_per_wave_um(wavefront.f_number, wavefront.reference_um)
    return wavefront.f_number * per_wave * defocus_waves


def _grid(defocus_waves: Floats) -> Floats:
    return real_array("defocus_waves", defocus_waves, (None,), "waves RMS")


def _with_defocus(rest: FittedWavefront, waves: float) -> FittedWavefront:
    """Return a wavefront with a known defocus as its last mode."""
    count = len(rest.noll)
    known = rest.mapped((*rest.noll, DEFOCUS), np.eye(count + 1, count))
    known.waves[-1] = waves
    return known


def _overlap(
    wavefront: FittedWavefront, apart: float, azimuth: float
) -> tuple[Floats, Floats]:
    """Return (points,) weights over the overlap of two pupils, and (modes, points) the modes' differences.

    apart, azimuth: distance and direction of the pupils. The nodes are those of
    `labkit.optics.mtf`.
    """
    node, weight = np.polynomial.legendre.leggauss(nodes_for(wavefront))
    top = np.arccos(apart / 2)
    half = np.cos(top * node) - apart / 2
    area = np.outer(top * weight * np.cos(top * node) * half, weight) / np.pi
    along = np.outer(half, node)
    across = np.broadcast_to(np.sin(top * node)[:, None], area.shape)
    turn = np.deg2rad(azimuth)
    ends = [
        modes_at(
            wavefront.noll,
            (at * np.cos(turn) - across * np.sin(turn)).ravel(),
            (at * np.sin(turn) + across * np.cos(turn)).ravel(),
        )
        for at in (along + apart / 2, along - apart / 2)
    ]
    return area.ravel(), ends[0] - ends[1]
