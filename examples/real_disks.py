"""Best focus and size against wavelength in real photographs: python examples/real_disks.py ../shared/real/disks WORK

A printed grid of black disks, photographed through seven filters of 10 nm at seven exposures by B. Llanos, University of
Alberta (github.com/bllanos/chromatic-aberration). A session of each band is made in WORK, a new folder.

The bands are fitted together: one from nothing, until its optimum is settled, and each of the others from the wavefront of the
band beside it. Near focus defocus and astigmatism nearly trade places, and under this uneven light a band alone may end where
they have.

What one range can tell: defocus in each band, beside an astigmatism that all have, so that all signs together are open, and
not where the lens is focused in millimetres of range, for the size of the disks is not recorded either.
"""

import argparse
import shutil
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from labkit.analysis.observe import observe
from labkit.estimation.local import Found, Guesses, Views, find_optima
from labkit.estimation.observation import Observation
from labkit.estimation.stated import optics_of
from labkit.imaging.optics import Optics
from labkit.photographs.decoding import read_photograph
from labkit.plan import Sensor
from labkit.session.import_frames import import_frames
from labkit.target.target import Target, open_target

Floats = npt.NDArray[np.float64]

BANDS = {
    400: ("G", 3916),
    450: ("B", 50),
    500: ("G", 250),
    550: ("G", 25),
    600: ("R", 100),
    650: ("R", 250),
    700: ("R", 500),
}
"""Wavelength, nm: the colour that sees it best, and the longest exposure, ms, that clips none of its pixels."""

EXPOSURES_MS = (25, 50, 100, 250, 500, 2000, 3916)
ROWS, COLS = (1, 3), (1, 4)
"""Of the disks in the picture those that are fitted: 2 × 3 in the middle. More take longer and leave the same residuals."""

DIAMETER = 0.4465
"""Over the distance of two disks, ± 0.0005: by how much light is missing in a square, which blur does not change."""

F_NUMBER, REFERENCE_NM = 4.0, 550.0
SENSOR = Sensor(pixel_pitch_um=3.45, cfa_pattern="GBRG", black_level=0, white_level=255)

PLAN = """
[lens]
focal_length_mm = 8.0
f_number = {f_number}
[sensor]
pixel_pitch_um = 3.45
cfa_pattern = "GBRG"
black_level = 0
white_level = 255
[[channel]]
name = "{channel}"
wavelength_nm = {nm}
[fit]
zernike_noll = [4, 11]
reference_wavelength_nm = {reference}
[target]
kind = "disks"
grid = [2, 3]
size_mm = 18.0           # any will do: without a range it sets no scale
diameter_mm = {diameter}
surround = "unknown"     # more disks
corners_px = {corners}
"""


FIRST_NM = 600
"""Fitted from nothing."""


@dataclass(frozen=True)
class Outcome:
    """Of each band, in the order of BANDS: focus_um, std_um: defocus at the sensor; size: relative to 550 nm; centre_px:
    (bands, 2) (row, col) relative to 550 nm. chi2: of a parabola through the defocus. settled: whether the first band is.
    nonlinear: largest departure of a ladder of exposures from a line, relative."""

    focus_um: Floats
    std_um: Floats
    chi2: float
    size: Floats
    centre_px: Floats
    settled: bool
    nonlinear: float


def check(photographs: Path, work: Path) -> Outcome:
    """Import and fit a photograph of each band in WORK/400 to WORK/700, and draw WORK/real_disks.png."""
    work.mkdir(parents=True)
    corners = corners_of(disks_of(photographs))
    bands = {nm: band_of(photographs, work / str(nm), nm, corners) for nm in BANDS}
    fits = together(bands)
    um = 8 * F_NUMBER**2 * np.sqrt(12) * REFERENCE_NM * 1e-3  # of a wave RMS of defocus
    # the model is rejected: sandwich errors include what it leaves unexplained
    sandwich = [fits[nm].best.sandwich for nm in BANDS]
    focus = um * np.array([measured.values[0] for measured in sandwich])
    std = um * np.sqrt([measured.covariance[0, 0] for measured in sandwich])
    places = np.array([corners_found(bands[nm], fits[nm]) for nm in BANDS])
    sizes = np.array(
        [np.sqrt(cv2.contourArea(place.astype(np.float32))) for place in places]
    )
    middle = list(BANDS).index(550)
    outcome = Outcome(
        focus,
        std,
        chi2_of_parabola(focus, std),
        sizes / sizes[middle],
        places.mean(axis=1) - places[middle].mean(axis=0),
        fits[FIRST_NM].settled,
        nonlinearity(photographs),
    )
    draw(outcome, work / "real_disks.png")
    return outcome


@dataclass(frozen=True)
class Band:
    """The photograph of one band, and what it was taken with. f_number_std: relative."""

    observation: Observation
    optics: Optics
    target: Target
    f_number_std: float

    def fit(self, *starts: Floats) -> Found:
        """Search from wavefronts (modes,), or where there are none from nothing."""
        views = Views(
            self.observation.frames, self.observation.poses, self.observation.noise
        )
        guesses = Guesses(self.f_number_std, starts=starts, deep=not starts, alone=False)
        return find_optima(self.optics, self.target, views, guesses)


def together(bands: dict[int, Band]) -> dict[int, Found]:
    """Every band fitted, from the first one outwards."""
    fits = {FIRST_NM: bands[FIRST_NM].fit()}
    shorter, longer = (
        [nm for nm in BANDS if (nm > FIRST_NM) is up and nm != FIRST_NM]
        for up in (False, True)
    )
    for row in (shorter[::-1], longer):
        for beside, nm in zip([FIRST_NM, *row], row, strict=False):
            fits[nm] = bands[nm].fit(fits[beside].best.waves)
    return fits


def photograph(folder: Path, nm: int, ms: int) -> Path:
    """Of a band and an exposure."""
    (path,) = folder.glob(f"d1_disks32cmV2_{nm}nm_{ms}ms_*.tif")
    return path


def disks_of(folder: Path) -> npt.NDArray[np.bool_]:
    """(rows, cols) True on disks, and a little around, as those who took the photographs have marked them."""
    mask = cv2.imread(str(folder / "d1_disks32cmV2_maskDisks.png"), cv2.IMREAD_GRAYSCALE)
    assert mask is not None
    return np.asarray(mask > 0)


def corners_of(disks: npt.NDArray[np.bool_]) -> Floats:
    """(4, 2) corners (row, col) of the squares of the disks that are fitted: a grid looks the same one disk farther on."""
    _, _, box, middle = cv2.connectedComponentsWithStats(disks.astype(np.uint8))
    whole = (
        (box[:, 0] > 0)
        & (box[:, 1] > 0)
        & (box[:, :2] + box[:, 2:4] < disks.shape[::-1]).all(axis=1)
    )
    whole[0] = False  # what is no disk
    at = middle[whole]
    # columns lie 68 px apart and lean by 3.5 px a row, rows 63 px and 1.45 px a column
    steps = np.array([[68.0, 1.45], [-3.5, 63.3]])
    grid = np.rint((at - at[np.argmin(at.sum(axis=1))]) @ np.linalg.inv(steps))
    homography, _ = cv2.findHomography(grid, at)
    (top, bottom), (left, right) = (
        (first - 0.5, last - 0.5) for first, last in (ROWS, COLS)
    )
    ends = np.array([[left, top], [right, top], [right, bottom], [left, bottom]])
    return np.asarray(cv2.perspectiveTransform(ends[None], homography)[0][:, ::-1])


def band_of(photographs: Path, folder: Path, nm: int, corners: Floats) -> Band:
    """The photograph of a band, out of a session in a new folder."""
    channel, ms = BANDS[nm]
    folder.mkdir()
    path = photograph(photographs, nm, ms)
    shutil.copyfile(path, folder / path.name)
    (folder / "frames.csv").write_text(f"file,kind,range_mm\n{path.name},target,\n")
    values = {
        "channel": channel,
        "nm": float(nm),
        "corners": np.round(corners, 2).tolist(),
        "diameter": 9 * DIAMETER,
    }
    (folder / "plan.toml").write_text(
        PLAN.format(**values, f_number=F_NUMBER, reference=REFERENCE_NM)
    )
    session = import_frames(folder / "frames.csv", folder / "plan.toml", folder / "session")
    plan, target = session.plan, open_target(session.plan.target)
    (observation,), _ = observe(session, plan, target)
    stated = plan.lens.stated_f_number
    return Band(observation, optics_of(plan, channel), target, stated.std / stated.value)


def corners_found(band: Band, found: Found) -> Floats:
    """(4, 2) (row, col) of the target's corners in the frame."""
    return np.asarray(
        found.best.state.poses[0].corners_px() + np.array(band.observation.origin_px)
    )


def chi2_of_parabola(focus: Floats, std: Floats) -> float:
    """In wavelength, of the one that fits best."""
    design = np.vander((np.array(list(BANDS)) - REFERENCE_NM) / 150, 3) / std[:, None]
    return float(
        np.sum((focus / std - design @ np.linalg.lstsq(design, focus / std)[0]) ** 2)
    )


def nonlinearity(photographs: Path) -> float:
    """Largest departure of white's counts from a line in the exposure, relative, over bands and colours.

    Of exposures in which no colour clips, for what spills from full pixels is not the ladder's; of means above 10 of 255, and
    three of them at least. The line need not go through 0: numbers were cut to 8 bit.
    """
    away = (
        cv2.distanceTransform((~disks_of(photographs)).astype(np.uint8), cv2.DIST_L2, 5) > 8
    )
    worst = 0.0
    for nm in BANDS:
        every = [
            (ms, read_photograph(photograph(photographs, nm, ms), SENSOR))
            for ms in EXPOSURES_MS
        ]
        ladder = [
            (ms, mosaic)
            for ms, mosaic in every
            if (mosaic.counts >= mosaic.white).mean() < 1e-4
        ]
        for colour in "RGB":
            steps = np.array(
                [
                    (ms, mosaic.counts[away & mosaic.channel_mask(colour)].mean())
                    for ms, mosaic in ladder
                ]
            )
            steps = steps[steps[:, 1] > 10]
            if len(steps) >= 3:
                design = np.column_stack((steps[:, 0], np.ones(len(steps)))) / steps[:, 1:]
                line = design @ np.linalg.lstsq(design, np.ones(len(steps)))[0]
                worst = max(worst, float(np.abs(1 - line).max()))
    return worst


def draw(outcome: Outcome, path: Path) -> None:
    """Best focus with its parabola, and size and place, against wavelength."""
    figure = Figure(figsize=(12, 4.5), layout="constrained")
    focus, lateral = figure.subplots(1, 2)
    nm = np.array(list(BANDS), dtype=np.float64)
    focus.errorbar(nm, outcome.focus_um, outcome.std_um, fmt="o", capsize=3)
    fine = np.linspace(nm[0], nm[-1], 200)
    focus.plot(
        fine, np.polyval(np.polyfit(nm, outcome.focus_um, 2, w=1 / outcome.std_um), fine)
    )
    focus.set(
        xlabel="wavelength, nm", ylabel="defocus at the sensor, µm, or all its negative"
    )
    lateral.plot(nm, 1e5 * (outcome.size - 1), "o-", label="size, 1e-5")
    lateral.plot(
        nm, 100 * outcome.centre_px[:, 0], "s-", label="row of the middle, 0.01 px"
    )
    lateral.plot(
        nm, 100 * outcome.centre_px[:, 1], "^-", label="column of the middle, 0.01 px"
    )
    lateral.set(xlabel="wavelength, nm", ylabel="beside 550 nm")
    lateral.legend()
    figure.savefig(path, dpi=100)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("photographs", type=Path)
    parser.add_argument("work", type=Path)
    asked = parser.parse_args()
    outcome = check(asked.photographs, asked.work)
    print("nm    defocus/um     size      row/px  col/px")
    for k, nm in enumerate(BANDS):
        row, col = outcome.centre_px[k]
        print(
            f"{nm}  {outcome.focus_um[k]:+6.1f} ± {outcome.std_um[k]:.1f}  {outcome.size[k]:.5f}  {row:+6.2f}  {col:+6.2f}"
        )
    print(f"optimum at {FIRST_NM} nm {'settled' if outcome.settled else 'open'}")
    print(f"a parabola through the defocus: chi2 {outcome.chi2:.1f} of 4 degrees")
    print(
        f"exposures depart from a line by {outcome.nonlinear:.2%} at most\ndrawn: {asked.work / 'real_disks.png'}"
    )


if __name__ == "__main__":
    main()
