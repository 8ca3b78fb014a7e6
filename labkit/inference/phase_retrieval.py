"""Where to climb from: wavefronts retrieved from one frame while its pose is held.

There the picture is linear in the PSF, and PSFs of moderate wavefronts are combinations of a few hundred components. One
factorisation of the components' pictures leaves a least-squares problem of as many numbers, in which a start costs a tenth
of what it costs in the likelihood. What the pose is off by, tilts take up.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt
import scipy.linalg
from scipy.optimize import least_squares

from labkit.imaging.model import ForwardModel, Optics
from labkit.inference.fisher_scoring import NoisePrior, State
from labkit.inference.likelihood import FrameData, predict
from labkit.optics.psf import Pupil
from labkit.target import Target
from labkit.types import Floats

TILTS = (2, 3)
WINDOW_AIRY = 32.0  # of the PSF, in lambda N: what reaches farther hardly depends on the wavefront
LOBES = 2.0  # of the spectrum that fits a pixel: beyond them little passes it
# PSFs drawn, and components kept: they leave 1 % of a PSF's departure from the perfect one
DRAWS, COMPONENTS = 900, 300
DRAWN_WAVES, DRAWN_TILT = (0.05, 0.4), 0.15  # RMS of what is drawn for them, at the light's own wavelength
START_WAVES = (0.1, 0.3)  # of random starts
SAME = 0.01  # ends whose misfits differ relatively by less are one optimum, or its twin: not all are carried to their bottom
WORTH = 1.1  # times the least misfit seen: an optimum that is worth a climb
LEAST, PATIENCE = 4, 16  # starts before the best optimum is offered: where it is clear, and where it is not
CLEAR = 2.0  # the next misfit is larger by this factor
ENOUGH, MOST = 8, 100  # times the best optimum is met, or starts made, before the search ends
EVALUATIONS = 30  # of one start, at most

Singles = npt.NDArray[np.float32]


@dataclass
class Optimum:
    """An end of the small problem. misfit: sum of squares, so minus twice a log-likelihood; met: how often."""

    state: State
    misfit: float
    met: int = 1
    offered: bool = False


@dataclass
class PhaseRetrieval:
    """A small problem and what was seen in it. optima: the best first; starts: made so far."""

    optics: Optics
    pupil: Pupil
    factor: Floats
    data: Floats
    state: State
    optima: list[Optimum] = field(default_factory=list)
    starts: int = 0

    @classmethod
    def prepare(
        cls, optics: Optics, target: Target, frame: FrameData, noise: NoisePrior, state: State
    ) -> "PhaseRetrieval":
        """From a state whose pose and light are about right."""
        tilted = replace(optics, noll=(*TILTS, *optics.noll))
        band = min(1.0, LOBES * optics.airy_um / optics.pitch_um)
        model = ForwardModel.build(tilted, target, frame.counts.shape, band=band, window_airy=WINDOW_AIRY)
        used, poses = [frame.used], list(state.poses[:1])
        waves = np.append(np.zeros(len(TILTS)), state.waves)
        (perfect,), (relative,) = model.means(0 * waves, poses, used), model.means(waves, poses, used)
        size = model.blur.pupil.size
        components = _components(model.blur.pupil)[0].astype(np.float64).reshape(-1, size, size)
        pictures = model.departures(components, poses[0], frame.used)
        detector = replace(state, log_noise=noise.centre).detectors()[0]
        mean, variance = predict(relative, frame, detector)
        columns = frame.light(detector.unevenness) * np.array([*pictures, perfect, np.ones_like(perfect)])
        free = len(frame.departures)
        if free:  # whatever their coefficients: the rows that they can meet are left out
            orders = frame.departures[:, frame.used]
            columns = np.concatenate([orders * (mean / (1 + detector.unevenness @ orders)), columns])
        weight = 1 / np.sqrt(variance)
        rotation, factor = scipy.linalg.qr((columns * weight).T, mode="economic", check_finite=False)
        data = rotation.T @ (frame.counts[frame.used] * weight)
        return cls(optics, model.blur.pupil, factor[free:, free:], data[free:], state)

    def candidates(self, first: Sequence[Floats], rng: np.random.Generator) -> Iterator[State]:
        """Where to climb from, the best first; while they are asked for, the search goes on.

        first: wavefronts (modes,) to start from before random ones. Ends when it keeps coming back to one best optimum, or
        at once where the frame has fewer pixels than there are unknowns.
        """
        if self.data.size < len(self.pupil.noll) + 2:
            return
        starts, since, done = [*first], 0, False
        while not done:
            self._add(self.descend(starts.pop(0) if starts else self.random_waves(rng)))
            self.starts, since = self.starts + 1, since + 1
            least, second = [o.misfit for o in (*self.optima, self.optima[0])[:2]]
            fresh = next((o for o in self.optima if not o.offered and o.misfit < WORTH * least), None)
            clear = fresh is self.optima[0] and second > CLEAR * least and self.starts >= max(LEAST, len(first))
            done = self.starts >= MOST or self.optima[0].met >= ENOUGH
            if fresh and (clear or done or since >= PATIENCE):
                fresh.offered, since = True, 0
                yield fresh.state

    def random_waves(self, rng: np.random.Generator) -> Floats:
        """A start, (modes,)."""
        direction = rng.normal(size=self.state.waves.size)
        scale = self.optics.wavelength_um / self.optics.reference_um
        return np.asarray(direction / np.linalg.norm(direction) * rng.uniform(*START_WAVES) * scale)

    def descend(self, waves: Floats) -> Optimum:
        """Where one start, a wavefront (modes,), ends."""
        # a point is tilts and modes, then scale and ambient
        start = np.concatenate([np.zeros(len(TILTS)), waves, self.state.scales[:1], self.state.ambients[:1]])
        components, perfect = _components(self.pupil)
        size = start.size - 2

        def residual(point: Floats) -> Floats:
            departure = components @ (self.pupil.psf(point[:size]) - perfect).ravel().astype(np.float32)
            return np.asarray(self.factor @ np.concatenate([point[size] * departure, point[size:]]) - self.data)

        def slopes(point: Floats) -> Floats:
            psf, by_mode = self.pupil.psf_jacobian(point[:size])
            stack = np.concatenate([by_mode, (psf - perfect)[None]]).reshape(size + 1, -1).astype(np.float32)
            by_light = components @ stack.T
            columns = np.zeros((len(components) + 2, size + 2))
            columns[:-2, : size + 1] = by_light * np.append(np.full(size, point[size]), 1.0)
            columns[-2:, -2:] = np.eye(2)
            return np.asarray(self.factor @ columns)

        end = least_squares(
            residual, start, slopes, method="lm", x_scale="jac", ftol=1e-4, xtol=1e-4, gtol=1e-6, max_nfev=EVALUATIONS
        )
        return Optimum(self._state(end.x), 2 * float(end.cost))

    def _state(self, point: Floats) -> State:
        """With the tilts turned into a shift of the pose: a wave RMS of tilt moves the light by 4 lambda_ref N."""
        by_column, by_row = 4 * point[:2] * self.optics.reference_um * self.optics.f_number / self.optics.pitch_um
        pose = self.state.poses[0].shifted(-by_row, -by_column)
        return replace(
            self.state, waves=point[2:-2], poses=(pose,), scales=point[-2:-1].copy(), ambients=point[-1:].copy()
        )

    def _add(self, found: Optimum) -> None:
        known = next((o for o in self.optima if abs(o.misfit - found.misfit) < SAME * found.misfit), None)
        if known is None:
            self.optima = sorted([*self.optima, found], key=lambda o: o.misfit)
        else:
            known.met += 1


@lru_cache(maxsize=8)
def _components(pupil: Pupil) -> tuple[Singles, Floats]:
    """(components, size^2) orthonormal, of the departures of random wavefronts' PSFs from the perfect one; and that one."""
    rng, perfect = np.random.default_rng(0), pupil.psf(np.zeros(len(pupil.noll)))
    scale = pupil.wavelength_um / pupil.reference_um
    drawn = np.empty((DRAWS, perfect.size))
    for row in drawn:
        direction = rng.normal(size=len(pupil.noll) - len(TILTS))
        waves = direction / np.linalg.norm(direction) * rng.uniform(*DRAWN_WAVES)
        tilts = rng.normal(scale=DRAWN_TILT, size=len(TILTS))
        row[:] = (pupil.psf(scale * np.concatenate([tilts, waves])) - perfect).ravel()
    weights, vectors = scipy.linalg.eigh(drawn @ drawn.T, subset_by_index=(DRAWS - COMPONENTS, DRAWS - 1))
    kept = weights > 1e-12 * weights[-1]  # few modes span few dimensions
    return ((vectors[:, kept] / np.sqrt(weights[kept])).T @ drawn).astype(np.float32), perfect
