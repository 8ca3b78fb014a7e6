"""How fast: `make bench`. Medians of several runs, and ratios taken in the same run."""

from collections.abc import Callable
from statistics import median
from time import perf_counter

import numpy as np
import scipy.fft

from labkit.imaging.model import ForwardModel, Optics
from labkit.imaging.warp import Pose
from labkit.inference.likelihood import FrameData
from labkit.inference.solve import NoisePrior, Problem, State, climb
from labkit.target import CellTarget

NOLL = tuple(range(4, 16))


def seconds(work: Callable[[], object], runs: int = 5) -> float:
    """Median time of a piece of work, after one run that does not count."""
    work()
    times = []
    for _ in range(runs):
        began = perf_counter()
        work()
        times.append(perf_counter() - began)
    return median(times)


def carpet(order: int) -> CellTarget:
    """A carpet of unit half size."""
    cells = np.zeros((1, 1))
    for _ in range(order):
        cells = np.block([[cells] * 3, [cells, np.ones_like(cells), cells], [cells] * 3])
    return CellTarget(cells, (2.0, 2.0))


def square(centre: float, half: float) -> Pose:
    """A pose without tilt or roll."""
    corners = np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]]) * half + centre
    return Pose.from_corners(corners + 0.37, (2.0, 2.0))


def evaluation() -> None:
    """Mean and Jacobian of a Bayer frame against the transforms that they cannot do without."""
    optics = Optics(0.55, 0.45, 2.8, 4.78, 4.78, NOLL)
    model = ForwardModel.build(optics, carpet(5), (264, 264))
    used = np.zeros((264, 264), bool)
    used[0::2, 1::2] = used[1::2, 0::2] = True
    waves = np.array([0.6, *np.full(11, 0.02)])
    whole = seconds(lambda: model.evaluate(waves, [square(131, 117)], [used]), 3)
    mean = seconds(lambda: model.means(waves, [square(131, 117)], [used]))
    torus, size = model.blur.torus, model.blur.pupil.size
    image, field = np.ones(torus.fine), np.ones((size, size), complex)
    window = np.ones((size, size))
    floor = (
        seconds(lambda: torus.half_spectrum(image))
        + (len(NOLL) + 1) * seconds(lambda: scipy.fft.fft2(field))
        + (len(NOLL) + 1) * seconds(lambda: torus.half_spectrum_of_window(window))
    )
    print(f"mean and Jacobian, 264x264 Bayer, 12 modes, f/2.8   {whole:.3f} s = {whole / floor:.2f} x its FFTs")
    print(f"mean alone, pose drawn already                      {mean:.3f} s")


def local_fit() -> None:
    """A local fit at the conditions of thesis 3.8, from 0.1 waves away."""
    optics = Optics(0.55, 0.55, 8.0, 5.5, 5.5, NOLL)
    model = ForwardModel.build(optics, carpet(5), (106, 106))
    rng = np.random.default_rng(1)
    used, ones = np.ones((106, 106), bool), np.ones((106, 106))
    truth = rng.normal(size=12) * 0.07
    mean = model.means(truth, [square(52, 35)], [used])[0].reshape(106, 106) * 13000.0
    counts = mean + rng.normal(size=mean.shape) * np.sqrt(0.032 * mean.clip(0) + 43.5**2)
    problem = Problem(model, (FrameData(counts, used, ones, 0 * ones),), NoisePrior(0.032, 0.02, 43.5**2, 0.02))
    near = truth + rng.normal(size=12) * 0.03
    start = State(near, (square(52, 35),), np.array([13000.0]), np.zeros(1), problem.noise.centre)
    solved = climb(problem, start)
    error = np.linalg.norm(solved.state.waves - truth)
    bound = np.sqrt(np.trace(solved.covariance()[:12, :12]))
    took = seconds(lambda: climb(problem, start), 3)
    print(
        f"local fit, 106x106, 12 modes                        {took:.2f} s, error {error:.4f} waves, bound {bound:.4f}"
    )


if __name__ == "__main__":
    evaluation()
    local_fit()
    print("accuracy over other lenses, ranges and seeds: python -m benchmarks.accuracy (about 10 minutes)")
