"""Measure a lens: python examples/measure_lens.py labkit-demo/plan.toml my-session

Photographs the target at every range of the plan, fits wavefronts and best focus, writes the report. Run it again
after an interruption: it goes on where it stopped. (`labkit demo` leaves a plan to begin with.)
"""

import sys
from pathlib import Path

import labkit


def measure(plan_path: Path, folder: Path) -> labkit.Results:
    """Capture, fit, report; then what a lens test asks of each channel at best focus."""
    plan = labkit.Plan.load(plan_path).replace(fit={"zernike_noll": (4, 15)})
    with labkit.open_devices(plan) as bench:
        session = labkit.capture(plan, bench, folder, resume=True)
    results = labkit.fit(session)
    print("report:", labkit.write_report(results))
    if results.focus is not None:
        for channel, best in results.focus.best_focus_mm.items():
            print(f"best focus {channel}: {best}")
    for shift in results.longitudinal_colour():
        print(f"longitudinal colour {shift.name}: {shift.range_shift}")
    print(results.headline)
    for channel in results.channels:
        lens = results.nearest_focus(channel).best
        print(f"{channel}: Strehl ratio {lens.strehl}, RMS {lens.rms_nm}")
        for frequency in (25.0, 50.0, 100.0):
            print(f"  MTF at {frequency:g} cycles/mm: {lens.mtf_at(frequency, 'x')}")
    return results


if __name__ == "__main__":
    measure(Path(sys.argv[1]), Path(sys.argv[2]))
