"""The conditions of thesis §3.8: an order-5 carpet on 106 x 106 pixels, 2.5 times undersampled, 2.05e5 photons a pixel."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from labkit.estimation.climb import NoisePrior, Problem, State
from labkit.estimation.identifiability import bound_of
from labkit.estimation.likelihood import FrameData
from labkit.estimation.local import Found, Guesses, Views, find_optima
from labkit.experiments.camera import Camera
from labkit.experiments.methods.bounds import fisher_information
from labkit.finder.find_target import find_target
from labkit.imaging.model import ForwardModel
from labkit.imaging.optics import Optics
from labkit.imaging.warp import Pose
from labkit.optics.zernike import twin_signs
from labkit.plan import TargetSpec
from labkit.target.target import Target, open_target
from labkit.types import Floats

NOLL = tuple(range(4, 16))
SEVEN = tuple(range(4, 11))  # the modes of the thesis's smaller problem
WAVES_RMS = 0.25
ORDER = 5
FRAME = 106
SIDE_PX = 70.0
WAVELENGTH_UM = 0.55
THESIS_F_NUMBER = 8.0
PITCH_UM = 5.5
AIRY_UM = WAVELENGTH_UM * THESIS_F_NUMBER  # lambda N; the pitch is 2.5 times half of it
PHOTONS = 2.05e5  # a pixel, on average over the carpet
GAIN = 1 / 2000  # counts a photon
NOISE_STD = 0.01  # relative, of gain and read variance as measured beforehand
SNR = 75.0  # deviation of the picture without noise over that of its noise; the thesis's read noise of 0.68 counts
CAMERA = Camera(WAVELENGTH_UM, THESIS_F_NUMBER, PITCH_UM, 216, FRAME, 3)
WHITE = PHOTONS * GAIN / (1 - (8 / 9) ** ORDER)  # counts
FOUND_BOUNDS = 6.0  # an estimate nearer to the truth than so many bounds is in its optimum


@dataclass(frozen=True)
class Trial:
    """One simulated image with its truth. waves: (modes,) RMS; read_noise: counts."""

    frame: FrameData
    pose: Pose
    waves: Floats
    noll: tuple[int, ...]
    read_noise: float

    @property
    def noise(self) -> NoisePrior:
        return NoisePrior(GAIN, NOISE_STD, self.read_noise**2, NOISE_STD)

    @property
    def problem(self) -> Problem:
        return Problem(forward_model(self.noll), (self.frame,), self.noise)

    def state(self, waves: Floats) -> State:
        """Return a start: the truth except for the wavefront."""
        return State(
            np.asarray(waves, float),
            (self.pose,),
            np.array([WHITE]),
            np.zeros(1),
            self.noise.centre,
        )

    def error(self, waves: Floats) -> Floats:
        """Return the (modes,) error of an estimate or its twin, whichever is nearer: an image does not
        distinguish them.
        """
        twin = waves * twin_signs(self.noll)
        return np.asarray(min((waves - self.waves, twin - self.waves), key=np.linalg.norm))

    @property
    def bound(self) -> float:
        """Cramér-Rao bound of the wavefront, all modes together, at the truth; waves RMS. Computed anew each time."""
        there = self.state(self.waves)
        bound = bound_of(
            fisher_information(self.problem, there, 6), there.parameter_names(self.noll)
        )
        return float(np.linalg.norm(bound.std[: len(self.noll)]))

    def found(self, waves: Floats) -> bool:
        """Return whether an estimate is in the optimum of the truth, or of its twin."""
        return bool(np.linalg.norm(self.error(waves)) < FOUND_BOUNDS * self.bound)

    def fit(self, rng: np.random.Generator) -> Found:
        """Fit the image without prior knowledge: find the target, then search for the wavefront.

        rng: for further starts. Raises TargetError if the target is not found.
        """
        pose = Pose.from_corners(find_target(self.frame.counts, carpet()), carpet().size_mm)
        views = Views((self.frame,), (pose,), self.noise)
        return find_optima(
            optics(self.noll), carpet(), views, Guesses(), seed=int(rng.integers(2**32))
        )


def draw_trial(
    rng: np.random.Generator,
    *,
    snr: float = SNR,
    noll: tuple[int, ...] = NOLL,
    waves_rms: float = WAVES_RMS,
) -> Trial:
    """Draw a random wavefront of a strength, at a random pose nearly upright, with noise for an SNR.

    Raises ValueError for an SNR above the limit of photon noise.
    """
    waves = random_waves(rng, len(noll), waves_rms)
    angle = rng.uniform(-0.03, 0.03)
    size = SIDE_PX * rng.uniform(0.98, 1.02)
    sides = size * np.array(
        [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]
    )
    sides = sides + rng.normal(scale=0.3, size=(2, 2))
    centre = (FRAME - 1) / 2 + rng.uniform(-1, 1, 2)
    corners = centre + np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]]) @ sides.T / 2
    mean = WHITE * CAMERA.mean(ORDER, centre, sides, waves, noll)
    read_variance = mean.var() / snr**2 - GAIN * mean.mean()
    if read_variance <= 0:
        most = mean.std() / np.sqrt(GAIN * mean.mean())
        raise ValueError(f"snr {snr:g}: photons alone allow no more than {most:.0f}")
    counts = GAIN * rng.poisson(mean.clip(0) / GAIN) + rng.normal(
        scale=np.sqrt(read_variance), size=mean.shape
    )
    frame = FrameData(
        counts, np.ones_like(mean, dtype=bool), np.ones_like(mean), np.zeros_like(mean)
    )
    return Trial(
        frame,
        Pose.from_corners(corners, carpet().size_mm),
        waves,
        noll,
        float(np.sqrt(read_variance)),
    )


def random_waves(rng: np.random.Generator, modes: int, waves_rms: float) -> Floats:
    """Return (modes,) waves of an RMS in a random direction."""
    direction = rng.normal(size=modes)
    return np.asarray(waves_rms * direction / np.linalg.norm(direction))


@cache
def carpet() -> Target:
    """Return a carpet two millimetres wide; any size serves."""
    return open_target(TargetSpec(kind="sierpinski", order=ORDER, size_mm=2.0))


def optics(noll: tuple[int, ...]) -> Optics:
    """Return the camera as the estimator knows it."""
    return Optics(
        wavelength_nm=1e3 * WAVELENGTH_UM,
        reference_nm=1e3 * WAVELENGTH_UM,
        f_number=THESIS_F_NUMBER,
        pitch_um=PITCH_UM,
        active_um=PITCH_UM,
        noll=noll,
    )


@cache
def upright() -> Pose:
    """Return a pose near all poses of the images."""
    corners = (FRAME - 1) / 2 + np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]]) * SIDE_PX / 2
    return Pose.from_corners(corners, carpet().size_mm)


@cache
def forward_model(noll: tuple[int, ...]) -> ForwardModel:
    """Return the estimator's own model of the images."""
    return ForwardModel.build(optics(noll), carpet(), (FRAME, FRAME), upright())
