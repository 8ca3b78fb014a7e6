"""Starts for the likelihood by phase retrieval from one frame with fixed pose.

With fixed pose the picture is linear in the PSF, and PSFs of moderate wavefronts are combinations of a few hundred components.
One factorisation of the components' pictures leaves a least-squares problem of a few hundred numbers, in which a start costs
a tenth of a start in the likelihood. Tilts compensate for the error of the pose.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import scipy.linalg
from scipy.optimize import least_squares

from labkit.estimation.climb import NoisePrior, State
from labkit.estimation.likelihood import FrameData, predict
from labkit.estimation.settings import SETTINGS
from labkit.imaging.model import ForwardModel
from labkit.imaging.optics import Optics
from labkit.optics.psf import Pupil
from labkit.optics.strehl import TILTS
from labkit.target.target import Target
from labkit.types import Floats, Floats32


@dataclass(frozen=True, eq=False)
class Optimum:
    """An optimum of the small problem.

    Attributes
    ----------
    state : the optimum
    misfit : sum of squares, minus twice the log-likelihood
    met : number of starts that ended in the optimum
    offered : whether the optimum was a candidate already
    """

    state: State
    misfit: float
    met: int = 1
    offered: bool = False


@dataclass(frozen=True, eq=False)
class Retrieved:
    """Record of a search in the small problem.

    Attributes
    ----------
    given : wavefronts (modes,) to start from before random starts
    optima : optima met so far, the best first
    starts : number of starts so far
    waited : number of starts since the last candidate
    candidate : last candidate; None if the search has ended without another
    """

    given: tuple[Floats, ...] = ()
    optima: tuple[Optimum, ...] = ()
    starts: int = 0
    waited: int = 0
    candidate: State | None = None

    @property
    def ended(self) -> bool:
        """Return whether enough starts returned to the best optimum, or enough starts were made."""
        return bool(self.optima) and (
            self.starts >= 2 * SETTINGS.most_starts
            or self.optima[0].met >= SETTINGS.enough_returns
        )

    def joined(self, end: Optimum) -> "Retrieved":
        """Add the end of another start to the record."""
        known = [
            abs(o.misfit - end.misfit) < SETTINGS.model_error * end.misfit
            for o in self.optima
        ]
        if any(known):
            met = known.index(True)
            optima = tuple(
                replace(o, met=o.met + 1) if k == met else o
                for k, o in enumerate(self.optima)
            )
        else:
            optima = tuple(sorted([*self.optima, end], key=lambda o: o.misfit))
        return replace(
            self,
            optima=optima,
            starts=self.starts + 1,
            waited=self.waited + 1,
            candidate=None,
        )

    def offering(self) -> "Retrieved":
        """Make the best optimum that was not offered yet the candidate, if a candidate is due."""
        best = self.optima[0]
        least = self.optima[0].misfit
        fresh = next(
            (
                o
                for o in self.optima
                if not o.offered and o.misfit < SETTINGS.worth_misfit * least
            ),
            None,
        )
        stands_out = len(self.optima) > 1 and self.optima[1].misfit > 2 * least
        clear = (
            fresh is best
            and stands_out
            and self.starts >= max(SETTINGS.enough_returns // 2, len(self.given))
        )
        if fresh is None or not (
            clear or self.ended or self.waited >= 2 * SETTINGS.enough_returns
        ):
            return self
        optima = tuple(replace(o, offered=True) if o is fresh else o for o in self.optima)
        return replace(self, optima=optima, waited=0, candidate=fresh.state)


@dataclass(frozen=True, eq=False)
class PhaseRetrieval:
    """A small problem with the misfit |factor @ (scale * components of the PSF's departure, scale, ambient) - data|^2.

    Attributes
    ----------
    optics : lens, light and sensor
    pupil : pupil over tilts and modes
    factor : (n, n), n two more than the number of components
    data : (n,)
    state : fixed pose, and light to start from
    """

    optics: Optics
    pupil: Pupil
    factor: Floats
    data: Floats
    state: State

    @classmethod
    def prepare(
        cls,
        optics: Optics,
        target: Target,
        frame: FrameData,
        noise: NoisePrior,
        state: State,
    ) -> "PhaseRetrieval":
        """Prepare the small problem at a state with approximate pose and light."""
        tilted = replace(optics, noll=(*TILTS, *optics.noll))
        band = min(1.0, 2 * optics.airy_um / optics.pitch_um)
        pose = state.poses[0]
        used = [frame.used]
        model = ForwardModel.build(
            tilted,
            target,
            frame.counts.shape,
            pose,
            band=band,
            window_airy=SETTINGS.small_window_airy,
        )
        drawing = model.draw([pose])
        waves = np.append(np.zeros(len(TILTS)), state.waves)
        (perfect,), (relative,) = (
            model.means(0 * waves, drawing, used),
            model.means(waves, drawing, used),
        )
        size = model.blur.pupil.size
        components = _components(model.blur.pupil)[0].reshape(-1, size, size)
        pictures = model.departures(components, drawing, frame.used)
        detector = replace(state, log_noise=noise.centre).detectors()[0]
        mean, variance = predict(relative, frame, detector)
        known = np.array([perfect, np.ones_like(perfect)]) * (
            light := frame.light(detector.unevenness)
        )
        free = len(frame.departures)
        if free:  # the rows that departures can match are left out, for their coefficients are unknown
            orders = frame.departures[:, frame.used]
            orders = orders * (mean / (1 + detector.unevenness @ orders))
        else:
            orders = np.empty((0, mean.size))
        counts = frame.counts[frame.used]

        def columns(pixels: slice) -> Floats:
            unknown = light[pixels] * np.array([picture[pixels] for picture in pictures])
            return np.concatenate(
                [orders[:, pixels], unknown, known[:, pixels], counts[None, pixels]]
            )

        # with the data as the last column, R holds the rotated data, so Q is never formed
        triangle = _triangle(columns, np.sqrt(variance))
        count = min(triangle.shape[1] - 1, counts.size)
        factor, data = np.hsplit(triangle[free:count, free:].astype(float), [-1])
        return cls(optics, model.blur.pupil, factor, data[:, 0], state)

    def to_next_candidate(
        self, retrieved: Retrieved, rng: np.random.Generator
    ) -> Retrieved:
        """Make starts until a candidate for the likelihood is due, or until the search has ended.

        The search ends at once if the frame has fewer pixels than unknowns.
        """
        retrieved = replace(retrieved, candidate=None)
        if self.data.size < len(self.pupil.noll) + 2:
            return retrieved
        while not retrieved.ended and retrieved.candidate is None:
            waiting = retrieved.starts < len(retrieved.given)
            start = retrieved.given[retrieved.starts] if waiting else self.random_waves(rng)
            retrieved = retrieved.joined(self.descend(start)).offering()
        return retrieved

    def random_waves(self, rng: np.random.Generator) -> Floats:
        """Return a random start, (modes,)."""
        scale = self.optics.wavelength_um / self.optics.reference_um
        return random_wavefront(rng, self.state.waves.size) * scale

    def descend(self, waves: Floats) -> Optimum:
        """Descend from a wavefront (modes,) to an optimum."""
        # a point is tilts and modes, then scale and ambient
        start = np.concatenate(
            [np.zeros(len(TILTS)), waves, self.state.scales[:1], self.state.ambients[:1]]
        )
        components, perfect = _components(self.pupil)
        size = start.size - 2

        def residual(point: Floats) -> Floats:
            departure = components @ (
                self.pupil.psf(point[:size]) - perfect
            ).ravel().astype(np.float32)
            return np.asarray(
                self.factor @ np.concatenate([point[size] * departure, point[size:]])
                - self.data
            )

        def slopes(point: Floats) -> Floats:
            departure = (self.pupil.psf(point[:size]) - perfect).astype(np.float32)
            stack = np.array([*self.pupil.psf_slopes(point[:size]), departure]).reshape(
                size + 1, -1
            )
            by_light = components @ stack.T
            columns = np.zeros((len(components) + 2, size + 2))
            columns[:-2, : size + 1] = by_light * np.append(np.full(size, point[size]), 1.0)
            columns[-2:, -2:] = np.eye(2)
            return np.asarray(self.factor @ columns)

        end = least_squares(
            residual,
            start,
            slopes,
            method="lm",
            x_scale="jac",
            ftol=1e-4,
            xtol=1e-4,
            gtol=1e-6,
            max_nfev=SETTINGS.most_steps,
        )
        return Optimum(self._state(end.x), 2 * float(end.cost))

    def _state(self, point: Floats) -> State:
        """Turn tilts into a shift of the pose: a wave RMS of tilt moves the light by 4 lambda_ref N."""
        by_column, by_row = (
            4
            * point[:2]
            * self.optics.reference_um
            * self.optics.f_number
            / self.optics.pitch_um
        )
        pose = self.state.poses[0].shifted(-by_row, -by_column)
        return replace(
            self.state,
            waves=point[2:-2],
            poses=(pose,),
            scales=point[-2:-1].copy(),
            ambients=point[-1:].copy(),
        )


def random_wavefront(rng: np.random.Generator, modes: int) -> Floats:
    """Return a random start (modes,), in waves of the light's own wavelength."""
    direction = rng.normal(size=modes)
    rms = rng.uniform(*SETTINGS.start_waves)
    return np.asarray(direction / np.linalg.norm(direction) * rms)


def _triangle(columns: Callable[[slice], Floats], sigma: Floats) -> Floats:
    """Return R of the QR decomposition of weighted rows, one a pixel, made and rotated a part at a time.

    columns : gives the columns (n, pixels) of a range of pixels
    sigma : (pixels,) standard deviations of the rows
    """
    triangle = columns(slice(0)).T
    for first in range(0, sigma.size, SETTINGS.pixels_at_once):
        pixels = slice(first, first + SETTINGS.pixels_at_once)
        stacked = np.concatenate([triangle, (columns(pixels) / sigma[pixels]).T])
        (triangle,) = scipy.linalg.qr(
            stacked, mode="r", overwrite_a=True, check_finite=False
        )
        triangle = triangle[: triangle.shape[1]]
    return triangle


@lru_cache(maxsize=8)
def _components(pupil: Pupil) -> tuple[Floats32, Floats]:
    """Return orthonormal components (components, size^2) of random PSFs less the perfect PSF, and the perfect PSF."""
    rng = np.random.default_rng(0)
    perfect = pupil.psf(np.zeros(len(pupil.noll)))
    scale = pupil.wavelength_um / pupil.reference_um
    draws = 3 * SETTINGS.psf_components
    drawn = np.empty((draws, perfect.size))
    for row in drawn:
        waves = random_wavefront(rng, len(pupil.noll) - len(TILTS))
        tilts = rng.normal(scale=np.mean(SETTINGS.start_waves), size=len(TILTS))
        row[:] = (pupil.psf(scale * np.concatenate([tilts, waves])) - perfect).ravel()
    weights, vectors = scipy.linalg.eigh(
        drawn @ drawn.T, subset_by_index=(draws - SETTINGS.psf_components, draws - 1)
    )
    kept = weights > SETTINGS.exact**2 * weights[-1]  # few modes span few dimensions
    turn = (vectors[:, kept] / np.sqrt(weights[kept])).T
    return turn.astype(np.float32) @ drawn.astype(np.float32), perfect
