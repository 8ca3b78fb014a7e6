"""How often two sessions of one lens are told apart: `python -m benchmarks.same_lens make FOLDER`, then `judge FOLDER`.

`make` simulates sessions in pairs and fits them: photographs of one channel at two ranges, 112 pixels a side, with own noise,
tape and pose. Three of four pairs are of one lens; in the fourth the second lens has more coma. It goes on where it ended, and
runs until it is stopped or the pairs are made. `judge` prints what `labkit compare` says of them.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path
from time import process_time

import numpy as np
from scipy import stats

from benchmarks.random_sessions import Drawn, _ranges_at, _session, make
from labkit.analysis.fit import fit
from labkit.catalogue.compare import compare_results
from labkit.drivers.simulated.world import TrueLens
from labkit.results import Results

DECENTRED_WAVES = 0.01
"""RMS of the coma, Noll 7 and 8, that every fourth pair's second lens has more."""

ROWS = 112
BEST_MM = 3013.2
MODES_STD = 0.02
"""Of each mode 5 to 15, waves RMS."""

SEED = 20


def pair(index: int) -> tuple[Drawn, Drawn, float]:
    """Draw a pair: two sessions with one plan, and the second lens's additional coma, waves RMS."""
    rng = np.random.default_rng([SEED, index])
    modes = dict(zip(range(5, 16), rng.normal(0, MODES_STD, 11).tolist(), strict=True))
    lens = TrueLens(
        f_number=float(rng.uniform(2.5, 4)),
        wavelength_nm={"G": float(rng.uniform(525, 555))},
        best_focus_mm={"G": BEST_MM},
        pupil_magnification=float(rng.uniform(0.7, 1.4)),
        stated_waves=modes,
    )
    more = DECENTRED_WAVES if index % 4 == 3 else 0.0
    angle = rng.uniform(0, 2 * np.pi)
    comatic = {
        7: modes[7] + more * float(np.sin(angle)),
        8: modes[8] + more * float(np.cos(angle)),
    }
    other = replace(lens, stated_waves=modes | comatic)
    stations = np.array([-0.6, 0.5]) + rng.uniform(-0.1, 0.1, 2)
    first, second = (
        _one(one, _ranges_at(one, BEST_MM, stations), rng) for one in (lens, other)
    )
    tables = ("lens", "channel")
    stated = {name: getattr(first.plan, name) for name in tables}
    shared = {
        "lens": stated["lens"].model_dump(exclude_unset=True),
        "channel": [one.model_dump(exclude_unset=True) for one in stated["channel"]],
    }
    return first, replace(second, plan=second.plan.replace(**shared)), more


def _one(lens: TrueLens, ranges_mm: list[float], rng: np.random.Generator) -> Drawn:
    """Draw a session of a lens, of one photograph a range."""
    while True:
        drawn = _session(lens, ranges_mm, "around", rng)
        if drawn.settings.sensor.rows == ROWS:
            camera = {"frames_per_range": 1, "flats_per_range": 2, "darks": 2}
            return replace(drawn, plan=drawn.plan.replace(camera=camera))


def make_pairs(out: Path, first: int, step: int, pairs: int, minutes: float) -> None:
    """Make every so many of the pairs, but those that are made."""
    out.mkdir(parents=True, exist_ok=True)
    began = process_time()
    for index in range(first, pairs, step):
        if (out / str(index)).exists() or process_time() - began > 60 * minutes:
            continue
        with tempfile.TemporaryDirectory() as base:
            *sessions, more = pair(index)
            for name, drawn in zip("AB", sessions, strict=True):
                folder = Path(base) / name
                make(drawn, folder)
                fit(folder, workers=1)
                for big in (
                    "frames",
                    "results/latest/psf.npz",
                    "results/latest/residuals.npz",
                ):
                    path = folder / big
                    shutil.rmtree(path) if path.is_dir() else path.unlink()
            (Path(base) / "more.json").write_text(json.dumps(more))
            shutil.copytree(base, out / f"{index}.part", dirs_exist_ok=True)
            (out / f"{index}.part").rename(out / str(index))
        print(f"pair {index}, {process_time() - began:.0f} s", flush=True)


def judge(out: Path) -> None:
    """Print how the p-values of pairs of one lens are distributed, and how many of the others are told apart."""
    p_values = {0.0: list[float](), DECENTRED_WAVES: list[float]()}
    for folder in sorted(out.glob("*/more.json")):
        a, b = (Results.load(folder.parent / name) for name in "AB")
        p = compare_results(a, b).p_value
        p_values[json.loads(folder.read_text())].append(p)
    same, other = map(np.array, p_values.values())
    print(f"{same.size} pairs of one lens: KS p {stats.kstest(same, 'uniform').pvalue:.3f}")
    for level in (0.01, 0.05, 0.5):
        print(f"  p below {level:g}: {np.mean(same < level):.3f}")
    if other.size:
        found = np.mean(other < 0.01)
        print(f"{other.size} pairs of another coma, p below 0.01: {found:.3f}")


def main() -> None:
    """Make pairs, or judge those made."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["make", "judge"])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--step", type=int, default=1)
    parser.add_argument("--pairs", type=int, default=280)
    parser.add_argument("--minutes", type=float, default=60.0)
    args = parser.parse_args()
    if args.what == "judge":
        judge(args.folder)
    else:
        make_pairs(args.folder, args.first, args.step, args.pairs, args.minutes)


if __name__ == "__main__":
    main()
