"""How far labkit's results lie from the truth: `python -m tests.golden.measure SEED...`, a row of errors for each session."""

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.interpolate import RectBivariateSpline

from labkit.cli import run

from .simulate import write_session

Floats = npt.NDArray[np.float64]


def import_and_fit(folder: Path, session: Path, *options: str) -> None:
    """Import and fit through the commands, as a lab would."""
    for command in (
        ["import", str(folder / "frames.csv"), str(folder / "plan.toml"), str(session)],
        ["fit", str(session), "--workers", "1", *options],
    ):
        if (status := run([*command, "--quiet"])) != 0:
            raise RuntimeError(f"labkit {' '.join(command)} ended with status {status}")


def errors(truth: Path, session: Path) -> dict[str, float]:
    """The largest errors of a session's results beside the folder of its truth; errors over standard errors as z."""
    true: dict[str, Any] = json.loads((truth / "truth.json").read_text())
    results: dict[str, Any] = json.loads(
        (session / "results/latest/results.json").read_text()
    )
    fits = {(w["range_mm"], w["channel"]): w for w in results["wavefronts"]}
    waves = {
        key: np.subtract(fits[key]["waves_rms"], w["waves"])
        for w in true["wavefronts"]
        if (key := _key(w))
    }
    z = np.concatenate([waves[key] / fits[key]["std"] for key in waves])
    focus = {
        c: b["value"] - true["best_focus_mm"][c]
        for c, b in results["focus"]["best_focus_mm"].items()
    }
    focus_z = [
        error / results["focus"]["best_focus_mm"][c]["std"] for c, error in focus.items()
    ]
    mp = results["focus"]["pupil_magnification"]
    every = list(fits.values())
    return {
        "defocus_waves": max(abs(e[0]) for e in waves.values()),
        "mode_waves": max(np.abs(e[1:]).max() for e in waves.values()),
        "wavefront_waves": max(float(np.linalg.norm(e)) for e in waves.values()),
        "psf_l1": _psf_error(truth / "psf.npz", session / "results/latest/psf.npz"),
        "best_focus_mm": max(abs(e) for e in focus.values()),
        "focus_z": max(abs(e) for e in [*focus_z, (mp["value"] - true["mp"]) / mp["std"]]),
        "z_rms": float(np.sqrt(np.mean(z**2))),
        "z_most": float(np.abs(z).max()),
        "chi2": max(abs(w["chi2_per_pixel"] - 1) for w in every),
        "gain_relative": max(abs(w["gain"] / true["gain"] - 1) for w in every),
        "rejected": float(
            sum(not w["global_test"]["accepted"] for w in every) + len(waves) - len(every)
        ),
    }


def _key(wavefront: dict[str, Any]) -> tuple[float, str]:
    return wavefront["range_mm"], wavefront["channel"]


def _psf_error(truth: Path, measured: Path) -> float:
    """Largest summed absolute difference of PSFs, as a share of the light in the window of the truth."""
    ours, theirs = np.load(measured), np.load(truth)
    worst = 0.0
    for name in set(theirs.files) - {"spacing_um"}:
        true = theirs[name]
        own = resampled(
            ours[f"psf_{name}"],
            float(ours["spacing_um"]),
            len(true),
            float(theirs["spacing_um"]),
        )
        worst = max(worst, float(np.abs(own / own.sum() - true / true.sum()).sum()))
    return worst


def resampled(psf: Floats, spacing_um: float, size: int, new_um: float) -> Floats:
    """A PSF at samples of another spacing, its centre kept in the middle."""
    old = (np.arange(len(psf)) - len(psf) // 2) * spacing_um
    new = (np.arange(size) - size // 2) * new_um
    return np.asarray(RectBivariateSpline(old, old, psf)(new, new))


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as base:
        for seed in sys.argv[1:] or ["0"]:
            folder = Path(base) / seed
            folder.mkdir()
            write_session(folder, int(seed))
            import_and_fit(folder, folder / "session")
            print(
                f"seed {seed}:",
                ", ".join(
                    f"{k} {v:.3g}" for k, v in errors(folder, folder / "session").items()
                ),
                flush=True,
            )
