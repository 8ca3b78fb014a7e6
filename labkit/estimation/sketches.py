"""Sketches: coarse models of one frame for a quick search, and a sweep over defocus."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from labkit.estimation.climb import NoisePrior, Problem, State
from labkit.estimation.likelihood import FrameData
from labkit.estimation.settings import SETTINGS
from labkit.imaging.model import ForwardModel
from labkit.imaging.optics import Optics
from labkit.imaging.scene import Drawing
from labkit.imaging.warp import Pose
from labkit.imaging.window import WINDOW_AIRY
from labkit.optics.wavefront import FARTHEST_WAVES
from labkit.target import Target


@dataclass
class Sketches:
    """Coarse problems of one frame: part of the pass band, or a narrow PSF window.

    Each problem is built on first use and cached; it depends on band and window only.

    Attributes
    ----------
    optics : lens, light and sensor
    target : the target as shown
    frame : counts, with calibration
    pose : approximate pose of the target
    noise : calibrated noise
    seed : seed of random starts
    """

    optics: Optics
    target: Target
    frame: FrameData
    pose: Pose
    noise: NoisePrior
    seed: int | Sequence[int] = 1
    _made: dict[tuple[float, float], Problem] = field(default_factory=dict, repr=False)

    @property
    def band(self) -> float:
        """Share of the pass band for sketches, at least 1.5 times the Nyquist frequency of the pixels."""
        return min(
            1.0,
            max(SETTINGS.sketch_band, 0.75 / self.optics.pitch_um * self.optics.airy_um),
        )

    def near(self, state: State) -> bool:
        """Whether defocus is so small that other modes decide what a picture looks like."""
        defocus = state.waves[0] if self.optics.noll[0] == 4 else 0.0
        return bool(
            abs(defocus) * self.optics.reference_um
            <= SETTINGS.near_waves * self.optics.wavelength_um
        )

    @property
    def wide(self) -> Problem:
        """The sketch for wavefronts of any defocus."""
        return self._problem(self.band, WINDOW_AIRY)

    def problem(self, state: State, band: float) -> Problem:
        """Return a problem for wavefronts similar to a state's, over a share `band` of the pass band."""
        return self._problem(
            band, SETTINGS.near_window_airy if self.near(state) else WINDOW_AIRY
        )

    def _problem(self, band: float, window_airy: float) -> Problem:
        key = band, window_airy
        if key not in self._made:
            shape = self.frame.counts.shape
            model = ForwardModel.build(
                self.optics,
                self.target,
                shape,
                self.pose,
                band=band,
                window_airy=window_airy,
            )
            self._made[key] = Problem(model, (self.frame,), self.noise)
        return self._made[key]


def sweep(sketches: Sketches, start: State) -> list[State]:
    """Fit the light at each of a row of defocus values.

    The other modes are the start's. If all are 0, negative defocus is covered by the twin; else negative values are tried too.
    The row continues outwards while its last value is the best. The pose is fixed, for a pixel hardly changes the order.

    Returns
    -------
    one state for each defocus, the least sum of squares first
    """
    scale = sketches.optics.wavelength_um / sketches.optics.reference_um
    signs = (1, -1) if start.waves[1:].any() else (1,)
    values = [sign * value for value in SETTINGS.swept_waves for sign in signs]
    swept, best, outermost = list[tuple[float, State]](), np.inf, 0.0
    problem = sketches.problem(start, sketches.band)
    drawing = problem.draw(start)
    while values:
        value = values.pop(0)
        state = replace(start, waves=np.append(value * scale, start.waves[1:]))
        if problem is not sketches.problem(state, sketches.band):
            problem = sketches.problem(state, sketches.band)
            drawing = problem.draw(start)
        misfit, lit = fitted_light(problem, state, drawing)
        swept.append((misfit, lit))
        if misfit < best:
            best, outermost = misfit, value
        if not values and abs(outermost) == abs(value) < FARTHEST_WAVES:
            values += [sign * np.sqrt(2) * abs(value) for sign in signs]
    return [state for _, state in sorted(swept, key=lambda entry: entry[0])]


def fitted_light(problem: Problem, state: State, drawing: Drawing) -> tuple[float, State]:
    """Return the least sum of squares of the first frame over its light, and the state with that light if it is positive.

    Parameters
    ----------
    problem : the frame and its model
    state : pose and wavefront
    drawing : the target at the state's pose
    """
    frame = problem.frames[0]
    light, counts = frame.illumination[frame.used], frame.counts[frame.used]
    (relative,) = problem.relative(state, drawing)
    columns = np.stack([light * relative, light], axis=1)
    levels = np.asarray(np.linalg.lstsq(columns, counts)[0], np.float64)
    misfit = float(np.sum((columns @ levels - counts) ** 2))
    if levels[0] <= 0:
        return misfit, state
    return misfit, replace(state, scales=levels[:1], ambients=levels[1:])
