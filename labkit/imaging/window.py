"""The width of a PSF's window: the model loses light thrown farther by the wavefront."""

from collections.abc import Sequence

import numpy as np

from labkit.optics.zernike import zernike
from labkit.types import Floats

STRAYED = 1e-4  # share of the light by which a PSF beyond its window may differ from a perfect lens's
OF_HALO = 0.2  # 0.14 to 0.27 for wavefronts of 0.2 to 1.5 waves RMS in modes 4 to 28
WINDOW_AIRY = 120.0  # lambda N, unless a wavefront needs more: twice STRAYED strays at 1.3 waves of defocus
WIDEST_WINDOW = 400.0  # for memory's sake
RAYS = 128
SLOPE_STEP = 1e-4
FADING = 0.2  # of the window, both borders together, along rows and columns


def window_for(noll: Sequence[int], waves: Floats, longest: float = 1.0) -> float:
    """Return the width of a window, in lambda N, beyond which a PSF differs from a perfect lens's by STRAYED of
    all light.

    noll: modes; waves: (modes,) RMS, of the light's own wavelength. longest: radius of the
    pupil's rim. Light far out comes from the pupil's rim. It falls as lambda N / (pi r)^3
    about the points reached by rays from the rim. The mean over points at distances e from
    the centre exceeds the value for e = 0 by (e / r)^2 and a factor, which leaves OF_HALO
    e^2 / r^3 beyond r.
    """
    distance = rim_rays_airy(noll, waves, longest)
    reach = np.cbrt(OF_HALO * np.mean(distance**2) / STRAYED)
    return float(min(2 * reach, WIDEST_WINDOW))


def rim_rays_airy(noll: Sequence[int], waves: Floats, longest: float = 1.0) -> Floats:
    """Return (RAYS,) distances from the PSF's centre, lambda N, of rays from the pupil's rim: twice the path's
    slope.
    """
    theta = np.linspace(0, 2 * np.pi, RAYS, endpoint=False)

    def path(rho: float, turn: float) -> Floats:
        rim = np.full(RAYS, rho)
        return sum(
            (w * zernike(j, rim, theta + turn) for j, w in zip(noll, waves, strict=True)),
            np.zeros(RAYS),
        )

    by_rho = (path(longest, 0.0) - path(longest - SLOPE_STEP, 0.0)) / SLOPE_STEP
    by_theta = (path(longest, SLOPE_STEP) - path(longest, -SLOPE_STEP)) / (
        2 * SLOPE_STEP * longest
    )
    return np.asarray(2 * np.hypot(by_rho, by_theta))


def fading(size: int) -> Floats:
    """Return (size,) weights that fade out towards a window's borders along a cosine: J. W. Tukey's.

    They equal `scipy.signal.windows.tukey`, whose import takes a quarter of a worker's
    start.
    """
    inwards = np.minimum(np.arange(size), np.arange(size)[::-1]) / (
        0.5 * FADING * (size - 1)
    )
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * np.minimum(inwards, 1.0)))
