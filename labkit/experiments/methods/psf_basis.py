"""Directions in which a point-spread function may depart from every wavefront's: Algorithm 4.9 of the thesis."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources

import numpy as np
from scipy.ndimage import map_coordinates

from labkit.arrays import real_array
from labkit.estimation.climb import Problem, State
from labkit.estimation.likelihood import FrameData, predict
from labkit.imaging.model import ForwardModel
from labkit.types import Complexes, Floats

SPACING_AIRY = 0.4  # between samples of a direction, in lambda N; Nyquist's is 0.5
SINGULAR_INFORMATION = 1e-6  # eigenvalue of the information over the largest, below which a combination of samples is left out

Case = tuple[Problem, State, Floats]
"""A problem of one noise-free frame, a wrong optimum, and the inverse variance of the used pixels (pixels,)."""


@dataclass(frozen=True, eq=False)
class PsfBasis:
    """Changes of the PSF for the reparameterised embedding of thesis §4.2.3.

    Parameters
    ----------
    directions : (k, n, n), n odd, centred, samples `SPACING_AIRY` lambda N apart

    Raises
    ------
    ValueError
        for another shape, or not finite
    """

    directions: Floats

    def __post_init__(self) -> None:
        side = np.shape(self.directions)[-1] if np.ndim(self.directions) else 0
        real_array("directions", self.directions, (None, side, side), "PSF")
        if not side % 2:
            raise ValueError(
                f"directions has shape {self.directions.shape}; an odd side is needed (PSF)"
            )

    @property
    def degrees(self) -> int:
        """Number of directions, k."""
        return len(self.directions)

    def kernels(self, model: ForwardModel) -> list[Complexes]:
        """Return half planes of the directions' transfer functions on a model's torus, including the pixel's."""
        torus = model.blur.torus
        pupil = model.blur.pupil
        step = torus.spacing_um / (pupil.wavelength_um * pupil.f_number) / SPACING_AIRY
        half = self.directions.shape[1] // 2
        reach = int(half / step)
        at = np.arange(-reach, reach + 1) * step + half
        places = np.meshgrid(at, at, indexing="ij")
        down, right = torus.shift(reach * torus.spacing_um)
        pixel = down * right * model.blur.beyond
        windows = [map_coordinates(d, places, order=3) for d in self.directions]
        return [torus.half_spectrum_of_window(window) * pixel for window in windows]


def find_psf_basis(cases: Sequence[Case], degrees: int, half_width: int = 14) -> PsfBasis:
    """Find the directions that distinguish wrong optima best: Algorithm 4.9 in the space of PSFs.

    The score by every sample of the PSF at each wrong optimum is whitened by the information. The leading left singular
    vectors, transformed back, are the directions. A basis of PSFs serves every pose and wavefront.

    Parameters
    ----------
    cases : wrong optima, each with its problem and weights
    degrees : number of directions
    half_width : of a direction, samples

    Returns
    -------
    `degrees` directions of 2 half_width + 1 samples a side
    """
    side = 2 * half_width + 1
    scores: list[Floats] = []
    information = np.zeros((side**2, side**2))
    for problem, state, weights in cases:
        samples = _psf_samples(problem, state, half_width)
        (frame,) = problem.frames
        mean = predict(problem.relative(state)[0], frame, state.detectors()[0])[0]
        scores.append(samples @ ((frame.counts[frame.used] - mean) * weights))
        information += samples * weights @ samples.T
    values, vectors = np.linalg.eigh(information / len(cases))
    kept = values > SINGULAR_INFORMATION * values[-1]
    whiten = vectors[:, kept] / np.sqrt(values[kept])
    left = np.linalg.svd(whiten.T @ np.array(scores).T, full_matrices=False)[0][:, :degrees]
    return PsfBasis((whiten @ left).T.reshape(degrees, side, side))


def _psf_samples(problem: Problem, state: State, half_width: int) -> Floats:
    """Return (samples, pixels) change of the frame by each sample of the PSF."""
    torus = problem.model.blur.torus
    pupil = problem.model.blur.pupil
    (frame,) = problem.frames
    (spectrum,) = problem.draw(state).spectra
    spectrum = spectrum * problem.model.blur.beyond * state.scales[0]
    step_um = SPACING_AIRY * pupil.wavelength_um * pupil.f_number
    places = np.arange(-half_width, half_width + 1) * step_um
    down = [np.exp(-2j * np.pi * torus.row_frequency * y) for y in places]
    right = [np.exp(-2j * np.pi * torus.column_frequency * x) for x in places]
    return np.array(
        [torus.sample(spectrum, a * b)[frame.used] for a in down for b in right]
    )


@cache
def shipped_psf_basis(degrees: int) -> PsfBasis:
    """Return the first directions of the basis of `benchmarks/make_psf_basis.py`, for the conditions of thesis
    §3.8.

    Raises
    ------
    ValueError
        for `degrees` below 1, or above the number of shipped directions, 16
    """
    with resources.as_file(
        resources.files("labkit.experiments.methods") / "psf_basis.npz"
    ) as path:
        directions = np.load(path)["directions"]
    if not 1 <= degrees <= len(directions):
        raise ValueError(
            f"degrees = {degrees}: 1 to {len(directions)} directions are shipped"
        )
    return PsfBasis(directions[:degrees].astype(float))


def noise_free(problem: Problem, state: State) -> Problem:
    """Return the problem with the mean counts at a state in place of the frames' counts."""
    frames: list[FrameData] = []
    for frame, detector, relative in zip(
        problem.frames, state.detectors(), problem.relative(state), strict=True
    ):
        counts = np.zeros(frame.counts.shape)
        counts[frame.used] = predict(relative, frame, detector)[0]
        frames.append(replace(frame, counts=counts))
    return replace(problem, frames=tuple(frames))
