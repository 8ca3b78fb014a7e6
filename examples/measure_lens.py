"""Measure a lens: python examples/measure_lens.py labkit-demo/plan.toml my-session

Photographs the target at every range of the plan, fits wavefronts and best focus, writes the report. Run it again
after an interruption: it goes on where it stopped. (`labkit demo` leaves a plan to begin with.)
"""

import sys
from pathlib import Path

import numpy as np

import labkit


def measure(plan_path: Path, folder: Path) -> labkit.Results:
    """Capture, fit, report; then what a lens test asks of the first channel's sharpest wavefront."""
    plan = labkit.Plan.load(plan_path).replace(fit={"zernike_noll": (4, 15)})
    with labkit.open_devices(plan) as bench:
        session = labkit.capture(plan, bench, folder, resume=True)
    results = labkit.fit(session)
    print("report:", labkit.write_report(results))
    if results.focus is not None:
        for channel, best in results.focus.best_focus_mm.items():
            print(f"best focus {channel}: {best}")
    w = min(results, key=lambda w: abs(w[4].value))
    print(f"nearest to focus: {w.range_mm:g} mm, {w.channel}")
    print("  defocus", w[4], "  Strehl ratio", w.strehl)
    mtf = w.mtf(np.array([25.0, 50.0, 100.0]))
    for frequency, value, std in zip(mtf.frequency_per_mm, mtf.value, mtf.std, strict=True):
        print(f"  MTF at {frequency:g} cycles/mm: {labkit.Uncertain(value, std)}")
    return results


if __name__ == "__main__":
    measure(Path(sys.argv[1]), Path(sys.argv[2]))
