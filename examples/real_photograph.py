"""Check labkit on a real photograph: python examples/real_photograph.py ../shared/real/ipol WORK [--find]

The photograph, of a printed random pattern, and the pattern come with Delbracio, Muse and Almansa, *Non-parametric
sub-pixel local PSF estimation*, IPOL. Both are copied to WORK, a new folder: keep it out of the
project. What their program finds is printed beside what `labkit import` and `labkit fit` find. --find: let labkit find
the pattern, instead of starting from corners read off by hand.
"""

import argparse
import json
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

PITCH_UM = 11.4  # one plane of a Bayer mosaic: its samples lie two pixels apart,
ACTIVE_UM = PITCH_UM / 2  # and each sees with one pixel

CORNERS = "corners_px = [[84.5, 114.5], [84.5, 205.5], [175.5, 207], [176, 116]]"
PLAN = f"""
[lens]                   # neither is recorded
focal_length_mm = 50.0
f_number = 5.6
[sensor]
pixel_pitch_um = {PITCH_UM}
fill_factor = {(ACTIVE_UM / PITCH_UM) ** 2}
cfa_pattern = "mono"
black_level = 0
white_level = 255
[[channel]]
name = "G"
wavelength_nm = 550.0
[fit]
zernike_noll = [4, 15]
[target]
kind = "image"
file = "pattern_noise.pgm"
size_mm = 100.0          # any will do: without a range it sets no scale
surround = "unknown"     # a checkerboard, which is not supplied
"""

FREQUENCIES = (0.25, 0.5, 0.75, 1.0)  # cycles per sample
DELBRACIO = {"x": (0.832, 0.556, 0.290, 0.121), "y": (0.841, 0.565, 0.300, 0.114)}


@dataclass(frozen=True)
class Outcome:
    """residual, signal: standard deviations over the used pixels, grey levels; mtf: along each axis at FREQUENCIES. settled:
    whether the optimum is believed to be the best, after so many starts and seconds; explained: whether the model leaves noise
    alone; gained: log-likelihood that each part of a camera would gain."""

    residual: float
    signal: float
    pixels: int
    mtf: dict[str, tuple[float, ...]]
    settled: bool
    starts: int
    seconds: float
    explained: bool
    gained: dict[str, float]


def check(photographs: Path, work: Path, *, find: bool = False) -> Outcome:
    """Import and fit the photograph in WORK/session, and draw WORK/real_photograph.png."""
    work.mkdir(parents=True)
    for name in ("img_example.pgm", "pattern_noise.pgm"):
        shutil.copyfile(photographs / name, work / name)
    (work / "plan.toml").write_text(PLAN + ("" if find else CORNERS))
    (work / "frames.csv").write_text("file,kind,range_mm\nimg_example.pgm,target,\n")
    session = work / "session"
    run("import", work / "frames.csv", work / "plan.toml", session)
    run("fit", session, "--diagnose")
    results = session / "results" / "latest"
    with np.load(results / "residuals.npz") as arrays:
        data, model = (
            arrays[f"{name}_none_G"][0, 0].astype(float) for name in ("data", "model")
        )
    with np.load(results / "psf.npz") as arrays:
        mtf = mtf_with_pixel(
            arrays["psf_none_G"].astype(float), float(arrays["spacing_um"])
        )
    draw(data, model, work / "real_photograph.png")
    used = np.isfinite(data)
    found = json.loads((results / "results.json").read_text())
    fit = found["wavefronts"][0]
    return Outcome(
        residual=float(np.std((data - model)[used])),
        signal=float(np.std(data[used])),
        pixels=int(used.sum()),
        mtf=mtf,
        settled=fit["optimum"]["accepted"],
        starts=fit["global_test"]["starts"],
        seconds=fit["seconds"],
        explained=fit["model"]["accepted"],
        gained={tried["part"]: tried["gain"] for tried in found["parts_tried"]},
    )


def run(*words: str | Path) -> None:
    """A labkit command, as from the shell."""
    subprocess.run([Path(sys.executable).with_name("labkit"), *words], check=True)


def mtf_with_pixel(
    psf: npt.NDArray[np.float64], spacing_um: float
) -> dict[str, tuple[float, ...]]:
    """MTF of optics and pixel together at FREQUENCIES along x (columns) and y (rows)."""
    place = (np.arange(len(psf)) - len(psf) // 2) * spacing_um
    mtf = {}
    for axis, line in (("x", psf.sum(axis=0)), ("y", psf.sum(axis=1))):
        optics = [
            abs(np.sum(line * np.exp(-2j * np.pi * f / PITCH_UM * place)))
            for f in FREQUENCIES
        ]
        mtf[axis] = tuple(
            float(o * np.sinc(f / PITCH_UM * ACTIVE_UM))
            for o, f in zip(optics, FREQUENCIES, strict=True)
        )
    return mtf


def draw(data: npt.NDArray[np.float64], model: npt.NDArray[np.float64], path: Path) -> None:
    """Picture, model and residual side by side, the used pixels alone."""
    figure = Figure(figsize=(15, 5), layout="constrained")
    axes = figure.subplots(1, 3)
    low, high = np.nanpercentile(data, [1, 99])
    for axis, image, title in zip(
        axes, (data, model), ("photograph", "model"), strict=False
    ):
        drawn = axis.imshow(image, cmap="gray", vmin=low, vmax=high)
        axis.set_title(title)
        figure.colorbar(drawn, ax=axis, shrink=0.8, label="grey levels")
    drawn = axes[2].imshow(data - model, cmap="RdBu_r", vmin=-15, vmax=15)
    axes[2].set_title("photograph - model")
    figure.colorbar(drawn, ax=axes[2], shrink=0.8, label="grey levels")
    rows, columns = np.nonzero(np.isfinite(data))
    for axis in axes:
        axis.set(
            xlim=(columns.min() - 1, columns.max() + 1),
            ylim=(rows.max() + 1, rows.min() - 1),
            xlabel="pixels",
        )
    figure.savefig(path, dpi=100)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("photographs", type=Path)
    parser.add_argument("work", type=Path)
    parser.add_argument("--find", action="store_true")
    asked = parser.parse_args()
    outcome = check(asked.photographs, asked.work, find=asked.find)
    print(
        f"residual {outcome.residual:.2f} grey levels of {outcome.signal:.1f}, {outcome.pixels} pixels"
    )
    print(
        f"optimum {'settled' if outcome.settled else 'open'} after {outcome.starts} starts, {outcome.seconds:.0f} s"
    )
    why = f"no part of a camera that we know gains more than {max(outcome.gained.values()):.1f} of log-likelihood"
    print(
        "the model explains the data"
        if outcome.explained
        else f"the model does not explain the data: {why}"
    )
    print(
        "MTF of optics and pixel\ncycles/px  "
        + "  ".join(f"{axis}: here  Delbracio" for axis in DELBRACIO)
    )
    for i, frequency in enumerate(FREQUENCIES):
        print(
            f"{frequency:9.2f}"
            + "".join(
                f"{outcome.mtf[axis][i]:11.3f}{DELBRACIO[axis][i]:9.3f}"
                for axis in DELBRACIO
            )
        )
    print("drawn:", asked.work / "real_photograph.png")


if __name__ == "__main__":
    main()
