"""A scan through focus by bluesky's RunEngine, on labkit's devices. Needs: pip install 'labkit[bluesky]'.

    python examples/bluesky_scan.py FOLDER [PLAN.toml]

Without a plan the bench is simulated, but for the rail: that is labkit's GRBL driver on a simulated controller.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from bluesky import RunEngine
from bluesky.plans import scan

from labkit.acquisition.sequence import picture_for
from labkit.devices.bluesky import ScanCamera, ScanRail
from labkit.devices.protocols import ExposureSettings
from labkit.devices.registry import open_devices
from labkit.plan import Plan

SIMULATED = """
lens = { focal_length_mm = 50.0, f_number = 8.0 }
sensor = { pixel_pitch_um = 6.0 }
channel = [{ name = "G", wavelength_nm = 550.0 }]
target = { kind = "sierpinski", order = 2, size_mm = 9.0 }
camera = { address = "simulated:", exposure_s = 0.02 }
rail = { address = "grbl:simulated", ranges_mm = [2000, 2050], range_at_zero_mm = 1970.0, settle_s = 0.0 }
display = { address = "simulated:", pixel_pitch_mm = 0.1, pixels = [400, 400] }
"""


def focus_scan(plan: Plan, folder: Path, stations: int = 3) -> list[tuple[float, str]]:
    """Scan the plan's ranges in equal steps; (range in mm, file) of each stop. Errors are labkit's, or bluesky's."""
    assert plan.camera
    assert plan.rail
    folder.mkdir(parents=True, exist_ok=True)
    rail_settings = plan.rail
    ends = sorted(
        map(
            rail_settings.position_mm,
            (min(rail_settings.ranges_mm), max(rail_settings.ranges_mm)),
        )
    )
    found: list[tuple[float, str]] = []

    def note(kind: str, document: Any) -> None:
        if kind == "event":
            data = document["data"]
            found.append((rail_settings.range_mm(data["rail"]), data["camera_file"]))

    with open_devices(plan) as bench:
        bench.camera.configure(ExposureSettings(plan.camera.exposure_s, plan.camera.iso))
        bench.display.show(picture_for(plan, bench).grey)
        bench.rail.home()
        rail, camera = (
            ScanRail(bench.rail, settle_s=plan.rail.settle_s),
            ScanCamera(bench.camera, folder),
        )
        RunEngine()(scan([camera], rail, *ends, stations), note)
    return found


if __name__ == "__main__":
    chosen = (
        Plan.load(Path(sys.argv[2])) if len(sys.argv) > 2 else Plan.parse(SIMULATED, Path())
    )
    for range_mm, file in focus_scan(chosen, Path(sys.argv[1])):
        print(f"{range_mm:.3f} mm  {file}")
