"""Compute labkit/experiments/methods/psf_basis.npz by Algorithm 4.9, in six minutes.

python -m benchmarks.make_psf_basis
"""

import io
from pathlib import Path

import numpy as np

from labkit.estimation.climb import Problem, maximize
from labkit.estimation.likelihood import predict
from labkit.estimation.settings import SETTINGS
from labkit.experiments import methods
from labkit.experiments.conditions import (
    FRAME,
    NOLL,
    carpet,
    draw_trial,
    optics,
    random_waves,
    upright,
)
from labkit.experiments.methods.psf_basis import find_psf_basis, noise_free
from labkit.imaging.model import ForwardModel
from labkit.storage.files import write_atomically

WAVEFRONTS, STARTS, DEGREES, SEED = 40, 3, 16, 8


def main() -> None:
    """Maximise from random starts in noise-free pictures of random wavefronts; keep what ends elsewhere."""
    model = ForwardModel.build(
        optics(NOLL),
        carpet(),
        (FRAME, FRAME),
        upright(),
        window_airy=SETTINGS.near_window_airy,
    )
    cases = []
    for seed in range(WAVEFRONTS):
        rng = np.random.default_rng([SEED, seed])
        trial = draw_trial(rng)
        truth = trial.state(trial.waves)
        problem = noise_free(Problem(model, (trial.frame,), trial.noise), truth)
        for _ in range(STARTS):
            end = maximize(
                problem,
                trial.state(random_waves(rng, len(NOLL), 0.2)),
                max_steps=40,
                tolerance=0.1,
            )
            if np.linalg.norm(trial.error(end.state.waves)) > 0.02:
                relative = problem.relative(end.state)[0]
                variance = predict(relative, problem.frames[0], end.state.detectors()[0])[1]
                cases.append((problem, end.state, 1 / variance))
    basis = find_psf_basis(cases, DEGREES)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, directions=basis.directions.astype(np.float32))
    path = Path(methods.__file__).with_name("psf_basis.npz")
    write_atomically(path, buffer.getvalue())
    print(
        f"{len(cases)} wrong optima of {WAVEFRONTS * STARTS} starts; {path.stat().st_size} bytes"
    )


if __name__ == "__main__":
    main()
