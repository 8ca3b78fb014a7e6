"""Measure a lens: python examples/measure_lens.py labkit-demo/plan.toml my-session

Photographs the target at every range of the plan, fits wavefronts and best focus, writes the report. Run it again
after an interruption: it goes on where it stopped. (`labkit demo` leaves a plan to begin with.)
"""

import sys
from pathlib import Path

from labkit.analysis.results import Results
from labkit.analysis.wavefronts import fit_session
from labkit.capture.capture import capture
from labkit.devices.registry import open_devices
from labkit.plan import load_plan
from labkit.report.html import write_report
from labkit.session.session import begin


def measure(plan_path: Path, folder: Path) -> Results:
    with open_devices(load_plan(plan_path)) as devices, begin(plan_path, folder, resume=True) as session:
        capture(session, devices)
        results = fit_session(session)
    print("report:", write_report(session.results_folder()))
    return results


if __name__ == "__main__":
    focus = measure(Path(sys.argv[1]), Path(sys.argv[2])).focus
    if focus is not None:
        for channel, best_mm, std_mm in zip(focus.channels, focus.best_focus_mm, focus.std, strict=False):
            print(f"best focus {channel}: {best_mm:.2f} ± {std_mm:.2f} mm")
