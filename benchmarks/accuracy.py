"""How well sessions of other lenses, ranges and seeds than the demo's are fitted: `python -m benchmarks.accuracy`.

Each session is captured on the simulated bench and fitted without its truth, which is compared only afterwards.
"""

import argparse
import re
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from labkit.acquisition.capture import run_plan
from labkit.analysis.fit import fit
from labkit.demo import DEMO_PLAN
from labkit.devices.context import DeviceContext
from labkit.devices.registry import open_devices
from labkit.drivers.simulated.world import Truth
from labkit.plan import Plan
from labkit.results import Results, Wavefront
from labkit.session.session import Session


@dataclass(frozen=True, slots=True)
class Case:
    """A lens at three ranges, seen by one simulated world."""

    focal_mm: float
    f_number: float
    ranges_mm: tuple[int, int, int]
    order: int
    size_mm: float
    seed: int

    def plan(self) -> str:
        """The demo's plan with this case's numbers."""
        text = DEMO_PLAN.format(address=f"simulated:seed={self.seed}")
        changes = {
            "focal_length_mm": self.focal_mm,
            "f_number": self.f_number,
            "order": self.order,
            "size_mm": self.size_mm,
            "ranges_mm": list(self.ranges_mm),
            "range_at_zero_mm": self.ranges_mm[0] - 50.0,
        }
        for key, value in changes.items():
            text = re.sub(rf"(?m)^{key} = [^#\n]*", f"{key} = {value} ", text)
        return text


CASES = (
    *(Case(70.0, 2.8, (3000, 3200, 3300), 4, 23.4, seed) for seed in (11, 12, 13)),
    *(Case(50.0, 4.0, (1500, 1560, 1620), 4, 23.4, seed) for seed in (21, 22)),
    Case(70.0, 2.8, (500, 505, 512), 3, 5.2, 31),
    Case(70.0, 4.0, (500, 506, 514), 3, 5.2, 32),
)


def run(case: Case, folder: Path) -> list[dict[str, Any]]:
    """Capture, fit, and compare with the truth; one row a fit. Prints a summary of the case."""
    text, context = case.plan(), DeviceContext()
    with (
        open_devices(Plan.parse(text, Path()), context=context) as devices,
        Session.create(folder, text, Path()) as session,
    ):
        run_plan(session, devices)
        (bench,) = context.shared.values()
    results = fit(folder)
    rows = [_row(w, bench.truth) for w in results]
    _print(case, rows, results, bench.truth)
    return rows


def _row(w: Wavefront, truth: Truth) -> dict[str, Any]:
    """A wavefront beside its truth."""
    modes, visits = (
        truth.modes_waves[w.channel],
        {visit.range_mm: visit for visit in truth.visits},
    )
    true = np.array([modes.get(j, 0.0) for j in w.noll])
    assert w.range_mm is not None
    true[0] = visits[w.range_mm].defocus_waves[w.channel]
    error = w.waves - true
    return {
        "defocus": abs(error[0]),
        "rms": float(np.linalg.norm(error)),
        "z": error / w.std,
        "chi2": w.chi2_per_pixel,
        "accepted": w.accepted,
        "seconds": w.seconds,
    }


def _print(case: Case, rows: list[dict[str, Any]], results: Results, truth: Truth) -> None:
    """One session's errors, in words."""
    focus = results.focus
    assert focus is not None
    off = [best.value - truth.best_focus_mm[c] for c, best in focus.best_focus_mm.items()]
    magnification = focus.pupil_magnification.value - truth.pupil_magnification
    std = [
        *(best.std for best in focus.best_focus_mm.values()),
        focus.pupil_magnification.std,
    ]
    z_focus = np.append(off, magnification) / std
    chi2 = [row["chi2"] for row in rows]
    print(
        f"{case}:",
        f"defocus error <= {max(row['defocus'] for row in rows):.4f} waves",
        f"wavefront error <= {max(row['rms'] for row in rows):.4f} waves",
        f"chi2 per pixel {min(chi2):.3f} to {max(chi2):.3f}",
        f"accepted {sum(row['accepted'] for row in rows)} of {len(rows)}",
        f"best focus error <= {np.abs(off).max():.4f} mm",
        f"mp error {magnification:+.4f} +- {focus.pupil_magnification.std:.4f}",
        f"errors of focus over standard errors {np.round(z_focus, 1).tolist()}",
        f"{sum(row['seconds'] for row in rows):.0f} s of fitting",
        sep="\n  ",
        flush=True,
    )


def main() -> None:
    """Run the cases asked for and sum up."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "cases",
        nargs="*",
        type=int,
        help="which of the cases, counted from 0; all by default",
    )
    chosen = parser.parse_args().cases or range(len(CASES))
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as base:
        for index in chosen:
            rows += run(CASES[index], Path(base) / str(index))
    z = np.concatenate([row["z"] for row in rows])
    print(
        f"{len(rows)} fits, {z.size} modes: errors over standard errors have mean {z.mean():+.2f}, std {z.std():.2f}, "
        f"{np.mean(np.abs(z) > 2):.1%} beyond 2 (4.6 % expected), {np.mean(np.abs(z) > 3):.1%} beyond 3 (0.3 %)"
    )


if __name__ == "__main__":
    main()
