"""The true lens of the simulated bench: Zernike modes, defocus against range, pupils, diffraction.

Written without labkit.optics and labkit.imaging, which it tests.

Conventions. Pupil coordinates (u right, v down) run as columns and rows do on the sensor;
theta is measured from u towards v. The field is ``g(x) = sum A(w) exp(2 pi i phi(w)) exp(-2
pi i w.x)``, the transform of the pupil as in the diffraction integral: a path that grows to
the right moves light to the right. The wavefront ``phi`` is in waves of the light's own
length. Defocus (Noll 4) is positive for a target beyond best focus.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import factorial, sqrt

import numpy as np
import scipy.fft
from numpy.polynomial.polynomial import polyval

from labkit.drivers.simulated.pupil import RIM_REACH, ROUND_PUPIL, SPIKES, Pupil
from labkit.types import Floats, Floats32

REFERENCE_NM = 450.0
"""Wavelength in whose waves the bench counts optical paths."""

RIM_RAYS = 256
"""Number of rays from the pupil's rim: 14 to the shortest period of Noll 37."""


def noll_to_nm(j: int) -> tuple[int, int]:
    """Return radial order n and azimuthal order m of Noll's mode j; m < 0 for the sine modes.

    Raises ValueError for j < 1.
    """
    if j < 1:
        raise ValueError(f"Noll's modes are counted from 1, not {j}")
    n = 0
    while (n + 1) * (n + 2) // 2 < j:
        n += 1
    place = j - n * (n + 1) // 2 - 1
    m = 2 * ((place + 1) // 2) if n % 2 == 0 else 2 * (place // 2) + 1
    return n, m if j % 2 == 0 else -m


def zernike(j: int, u: Floats, v: Floats) -> Floats:
    """Return Noll's mode j, unit RMS over the disc, at pupil coordinates (u right, v down). Shapes as given;
    unitless.

    Thesis (2.39)-(2.41), (2.40) corrected: (n - k)! in the radial polynomial.
    """
    return wavefront({j: 1.0}, u, v)


def wavefront(waves: Mapping[int, float], u: Floats, v: Floats) -> Floats:
    """Return the path of Noll's modes {mode: waves RMS} at pupil coordinates (u right, v down), waves. Shapes
    as given.

    Modes of one azimuthal order m share r^m cos(m theta) and r^m sin(m theta), and are
    summed as polynomials of r^2.
    """
    by_order: dict[int, Floats] = {}
    for mode, amount in waves.items():
        m, powers = _radial(mode)
        total = by_order.setdefault(m, np.zeros(0))
        wide = np.zeros(max(total.size, powers.size))
        wide[: total.size] = total
        wide[: powers.size] += amount * powers
        by_order[m] = wide
    squared = u * u + v * v
    path = np.zeros_like(squared)
    for m, powers in by_order.items():
        turn = (u + 1j * v) ** abs(m)
        path += polyval(squared, powers) * (turn.imag if m < 0 else turn.real)
    return path


def farthest_ray_um(
    waves: Mapping[int, float],
    f_number: float,
    rim: float = 1.0,
    reference_nm: float = REFERENCE_NM,
) -> float:
    """Return the distance from the PSF's centre, um, of the farthest ray from the pupil's rim: 2 N times the
    path's slope.

    waves: {Noll mode: waves RMS at reference_nm}; f_number: of the cone at the sensor; rim:
    radius of the rim over that of the disc on which the modes are defined.
    """
    theta = np.linspace(0, 2 * np.pi, RIM_RAYS, endpoint=False)
    right, down = rim * np.cos(theta), rim * np.sin(theta)
    step = 1e-4

    def slope(u: float, v: float) -> Floats:
        ahead = wavefront(waves, right + u, down + v)
        return (ahead - wavefront(waves, right - u, down - v)) / (2 * step)

    steepest = float(np.max(np.hypot(slope(step, 0.0), slope(0.0, step))))
    return 2 * f_number * steepest * reference_nm * 1e-3


def _radial(j: int) -> tuple[int, Floats]:
    """Return the azimuthal order of Noll's mode j, and its radial polynomial over r^|m|, by powers of r^2."""
    n, signed = noll_to_nm(j)
    m = abs(signed)
    half = (n - m) // 2
    powers = np.zeros(half + 1)
    for k in range(half + 1):
        weight = (-1) ** k * factorial(n - k) / factorial(k)
        powers[half - k] = weight / (factorial((n + m) // 2 - k) * factorial(half - k))
    return signed, powers * sqrt(n + 1 if m == 0 else 2 * (n + 1))


def defocus_waves(
    range_mm: float,
    best_focus_mm: float,
    focal_length_mm: float,
    f_number: float,
    pupil_magnification: float,
    reference_nm: float = REFERENCE_NM,
) -> float:
    """Return the defocus (Noll 4, waves RMS at reference_nm) of a target at range_mm; positive beyond best
    focus.

    The defocus is the difference of the sagittae of two spheres about the exit pupil, which
    is (1 - mp) f nearer to the image than the rear principal plane. Thesis (4.40) with its
    sign corrected.
    """

    half_pupil = pupil_magnification * focal_length_mm / f_number / 2

    def sagitta(distance_mm: float) -> float:
        return sqrt(
            exit_pupil_to_image_mm(distance_mm, focal_length_mm, pupil_magnification) ** 2
            - half_pupil**2
        )

    moved_mm = image_mm(range_mm, focal_length_mm) - image_mm(
        best_focus_mm, focal_length_mm
    )
    path_mm = moved_mm + sagitta(best_focus_mm) - sagitta(range_mm)
    return path_mm / sqrt(12) / (reference_nm * 1e-6)


def image_mm(range_mm: float, focal_length_mm: float) -> float:
    """Return the distance from the rear principal plane to the image of a range, mm."""
    return range_mm * focal_length_mm / (range_mm - focal_length_mm)


def exit_pupil_to_image_mm(
    range_mm: float, focal_length_mm: float, pupil_magnification: float
) -> float:
    """Return the distance from the exit pupil to the image of a range, mm. Thesis (E.2)."""
    return image_mm(range_mm, focal_length_mm) + (pupil_magnification - 1) * focal_length_mm


def entrance_pupil_to_target_mm(
    range_mm: float, focal_length_mm: float, pupil_magnification: float
) -> float:
    """Return the distance from the entrance pupil to a target at a range, mm.

    Ranges count from the front principal plane.
    """
    return range_mm - focal_length_mm + focal_length_mm / pupil_magnification


def working_f_number(
    f_number: float,
    best_focus_mm: float,
    focal_length_mm: float,
    pupil_magnification: float,
) -> float:
    """Return the working f-number: the image distance over the exit pupil's diameter.

    f_number: at infinity. The sensor is at the image of best_focus_mm, whatever the
    target's range.
    """
    height_mm = exit_pupil_to_image_mm(best_focus_mm, focal_length_mm, pupil_magnification)
    return height_mm / (pupil_magnification * focal_length_mm / f_number)


def image_per_tangent_mm(
    best_focus_mm: float, focal_length_mm: float, pupil_magnification: float
) -> float:
    """Return the height at the sensor, mm, of a chief ray that enters with unit tangent to the axis.

    The ray goes through the centres of both pupils, and leaves with 1/mp of the tangent: an
    invariant of the pupils' images.
    """
    return (
        exit_pupil_to_image_mm(best_focus_mm, focal_length_mm, pupil_magnification)
        / pupil_magnification
    )


def point_spread(
    waves: Mapping[int, float],
    wavelength_nm: float,
    f_number: float,
    spacing_um: float,
    reach: int,
    reference_nm: float = REFERENCE_NM,
    pupil: Pupil = ROUND_PUPIL,
) -> Floats32:
    """Return the lens's PSF on a grid of spacing_um: (2 reach + 1, 2 reach + 1), centred, shares of all light.

    waves: {Noll mode: waves RMS at reference_nm}, over the disc of f_number. The pupil is
    sampled so finely that the field repeats only after 6 times the reach: light that wraps
    around arrives beyond the window, except for the faint outermost tail.
    """
    n = scipy.fft.next_fast_len(int(6 * reach) + 1)
    radius = n * spacing_um / (2 * wavelength_nm * 1e-3 * f_number)
    if 4 * radius * pupil.extent > n:
        raise ValueError(
            f"a grid of {spacing_um:g} um is too coarse for f/{f_number:g} at {wavelength_nm:g} nm"
        )
    edge = int(radius * pupil.extent) + RIM_REACH
    v, u = np.meshgrid(*2 * [np.arange(-edge, edge + 1) / radius], indexing="ij")
    inside = pupil.samples(u, v, radius)
    phase = 2 * np.pi * reference_nm / wavelength_nm * wavefront(waves, u, v)
    lit = (inside * np.exp(1j * phase)).astype(np.complex64)
    around = np.arange(-reach, reach + 1)
    # where the pupil begins only turns the field's phase; rows beyond the window are left out between the passes
    rows = scipy.fft.fft(lit, n, axis=0, workers=2)[around]
    window = scipy.fft.fft(rows, n, axis=1, workers=2)[:, around]
    # the amplitudes sum to the pupil's area, their squares to less
    psf: Floats32 = ((window.real**2 + window.imag**2) / (n**2 * inside.sum())).astype(
        np.float32
    )
    return psf


def halo_beyond(
    wavelength_nm: float,
    f_number: float,
    spacing_um: float,
    reach: int,
    samples: int,
    pixels: int,
    pupil: Pupil = ROUND_PUPIL,
) -> Floats32:
    """Return the light missing from `point_spread`, from pixel to pixel: (2 pixels + 1, 2 pixels + 1) shares,
    centred.

    samples: of spacing_um to a pixel. Beyond the window, averaged over its rings, the light
    of any lens falls with the cube of the distance, lambda N / (pi r)^3 times the length of
    the pupil's rims over that of a disc of its area; towards any direction it is that of
    the rims across it. The halo is a thousandth of the light and far away, but the f-number
    is known from the initial fall of contrast with frequency: without the light beyond 350
    um its estimate is 0.5 % too small.
    """
    airy_um = wavelength_nm * 1e-3 * f_number
    pitch_um = samples * spacing_um
    y, x = np.meshgrid(*2 * [np.arange(-pixels, pixels + 1) * pitch_um], indexing="ij")
    rings = airy_um / (np.pi * np.maximum(np.hypot(y, x), pitch_um)) ** 3
    spike = (np.arctan2(y, x) / np.pi % 1 * SPIKES).astype(int) % SPIKES
    rings *= pupil.rim * pitch_um**2 * pupil.spikes[spike]
    edge_um = (reach + 0.5) * spacing_um
    within = np.clip((edge_um - abs(y)) / pitch_um + 0.5, 0, 1) * np.clip(
        (edge_um - abs(x)) / pitch_um + 0.5, 0, 1
    )
    return np.asarray((1 - within) * rings, dtype=np.float32)
