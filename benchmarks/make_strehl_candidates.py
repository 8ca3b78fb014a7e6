"""Compute the shells of thesis (4.39), labkit/experiments/methods/strehl_candidates.npz.

python -m benchmarks.make_strehl_candidates
"""

import io
from pathlib import Path

import numpy as np

from labkit.experiments import methods
from labkit.experiments.methods.strehl_candidates import (
    CANDIDATE_NOLL,
    highest_on_shell,
    is_trivial,
    strehl,
)
from labkit.storage.files import write_atomically

SHELLS = np.arange(0.02, 0.2001, 0.02)
STARTS, SEED, SAME = (
    100,
    39,
    0.1,
)  # starts a shell; the same maximum within this share of its RMS


def main() -> None:
    """Maximise on every shell from random starts and the maxima of the shell below; keep the different ends."""
    rng = np.random.default_rng(SEED)
    rms, waves, below = [], [], np.empty((0, len(CANDIDATE_NOLL)))
    for shell in SHELLS:
        ends: list[np.ndarray] = []
        for start in [*below, *rng.normal(size=(STARTS, len(CANDIDATE_NOLL)))]:
            end = highest_on_shell(start, shell)
            if not any(is_trivial(end, other, SAME * shell) for other in ends):
                ends.append(end)
        ends.sort(key=lambda end: -strehl(end)[0])
        below = np.array(ends)
        rms += [shell] * len(ends)
        waves += ends
        best, worst = strehl(ends[0])[0], strehl(ends[-1])[0]
        print(
            f"{shell:.2f} waves: {len(ends)} maxima, Strehl ratio {worst:.4f} to {best:.4f}",
            flush=True,
        )
    buffer = io.BytesIO()
    np.savez_compressed(buffer, rms=np.array(rms), waves=np.array(waves, np.float32))
    path = Path(methods.__file__).with_name("strehl_candidates.npz")
    write_atomically(path, buffer.getvalue())
    print(f"{path.stat().st_size} bytes")


if __name__ == "__main__":
    main()
