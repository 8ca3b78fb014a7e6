"""PSFs at held-out field points of a commercial lens: `python -m benchmarks.real_field FOLDER [--grid 4 5] [--f-number 2.8]`.

The lens is Edmund 63762 by its design (`shared/real/lens63762`), the corners of its frame at 20 degrees, in three wavelengths
at 23,000 electrons. A session of a grid of carpets is made in FOLDER and fitted; PSFs of its field model are compared with the
true ones midway between neighbouring carpets, where nothing was measured. FOLDER is kept: run again, only what is missing is
done.

PSNR is 20 log10 of the true PSF's peak over the RMS error in a square of WINDOW_PX pixels about the chief ray. PSFs of the
optics alone, four samples to lambda N, the true one moved to fit; one focus, common to all points and colours, is fitted too.

`python -m benchmarks.real_field --expansions` needs no photographs: the true modes are expanded over the frame, and the PSNR is
what each order in the field and each number of modes leave along the frame's diagonal.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

import labkit
from benchmarks.field_sessions import PITCH_UM, TILE_PX, FieldSession, field_session, make
from benchmarks.psf_errors import REACH, SAMPLES_PER_AIRY, moved_to_fit, true_psf
from benchmarks.real_lens import REAL_LENS
from labkit.drivers.simulated.bench import Bench
from labkit.drivers.simulated.field import FieldTerms, um_per_wave
from labkit.drivers.simulated.optics import REFERENCE_NM, working_f_number
from labkit.drivers.simulated.view import View
from labkit.drivers.simulated.world import TrueLens, TruePose
from labkit.drivers.simulated.zernike_table import read_table
from labkit.optics.field import FieldFrame, FieldModel, field_terms
from labkit.optics.metrics import psf_value
from labkit.optics.wavefront import DEFOCUS
from labkit.results import Results
from labkit.session.import_frames import import_frames

CORNER_DEG = 20.0
BEST_MM = 200.0
WINDOW_PX = 16
STATIONS = (-0.6, 0.0, 0.6)
"""Defocus on the axis at each range, waves RMS at 450 nm."""

DENSE = (11, 13)
"""Rows and columns of places at which true modes are expanded."""
EXPANSIONS = ((4, 15), (4, 37), (6, 37), (8, 15))
"""Radial order in the field, and the last of Noll's modes."""
ALONG_DIAGONAL = (0.25, 0.5, 0.75, 0.95)
"""Places from the middle to the corner of the frame."""


def session_of(grid: tuple[int, int], f_number: float) -> FieldSession:
    """Return the session: the focal length puts the frame's corner at CORNER_DEG."""
    half_mm = np.hypot(*grid) * TILE_PX / 2 * PITCH_UM * 1e-3
    image_mm = float(half_mm / np.tan(np.radians(CORNER_DEG)))
    focal_mm = 1 / (1 / image_mm + 1 / BEST_MM)
    wave_mm = um_per_wave(f_number * image_mm / focal_mm, REFERENCE_NM) * 1e-3
    ranges = [1 / (1 / focal_mm - 1 / (image_mm - waves * wave_mm)) for waves in STATIONS]
    lens = TrueLens(
        focal_length_mm=focal_mm,
        f_number=f_number,
        pupil_magnification=1.0,
        wavelength_nm={"R": 656.0, "G": 588.0, "B": 486.0},
        best_focus_mm=dict.fromkeys("RGB", BEST_MM),
        aberration_waves=0.0,
        field_terms=FieldTerms(table=read_table(str(REAL_LENS))),
    )
    stated = tuple(round(mm, 2) for mm in sorted(ranges))
    return field_session(grid, stated, lens, pose=TruePose(tilt_deg=0.0, roll_deg=0.5))


def fitted(session: FieldSession, folder: Path) -> Results:
    """Return the results of a session in a folder, made and fitted where they are missing."""
    photographs = folder / "photographs"
    kept = folder / "session"
    if not (photographs / "truth.json").exists():
        make(session, photographs)
    if not kept.exists():
        import_frames(photographs / "frames.csv", photographs / "plan.toml", kept)
    if not (kept / "results/latest/results.json").exists():
        labkit.fit(kept)
    return Results.load(kept)


def held_out(session: FieldSession) -> list[tuple[float, float]]:
    """Return the places (row, column) midway between two or four neighbouring tiles."""
    rows, cols = session.settings.grid.shape
    halves = itertools.product(range(2 * rows - 1), range(2 * cols - 1))
    return [
        ((row + 1) * TILE_PX / 2 - 0.5, (col + 1) * TILE_PX / 2 - 0.5)
        for row, col in halves
        if row % 2 or col % 2
    ]


def apart_db(
    view: View, field: FieldModel, places: list[tuple[float, float]]
) -> Iterator[tuple[float, str, float]]:
    """Yield the field angle in degrees, the colour and the PSNR of each held-out point."""
    true = {(c, at): view.waves(c, at) for c in field.channels for at in places}
    ours = {key: field.wavefront(*key) for key in true}
    focus = np.mean(
        [
            true[key][DEFOCUS] - ours[key].waves[ours[key].index(DEFOCUS)]
            for key in true
            if key[0] == "G"
        ]
    )
    for (colour, place), waves in true.items():
        wavefront = ours[colour, place]
        spacing_um = wavefront.wavelength_um * wavefront.f_number / SAMPLES_PER_AIRY
        found = psf_value(wavefront, spacing_um, 2 * REACH + 1)
        at_focus = {**waves, DEFOCUS: waves[DEFOCUS] - float(focus)}
        exact = true_psf(view.settings.lens, colour, at_focus, spacing_um)
        exact = moved_to_fit(exact / exact.sum(), found)
        half = min(REACH, int(WINDOW_PX / 2 * PITCH_UM / spacing_um))
        window = slice(REACH - half, REACH + half + 1)
        error = (found - exact)[window, window]
        down, right = view.place_mm(place)
        image_mm = 1 / (1 / view.settings.lens.focal_length_mm - 1 / BEST_MM)
        angle = float(np.degrees(np.arctan(np.hypot(down, right) / image_mm)))
        yield angle, colour, float(20 * np.log10(exact.max() / np.sqrt(np.mean(error**2))))


def expanded(
    view: View, session: FieldSession, order: int, modes: Sequence[int]
) -> FieldModel:
    """Return the expansion of the true modes over the frame, by least squares at DENSE places."""
    sensor, lens = session.settings.sensor, session.settings.lens
    frame = FieldFrame((sensor.rows, sensor.cols), PITCH_UM)
    down, right = ((np.arange(n) + 0.5) / n for n in DENSE)
    places = [(y * sensor.rows, x * sensor.cols) for y in down for x in right]
    terms = field_terms(order)
    polynomials = frame.polynomials(terms, places).T
    channels = tuple(lens.wavelength_nm)
    waves = []
    for channel in channels:
        true = [view.waves(channel, place) for place in places]
        wanted = np.array([[of.get(j, 0.0) for j in modes] for of in true])
        waves.append(np.linalg.lstsq(polynomials, wanted)[0])
    size = len(channels) * len(terms) * len(modes)
    return FieldModel(
        frame,
        channels,
        terms,
        tuple(modes),
        np.array(waves),
        np.zeros((size, size)),
        tuple(lens.wavelength_nm.values()),
        REFERENCE_NM,
        working_f_number(
            lens.f_number, BEST_MM, lens.focal_length_mm, lens.pupil_magnification
        ),
    )


def compare_expansions(session: FieldSession) -> None:
    """Print the PSNR along the diagonal that expansions of the true modes leave."""
    bench = Bench(session.settings)
    position_mm = sorted(session.ranges_mm)[1] - session.settings.rail.range_at_zero_mm
    bench.turn_screw(position_mm)
    bench.stand(position_mm)
    half = np.array([session.settings.sensor.rows, session.settings.sensor.cols]) / 2
    places = [tuple(half * (1 + share) - 0.5) for share in ALONG_DIAGONAL]
    for order, last in EXPANSIONS:
        model = expanded(bench.view, session, order, range(DEFOCUS, last + 1))
        left = sorted(apart_db(bench.view, model, places))
        shown = "  ".join(f"{angle:.0f}° {colour} {db:.1f}" for angle, colour, db in left)
        print(f"order {order}, modes to {last}: {shown} dB")


def main() -> None:
    """Make, fit and compare; print a line for each held-out point and the least and the median of all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--expansions", action="store_true")
    parser.add_argument("--grid", type=int, nargs=2, default=(4, 5))
    parser.add_argument("--f-number", type=float, default=2.8)
    asked = parser.parse_args()
    session = session_of((asked.grid[0], asked.grid[1]), asked.f_number)
    if asked.expansions:
        compare_expansions(session)
        return
    if asked.folder is None:
        parser.error("a folder is needed for photographs, or --expansions")
    asked.folder.mkdir(parents=True, exist_ok=True)
    results = fitted(session, asked.folder)
    if results.field is None:
        raise SystemExit("the fit has no field: see its warnings")
    view = Bench(session.settings).view
    found = sorted(apart_db(view, results.field, held_out(session)))
    for angle, colour, db in found:
        print(f"{angle:5.1f} degrees  {colour}  {db:5.1f} dB")
    levels = [db for _, _, db in found]
    print(f"PSNR: {min(levels):.1f} dB at least, {np.median(levels):.1f} dB in the median")


if __name__ == "__main__":
    main()
