"""Sessions of a whole field on the simulated bench: a grid of carpets, several ranges, three colours.

`python -m benchmarks.field_sessions FOLDER [--grid 3 4] [--ranges 1180 1206 1232 1258] [--tile-px 144 --order 3]` writes the
photographs, frames.csv and plan.toml for `labkit import`, and truth.json beside them. By default the session is like
`golden/field-open`: 35 mm f/4, 2 × 3 tiles of 256 pixels. `--cats-eye PER_MM RADIUS` cuts the pupil away from the middle.
"""

from __future__ import annotations

import argparse
import csv
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labkit.devices.protocols import ExposureSettings
from labkit.drivers.simulated.bench import Bench
from labkit.drivers.simulated.camera import SimulatedCamera
from labkit.drivers.simulated.field import FieldTerms
from labkit.drivers.simulated.view import refuse_wild
from labkit.drivers.simulated.world import (
    BenchSettings,
    TrueGrid,
    TrueLens,
    TruePanel,
    TruePose,
    TrueRail,
    TrueSensor,
    Truth,
)
from labkit.plan import Plan
from labkit.targets.sierpinski import carpet_cells

MISALIGNED = FieldTerms(
    field_curvature_per_mm=-0.006,
    sensor_tilt_um_per_mm=(2.4, -1.5),
    coma_waves=(0.03, -0.02),
    coma_per_mm=0.022,
    astigmatism_per_mm=(0.006, -0.010),
    astigmatism_per_mm2=0.016,
    k1_per_mm2=0.0009,
)
"""The numbers of golden field-open's lens."""

LENS = TrueLens(
    focal_length_mm=35.0,
    f_number=4.0,
    pupil_magnification=1.05,
    wavelength_nm={"R": 620.0, "G": 540.0, "B": 460.0},
    best_focus_mm={"R": 1232.0, "G": 1226.0, "B": 1238.0},
    aberration_waves=0.05,
    lateral_colour={"R": -0.00011, "B": 0.00018},
    field_terms=MISALIGNED,
)

RANGES_MM = (1180.0, 1220.0, 1260.0)
FOUR_RANGES_MM = (1180.0, 1206.0, 1232.0, 1258.0)
TILE_PX, PITCH_UM = 256, 5.2

FILLED = 0.66
"""Side of a carpet over the distance of the tiles' centres, at the nearest range."""

ORDER = 4
HALO_UM, SAMPLES = 200.0, 12
"""How far diffraction is followed ring by ring, and the least number of samples to a pixel: at 23,000 electrons 6 samples add
0.15 to chi2 per pixel along edges, 12 add 0.01, against 20 samples."""

EXPOSURE_S, WHITE_ELECTRONS = 0.02, 23_000.0
GAIN = 0.45
FLATS, DARKS = 2, 2


@dataclass(frozen=True, slots=True)
class FieldSession:
    """A session to be made: its bench, its ranges and photographs a range, and the side of a carpet, mm."""

    settings: BenchSettings
    ranges_mm: tuple[float, ...]
    size_mm: float
    frames: int = 1
    order: int = ORDER

    @property
    def plan(self) -> Plan:
        """The plan that is known of the session."""
        lens = self.settings.lens
        grid = self.settings.grid
        return Plan.from_tables(
            {
                "lens": {
                    "focal_length_mm": lens.focal_length_mm,
                    "f_number": lens.f_number,
                },
                "sensor": {"pixel_pitch_um": self.settings.sensor.pitch_um},
                "channel": [
                    {"name": name, "wavelength_nm": nm}
                    for name, nm in lens.wavelength_nm.items()
                ],
                "target": {
                    "kind": "sierpinski",
                    "order": self.order,
                    "size_mm": self.size_mm,
                    "grid": list(grid.shape),
                    "pitch_mm": grid.pitch_mm,
                },
            }
        )

    @property
    def picture(self) -> NDArray[np.uint8]:
        """The panel's picture: a cell of a carpet is a pixel of the panel."""
        grid = self.settings.grid
        cell_mm = self.settings.panel.pitch_mm
        pitch = round(grid.pitch_mm / cell_mm)
        cells = (255 * carpet_cells(self.order)).astype(np.uint8)
        side = len(cells)
        picture = np.zeros([(n - 1) * pitch + side for n in grid.shape], dtype=np.uint8)
        for row, col in np.ndindex(*grid.shape):
            top, left = row * pitch, col * pitch
            picture[top : top + side, left : left + side] = cells
        return picture


def field_session(
    grid: tuple[int, int] = (2, 3),
    ranges_mm: tuple[float, ...] = RANGES_MM,
    lens: TrueLens = LENS,
    seed: int = 1,
    tile_px: int = TILE_PX,
    patch_px: float = 0.0,
    pose: TruePose | None = None,
    order: int = ORDER,
) -> FieldSession:
    """Return a session of a grid of carpets that fills the frame.

    Parameters
    ----------
    grid : rows and columns of carpets
    ranges_mm : stations of the rail
    lens : with its `field_terms`
    seed : of the lens's modes, of the aim and of the noise
    tile_px : pixels of the frame for each tile
    patch_px : 0 for one PSF a tile, else the distance of places whose PSFs are interpolated
    pose : errors of the aim; None for half a degree of roll and tilts of a tenth
    order : of the carpets

    Raises
    ------
    ValueError
        for a lens whose wavefront at the frame's rim is too strong to be simulated
    """
    shape = grid[0] * tile_px, grid[1] * tile_px
    scale = lens.focal_length_mm / (min(ranges_mm) - lens.focal_length_mm)
    pitch_mm = tile_px * PITCH_UM * 1e-3 / scale
    cells = 3**order
    cell_mm = round(FILLED * pitch_mm / cells, 4)
    grid_mm = round(pitch_mm / cell_mm) * cell_mm
    seen_mm = PITCH_UM * 1e-3 * max(ranges_mm) / lens.focal_length_mm
    rim_px = HALO_UM / PITCH_UM + 0.1 * max(shape)
    panel = tuple(2 * math.ceil((n / 2 + rim_px) * seen_mm / cell_mm) for n in shape)
    settings = BenchSettings(
        seed,
        lens,
        TrueSensor(
            rows=shape[0],
            cols=shape[1],
            pitch_um=PITCH_UM,
            counts_per_electron=GAIN,
            white_electrons_per_s=WHITE_ELECTRONS / EXPOSURE_S,
        ),
        TruePanel(pixels=(panel[0], panel[1]), pitch_mm=cell_mm),
        TrueRail(
            high_mm=max(ranges_mm) - min(ranges_mm) + 50.0,
            range_at_zero_mm=min(ranges_mm) - 20.0,
        ),
        pose or TruePose(tilt_deg=0.1, roll_deg=0.5),
        HALO_UM,
        SAMPLES,
        TrueGrid(grid, grid_mm),
        patch_px,
    )
    refuse_wild(settings)
    size_mm = round(cells * cell_mm, 6)
    return FieldSession(settings, tuple(ranges_mm), size_mm, order=order)


def make(session: FieldSession, folder: Path) -> Truth:
    """Write the photographs, frames.csv, plan.toml and truth.json into a new folder; return the truth."""
    folder.mkdir(parents=True)
    bench = Bench(session.settings)
    white = np.full(session.settings.panel.pixels, 255, dtype=np.uint8)
    rows: list[tuple[str, str, str]] = []
    with SimulatedCamera(bench) as camera:
        camera.configure(ExposureSettings(EXPOSURE_S, 100))

        def shoot(kind: str, count: int, range_mm: str = "") -> None:
            for number in range(count):
                name = "_".join(filter(None, (kind, range_mm, str(number))))
                rows.append((camera.expose(folder / name).path.name, kind, range_mm))

        for range_mm in session.ranges_mm:
            position_mm = range_mm - session.settings.rail.range_at_zero_mm
            bench.turn_screw(position_mm)
            bench.stand(position_mm)
            camera.see(session.picture)
            shoot("target", session.frames, f"{range_mm:g}")
            camera.see(white)
            shoot("flat", FLATS, f"{range_mm:g}")
        camera.cover(True)
        shoot("dark", DARKS)
    with (folder / "frames.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([("file", "kind", "range_mm"), *rows])
    (folder / "plan.toml").write_text(session.plan.to_toml(), encoding="utf-8")
    truth = bench.truth
    (folder / "truth.json").write_text(truth.to_json(), encoding="utf-8")
    return truth


def main() -> None:
    """Write a session."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--grid", type=int, nargs=2, default=(2, 3))
    parser.add_argument("--ranges", type=float, nargs="+", default=RANGES_MM)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--patch-px", type=float, default=0.0)
    parser.add_argument("--cats-eye", type=float, nargs=2, metavar=("PER_MM", "RADIUS"))
    parser.add_argument("--tile-px", type=int, default=TILE_PX)
    parser.add_argument("--order", type=int, default=ORDER)
    asked = parser.parse_args()
    rows, cols = asked.grid
    eye = asked.cats_eye and (asked.cats_eye[0], asked.cats_eye[1])
    session = field_session(
        (rows, cols),
        tuple(asked.ranges),
        replace(LENS, field_terms=replace(MISALIGNED, cats_eye_per_mm=eye)),
        seed=asked.seed,
        tile_px=asked.tile_px,
        patch_px=asked.patch_px,
        order=asked.order,
    )
    make(session, asked.folder)


if __name__ == "__main__":
    main()
