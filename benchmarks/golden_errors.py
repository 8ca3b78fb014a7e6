"""Errors over stated errors of golden sessions' results: `python -m benchmarks.golden_errors GOLDEN SESSION...`.

GOLDEN is the folder of the truth files; a session's folder has the name of its truth. A line for each number: the largest error
over standard error of its kind. Numbers beyond four are marked. Ranges and channels without a fit are left out; where the sign
is open, the twin that is nearer to the truth counts.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import labkit
from labkit.key import Key
from labkit.optics.metrics import psf
from labkit.results import Results, Wavefront
from labkit.uncertain import Uncertain

FAR_Z = 4.0
BRIGHT = 0.02
"""Of the PSF's maximum: darker samples are left out."""


def z_of(number: Uncertain, true: float) -> float:
    """Error over standard error."""
    return (number.value - true) / number.std


def lens_errors(results: Results, truth: dict[str, Any]) -> Iterator[tuple[str, float]]:
    """Of the lens and of best focus."""
    lens, focus = results.lens, results.focus
    for channel, best in (focus.best_focus_mm if focus else {}).items():
        yield f"best focus {channel}", z_of(best, truth["best_focus_mm"][channel])
    if lens is not None and "f_number" in truth:
        yield "f-number", z_of(lens.f_number, truth["f_number"])
        yield "focal length", z_of(lens.focal_length, truth["focal_length_mm"])
        yield "pupil magnification", z_of(lens.pupil_magnification, truth["mp"])


def wavefront_errors(
    w: Wavefront, waves: list[float], image: Any, spacing_um: float
) -> Iterator[tuple[str, float]]:
    """Of modes, RMS, and the PSF with its maximum. waves: from mode 4 on, as far as both go; image: the true PSF."""
    shared = min(len(waves), len(w.noll))
    yield "modes", float(np.abs((w.waves[:shared] - waves[:shared]) / w.std[:shared]).max())
    if shared == len(w.noll):
        yield "RMS", z_of(w.rms((4,)), float(np.linalg.norm(waves[1:shared])))
    true = np.asarray(image, float) / np.sum(image)
    ours = psf(w.fitted, spacing_um, len(true))
    bright = true > BRIGHT * true.max()
    yield "PSF, RMS", float(np.sqrt(np.mean(((ours.value - true) / ours.std)[bright] ** 2)))
    strehl = w.strehl
    yield "Strehl ratio", z_of(strehl, strehl.value * true.max() / ours.value.max())


def nearest_sign(w: Wavefront, waves: list[float]) -> Wavefront:
    """Return the wavefront, or its twin if the sign is open and the twin is nearer to the truth."""
    return w if not w.sign_open or w.waves[0] * waves[0] > 0 else w.twin


def main() -> None:
    """Print the table."""
    golden, *sessions = map(Path, sys.argv[1:])
    for session in sessions:
        results = labkit.Results.load(session)
        truth = json.loads((golden / f"truth-{session.name}.json").read_text())
        images = np.load(golden / f"truth-{session.name}-psf.npz")
        worst: dict[str, float] = {}
        found = list(lens_errors(results, truth))
        for frame in truth["frames"]:
            key = Key(frame["range_mm"], frame["channel"])
            if key not in {w.key for w in results.wavefronts}:
                continue
            waves = [frame["defocus_waves"], *frame["alpha"].values()]
            w = nearest_sign(results[key], waves)
            found += wavefront_errors(w, waves, images[str(w.key)], truth["psf_spacing_um"])
        for name, z in found:
            worst[name] = max(worst.get(name, 0.0), z, key=abs)
        told = ", ".join(
            f"{name} {z:.1f}{' !' if abs(z) > FAR_Z else ''}" for name, z in worst.items()
        )
        print(f"{session.name}: {told}", flush=True)


if __name__ == "__main__":
    main()
