"""Write photographs to practise on: python examples/practice_photographs.py photographs

They are real DNG files of a simulated bench: a 50 mm f/5.6 lens photographs a Sierpinski carpet of order 3, 10.8 mm wide, on a
display 1500 and 1580 mm away, then the white display at both ranges, then the cap. docs/tutorials/files.md measures that lens.
"""

import sys
from dataclasses import replace
from pathlib import Path

from labkit.acquisition.sequence import picture_for
from labkit.devices.context import DeviceContext
from labkit.devices.protocols import Coverable, ExposureSettings
from labkit.devices.registry import open_devices
from labkit.devices.shared import SharedParts
from labkit.drivers.simulated.bench import Bench
from labkit.drivers.simulated.setup import settings_for
from labkit.plan import Plan

BENCH = "simulated:seed=4"
PLAN = Plan.from_tables(
    {
        "lens": {"focal_length_mm": 50.0, "f_number": 5.6},
        "sensor": {"pixel_pitch_um": 6.0},
        "channel": [{"name": "G", "wavelength_nm": 550.0}],
        "target": {"kind": "sierpinski", "order": 3, "size_mm": 10.8},
        "camera": {"address": BENCH, "exposure_s": 0.02},
        "rail": {
            "address": BENCH,
            "ranges_mm": [1500.0, 1580.0],
            "range_at_zero_mm": 1450.0,
            "settle_s": 0.0,
        },
        "display": {"address": BENCH, "pixel_pitch_mm": 0.1, "pixels": [400, 400]},
    }
)
HALO_UM = 350.0
"""How far the bench follows diffraction: a tenth of the noise lies beyond, and it takes a fifth of the time."""


def bench() -> Bench:
    """What is photographed; its `truth` is what the photographs should give."""
    return Bench(replace(settings_for(PLAN, seed=4), halo_um=HALO_UM))


def photograph(folder: Path) -> None:
    """Take all photographs into a new folder."""
    folder.mkdir(parents=True)
    context = DeviceContext(shared=SharedParts({BENCH: bench()}))
    assert PLAN.rail
    with open_devices(PLAN, context=context) as devices:
        target = picture_for(PLAN, devices).grey
        devices.camera.configure(ExposureSettings(0.02, 100))
        devices.rail.home()
        for range_mm in PLAN.rail.ranges_mm:
            devices.rail.move_to(PLAN.rail.position_mm(range_mm))
            devices.display.show(target)
            devices.camera.expose(folder / f"target_{range_mm:g}")
            devices.display.show("white")
            for number in (1, 2):
                devices.camera.expose(folder / f"white_{range_mm:g}_{number}")
        assert isinstance(devices.camera, Coverable)
        devices.camera.cover(True)
        for number in (1, 2):
            devices.camera.expose(folder / f"dark_{number}")


if __name__ == "__main__":
    photograph(Path(sys.argv[1]))
