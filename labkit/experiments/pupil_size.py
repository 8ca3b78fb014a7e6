"""Accuracy of PSFs against the number of samples across the pupil: thesis Appendix F, Figures F.1 to F.3."""

import numpy as np
import scipy.fft
from matplotlib.figure import Figure

from labkit.experiments.conditions import SEVEN, random_waves
from labkit.experiments.methods.shaded_aperture import disc_area
from labkit.experiments.runner import Claim, Outcome, Setting
from labkit.optics.psf import Pupil
from labkit.types import Floats

EDGES = {
    "smooth": None,
    "shaded": 2e-4,
    "binary": None,
}  # of the pupil; the error that the thesis has at 225 samples
COMPARED_AIRY_UM, WIDTH = 4.4, 16  # lambda N; the PSF is compared over so many of them


def pupil_of(diameter: int) -> Pupil:
    """Return a pupil `diameter` samples across, its PSF with four samples to lambda N.

    The radius is size * spacing / (2 lambda N).
    """
    return Pupil(0.55, 0.55, 8.0, COMPARED_AIRY_UM / 4, 4 * diameter, SEVEN)


def psf_of(diameter: int, waves: Floats) -> Floats:
    """Return the (65, 65) PSF, four samples to lambda N, of a smooth pupil `diameter` samples across."""
    return _middle(pupil_of(diameter).psf(waves))


def perfect_psf_of(diameter: int, edge: str) -> Floats:
    """Return the PSF without aberration.

    edge: content of the edge's samples: "smooth", "shaded" (the disc's area), or "binary"
    """
    pupil = pupil_of(diameter)
    half = len(pupil.amplitude) // 2
    area = disc_area(np.arange(-half, half + 1.0), pupil.radius)
    amplitude = {
        "smooth": pupil.amplitude,
        "shaded": area,
        "binary": (area > 0.5).astype(float),
    }[edge]
    field = scipy.fft.fftshift(scipy.fft.fft2(amplitude, (pupil.size, pupil.size)))
    return _middle(np.abs(field) ** 2 / (np.pi * pupil.radius**2 * pupil.size**2))


def _middle(psf: Floats) -> Floats:
    half = psf.shape[0] // 2
    return np.asarray(
        psf[
            half - 2 * WIDTH : half + 2 * WIDTH + 1, half - 2 * WIDTH : half + 2 * WIDTH + 1
        ]
    )


def run(setting: Setting) -> Outcome:
    """Measure the PSF's summed absolute error for a change of 1e-3 waves, and for three kinds of a pupil's
    edge.
    """
    rng = np.random.default_rng(6)
    diameters = (
        (31, 65, 129) if setting.quick else (31, 45, 65, 91, 129, 181, 225, 257, 361)
    )
    directions = 40 if setting.quick else 1000
    finest = 401 if setting.quick else 1025
    zero = np.zeros(len(SEVEN))
    waves = [random_waves(rng, len(SEVEN), 1e-3) for _ in range(directions)]
    around = psf_of(129, zero)
    varied = np.array([np.abs(psf_of(129, w) - around).sum() for w in waves])
    setting.progress(1, 2, "variation")
    truth = psf_of(finest, zero)
    rows = []
    for diameter in diameters:
        errors = {
            f"{edge}_error": float(np.abs(perfect_psf_of(diameter, edge) - truth).sum())
            for edge in EDGES
        }
        rows.append({"diameter": diameter} | errors)
    setting.progress(2, 2, "pupils")
    at = rows[-1] if setting.quick else next(row for row in rows if row["diameter"] == 225)
    claims = [
        Claim(
            "summed absolute PSF change for 1e-3 waves, median",
            3e-3,
            float(np.median(varied)),
            "",
            directions,
        ),
        *(
            Claim(
                f"PSF error, {edge} pupil {at['diameter']} samples across",
                wanted,
                at[f"{edge}_error"],
                "",
                1,
            )
            for edge, wanted in EDGES.items()
        ),
    ]

    return Outcome(claims, rows, lambda: _drawn(varied, rows))


def _drawn(varied: Floats, rows: list[dict[str, float]]) -> Figure:
    """Plot both studies side by side."""
    figure = Figure(figsize=(8.0, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.hist(1e3 * varied, 30)
    left.set(
        xlabel="summed absolute change / 1e-3",
        ylabel="wavefronts of 1e-3 waves RMS",
        title="What a wavefront does to the PSF",
    )
    for edge, marker in zip(EDGES, "^os", strict=True):
        right.loglog(
            [r["diameter"] for r in rows],
            [r[f"{edge}_error"] for r in rows],
            f"{marker}-",
            label=edge,
        )
    right.set(
        xlabel="samples across the pupil",
        ylabel="summed absolute error",
        title="What its sampling does",
    )
    right.legend()
    return figure
