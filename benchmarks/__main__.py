"""How fast: `make bench`. A ratio's two times are taken in turn, in the same run; what is printed are medians."""

from collections.abc import Callable
from itertools import count
from statistics import median
from time import perf_counter

import astropy.units as u
import numpy as np
import poppy
import scipy.fft

from benchmarks.field import selected
from labkit.estimation.climb import maximize
from labkit.experiments.annealing import Task, work
from labkit.experiments.conditions import (
    AIRY_UM,
    NOLL,
    THESIS_F_NUMBER,
    WAVELENGTH_UM,
    carpet,
    draw_trial,
    random_waves,
)
from labkit.imaging.model import ForwardModel
from labkit.imaging.optics import Optics
from labkit.imaging.warp import Pose
from labkit.jobs.execute import pin_threads
from labkit.optics.psf import Pupil
from labkit.optics.zernike import zernike
from labkit.types import Floats

RUNS = 7
WAVEFRONTS, CAP_S = (
    4,
    30.0,
)  # searched for from nothing; after so long an annealing is ended
AWAY_WAVES = 0.1  # from the truth, where a local fit starts
PSF_SIDE, PSF_FINER = 65, 4  # samples of the PSF, and to lambda N
PSF_ERROR = 3e-3  # summed, as a share of all light: as much as 1e-3 waves change


def timed(work: Callable[[], object]) -> float:
    """Seconds of a piece of work."""
    began = perf_counter()
    work()
    return perf_counter() - began


def ratio(work: Callable[[], object], measure: Callable[[], object]) -> float:
    """Median of the time of a piece of work over that of another, after one run of both that does not count."""
    return median([timed(work) / timed(measure) for _ in range(RUNS + 1)][1:])


def line(what: str, measured: str, wanted: str = "") -> None:
    """One row of the table."""
    print(f"{what:68s}  {measured:>9s}  {wanted:>9s}", flush=True)


def evaluation() -> None:
    """Mean and Jacobian of a Bayer frame against the transforms that they cannot do without.

    A maximisation has drawn the target when it comes to the Jacobian, for it has looked at the mean there before.
    """
    used = np.zeros((264, 264), bool)
    used[0::2, 1::2] = used[1::2, 0::2] = True
    waves = np.array([0.6, *np.full(11, 0.02)])
    corners = np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]]) * 117 + 131.0
    poses = (Pose.from_corners(corners + 0.01 * k, carpet().size_mm) for k in count())
    held = next(poses)
    optics = Optics(
        wavelength_nm=550.0,
        reference_nm=450.0,
        f_number=2.8,
        pitch_um=4.78,
        active_um=4.78,
        noll=NOLL,
    )
    model = ForwardModel.build(optics, carpet(), (264, 264), held)
    torus, size = model.blur.torus, model.blur.pupil.size
    image, field, window = (
        np.ones(torus.fine),
        np.ones((size, size), complex),
        np.ones((size, size)),
    )

    def transforms() -> None:
        torus.half_spectrum(image)
        for _ in range(len(NOLL) + 1):
            scipy.fft.fft2(field)
            torus.half_spectrum_of_window(window)

    drawing = model.draw([held])
    drawn = ratio(lambda: model.evaluate(waves, drawing, [used]), transforms)
    new = ratio(
        lambda: model.evaluate(waves, model.draw([next(poses)]), [used]), transforms
    )
    line("mean and Jacobian / their FFTs, 264 x 264 Bayer, f/2.8", f"{drawn:.2f}", "<= 1.5")
    line("  and with the target drawn anew, which takes no FFT", f"{new:.2f}", "<= 2.0")


def ours(diameter: int, waves: Floats) -> Floats:
    """(PSF_SIDE, PSF_SIDE) by a pupil so many samples across."""
    size = diameter * PSF_FINER
    psf = _pupil(size).psf(waves)
    first = size // 2 - PSF_SIDE // 2
    return psf[first : first + PSF_SIDE, first : first + PSF_SIDE]


_PUPILS: dict[int, Pupil] = {}


def _pupil(size: int) -> Pupil:
    """Kept, as a fit keeps it."""
    return _PUPILS.setdefault(
        size,
        Pupil(
            WAVELENGTH_UM, WAVELENGTH_UM, THESIS_F_NUMBER, AIRY_UM / PSF_FINER, size, NOLL
        ),
    )


def poppys(diameter: int, waves: Floats) -> Floats:
    """The same by poppy, turned by 180 degrees as it throws light the other way."""
    system = poppy.OpticalSystem(npix=diameter, oversample=1)
    system.add_pupil(poppy.CircularAperture(radius=1.0, gray_pixel=True))
    system.add_pupil(
        poppy.ZernikeWFE(
            radius=1.0, coefficients=[0, 0, 0, *(waves * WAVELENGTH_UM * 1e-6)]
        )
    )
    scale = np.degrees(WAVELENGTH_UM * 1e-6 / (2.0 * PSF_FINER)) * 3600
    system.add_detector(
        pixelscale=scale * u.arcsec / u.pixel, fov_pixels=PSF_SIDE, oversample=1
    )
    return np.asarray(system.calc_psf(wavelength=WAVELENGTH_UM * 1e-6)[0].data[::-1, ::-1])


def exact(waves: Floats) -> Floats:
    """The same by Gauss's quadrature of the diffraction integral over the disc: it converges faster than any power."""
    nodes, weights = np.polynomial.legendre.leggauss(96)
    rho, theta = (1 + nodes[:, None]) / 2, np.arange(384) * (2 * np.pi / 384)
    path = sum(
        w * zernike(j, *np.broadcast_arrays(rho, theta))
        for j, w in zip(NOLL, waves, strict=True)
    )
    pupil = (weights[:, None] / 2 * rho * 2 / 384 * np.exp(2j * np.pi * path)).ravel()
    at = (np.arange(PSF_SIDE) - PSF_SIDE // 2) / PSF_FINER
    by_row, by_column = (
        np.exp(-1j * np.pi * at[:, None] * (rho * turn(theta)).ravel())
        for turn in (np.sin, np.cos)
    )
    return np.asarray(np.abs(by_row * pupil @ by_column.T) ** 2 * np.pi / 4 / PSF_FINER**2)


def psfs() -> None:
    """Our PSF and poppy's of a wavefront of 0.25 waves, each by the coarsest pupil that is right."""
    waves = random_waves(np.random.default_rng(1), len(NOLL), 0.25)
    truth = exact(waves)

    def enough(psf: Callable[[int, Floats], Floats]) -> int:
        row = (round(32 * 2 ** (k / 4)) for k in count())
        return next(n for n in row if np.abs(psf(n, waves) - truth).sum() < PSF_ERROR)

    own, other = enough(ours), enough(poppys)
    measured = ratio(lambda: poppys(other, waves), lambda: ours(own, waves))
    line(
        f"PSF by poppy / ours, both right to {PSF_ERROR:g}: {other} and {own} samples",
        f"{measured:.0f}",
        "> 1",
    )


def local_fit() -> None:
    """Local fits at the conditions of thesis §3.8, to pictures that another model has drawn."""
    took, off = [], []
    for seed in range(RUNS):
        rng = np.random.default_rng([3, seed])
        trial = draw_trial(rng)
        start = trial.state(trial.waves + random_waves(rng, len(NOLL), AWAY_WAVES))
        began = perf_counter()
        solution = maximize(trial.problem, start)
        took.append(perf_counter() - began)
        off.append(float(np.linalg.norm(trial.error(solution.state.waves)) / trial.bound))
    line(
        f"local fit from {AWAY_WAVES:g} waves away, median of {RUNS}",
        f"{median(took):.2f} s",
        "<= 0.2 s",
    )
    line("  its error over the bound", f"{median(off):.2f}", "about 1")


def global_fits() -> None:
    """Our search from nothing beside SciPy's annealing with the pose known to it."""
    answers = [work(Task(NOLL, 100 + seed, CAP_S)) for seed in range(WAVEFRONTS)]
    search, annealing = (
        [getattr(a, name) for a in answers] for name in ("search", "annealing")
    )
    capped = sum(a.capped for a in answers)
    line(
        f"global fit from nothing, test included, median of {WAVEFRONTS}",
        f"{median(search):.1f} s",
        "<= 1.5 s",
    )
    line(
        "  right optimum found", f"{sum(a.found for a in answers)} of {len(answers)}", "all"
    )
    line(
        f"dual_annealing / global fit, mean times, {WAVEFRONTS} wavefronts ({capped} cut at {CAP_S:g} s)",
        f"{sum(annealing) / sum(search):.1f}",
        "",
    )


def field() -> None:
    """A field's candidates to its lens; the memory is this whole process's."""
    seconds, most, named = selected()
    line(
        "1,000 tiles x 3 ranges x 3 colours selected and solved",
        f"{seconds:.1f} s",
        "<= 10 s",
    )
    line("  memory at most", f"{most:.2f} GB", "<= 1 GB")
    line("  wrong fits named, and right ones besides", named, "all, 0")


if __name__ == "__main__":
    poppy.conf.use_multiprocessing = False
    pin_threads()  # as all fits of a session are
    line("12 modes, 106 x 106 pixels where nothing else stands", "measured", "wanted")
    evaluation()
    psfs()
    local_fit()
    global_fits()
    field()
    print(
        "the last over 20 wavefronts, cut at 600 s (>= 20 wanted): labkit study annealing; "
        "accuracy over lenses, ranges, seeds: python -m benchmarks.accuracy"
    )
