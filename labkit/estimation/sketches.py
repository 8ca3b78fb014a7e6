"""Quick problems to search in, and the defocus that a sweep over them names."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from labkit.estimation.climb import NoisePrior, Problem, State
from labkit.estimation.likelihood import FrameData
from labkit.estimation.settings import SETTINGS
from labkit.imaging.model import ForwardModel
from labkit.imaging.optics import Optics
from labkit.imaging.warp import Pose
from labkit.imaging.window import WINDOW_AIRY
from labkit.optics.wavefront import FARTHEST_WAVES
from labkit.target import Target


@dataclass
class Sketches:
    """Quick problems of one frame: part of the band, or a PSF's window no wider than needed. pose: of the target, about.

    Each is made when it is first wanted, and kept; it depends on nothing but its band and its window.
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
        """Share of the pass band for sketches: never less than half as much again as the pixels' own Nyquist frequency."""
        return min(1.0, max(SETTINGS.sketch_band, 0.75 / self.optics.pitch_um * self.optics.airy_um))

    def near(self, state: State) -> bool:
        """Whether defocus is so small that other modes decide what a picture looks like."""
        defocus = state.waves[0] if self.optics.noll[0] == 4 else 0.0
        return bool(abs(defocus) * self.optics.reference_um <= SETTINGS.near_waves * self.optics.wavelength_um)

    def problem(self, state: State, band: float) -> Problem:
        """For wavefronts of about a state's."""
        key = band, SETTINGS.near_window_airy if self.near(state) else WINDOW_AIRY
        if key not in self._made:
            shape = self.frame.counts.shape
            model = ForwardModel.build(self.optics, self.target, shape, self.pose, band=band, window_airy=key[1])
            self._made[key] = Problem(model, (self.frame,), self.noise)
        return self._made[key]


def sweep(sketches: Sketches, start: State) -> list[State]:
    """States at each of a row of defocus values, their light fitted, the one with the least sum of squares first.

    The other modes are the start's. Where there are none the twin covers negative values; else they are tried too. The row
    goes on outwards while its last value is the best. The pose is left alone: a pixel hardly changes the order.
    """
    scale, frame = sketches.optics.wavelength_um / sketches.optics.reference_um, sketches.frame
    light, counts = frame.illumination[frame.used], frame.counts[frame.used]
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
        (relative,) = problem.relative(state, drawing)
        columns = np.stack([light * relative, light], axis=1)
        levels = np.asarray(np.linalg.lstsq(columns, counts)[0], np.float64)
        misfit = float(np.sum((columns @ levels - counts) ** 2))
        swept.append((misfit, replace(state, scales=levels[:1], ambients=levels[1:]) if levels[0] > 0 else state))
        if misfit < best:
            best, outermost = misfit, value
        if not values and abs(outermost) == abs(value) < FARTHEST_WAVES:
            values += [sign * np.sqrt(2) * abs(value) for sign in signs]
    return [state for _, state in sorted(swept, key=lambda entry: entry[0])]
