"""What a mistake in a plan costs: `python -m benchmarks.mistakes --golden ../shared/golden [NAME ...]`.

The golden session `bench-open` is fitted with one mistake in its plan at a time, or in the ranges of its table; or with a
fault that no part of the model has in its photographs of the target. A line for each: processor seconds, the largest error of
the results over its standard error, and what labkit said first: its refusal, or its first warning. A mistake should be named
there, or be harmless within the errors.
"""

from __future__ import annotations

import argparse
import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from resource import RUSAGE_CHILDREN, RUSAGE_SELF, getrusage
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
from scipy import ndimage

import labkit
from benchmarks.golden_errors import lens_errors, nearest_sign, wavefront_errors
from benchmarks.sessions import OutOfTime, ended_after
from labkit.errors import LabkitError
from labkit.key import Key
from labkit.photographs.decoding import read_photograph
from labkit.plan import Sensor
from labkit.results import Results
from labkit.targets.sierpinski import carpet_cells
from labkit.types import Floats

SESSION = "bench-open"
LIMIT_S = 900.0


@dataclass(frozen=True)
class Mistake:
    """A mistake: lines of plan.toml and what stands in their place, cells of a picture as target, and the table's change."""

    lines: dict[str, str] = field(default_factory=dict)
    cells: Callable[[], Any] | None = None
    ranges_mm: dict[float, float] = field(default_factory=dict)
    fault: Callable[[Floats], Floats] | None = None


def reflected(light: Floats) -> Floats:
    """Return the light of a mosaic with the reflection of a lamp on the target: a smooth spot, a third as bright as white."""
    y, x = np.mgrid[: light.shape[0], : light.shape[1]]
    spot = np.exp(-((y - 90) ** 2 + (x - 140) ** 2) / (2 * 30.0**2))
    return np.asarray(light + 0.3 * np.percentile(light, 99) * spot)


def denoised(light: Floats) -> Floats:
    """Return the light of a mosaic, each plane smoothed as cameras do in their raw files: by a median of its neighbours."""
    smooth = light.copy()
    for row, col in np.ndindex(2, 2):
        plane = light[row::2, col::2]
        smooth[row::2, col::2] = 0.5 * (plane + ndimage.median_filter(plane, 3))
    return smooth


def pictured(cells: Callable[[], Any]) -> Mistake:
    """Return a mistake whose target is a picture of cells."""
    return Mistake(
        {'kind = "sierpinski"': 'kind = "image"\nfile = "target.png"', "order = 5": ""},
        cells,
    )


MISTAKES = {
    "none": Mistake(),
    "order 4": Mistake({"order = 5": "order = 4"}),
    "order 6": Mistake({"order = 5": "order = 6"}),
    "kind": Mistake({'kind = "sierpinski"\norder = 5': 'kind = "noise"\ncells = 81'}),
    "negative": pictured(lambda: 1 - carpet_cells(5)),
    "mirrored": pictured(lambda: carpet_cells(5)[:, ::-1]),
    "size × 2": Mistake({"size_mm = 26.0": "size_mm = 52.0"}),
    "focal length": Mistake({"focal_length_mm = 85.0": "focal_length_mm = 50.0"}),
    "focal length, near": Mistake({"focal_length_mm = 85.0": "focal_length_mm = 80.0"}),
    "pitch": Mistake({"pixel_pitch_um = 5.2": "pixel_pitch_um = 3.9"}),
    "pitch, near": Mistake({"pixel_pitch_um = 5.2": "pixel_pitch_um = 4.8"}),
    "f-number": Mistake({"f_number = 3.5": "f_number = 5.6"}),
    "wavelengths": Mistake(
        {"wavelength_nm = 640.0": "wavelength_nm = R", "455.0": "640.0", "= R": "= 455.0"}
    ),
    "ranges": Mistake(ranges_mm={2000.0: 2160.0, 2160.0: 2000.0}),
    "ranges, near": Mistake(ranges_mm={2000.0: 2080.0, 2080.0: 2000.0}),
    "ranges in m": Mistake(ranges_mm={2000.0: 2.0, 2080.0: 2.08, 2160.0: 2.16}),
    "size in m": Mistake({"size_mm = 26.0": "size_mm = 0.026"}),
    "surround": Mistake({"[target]": '[target]\nsurround = "white"'}),
    "reflection": Mistake(fault=reflected),
    "noise reduction": Mistake(fault=denoised),
}
"""Mistakes by name. One without an effect, a carpet in a mirror, is among them."""


def write_session(golden: Path, mistake: Mistake, folder: Path) -> Path:
    """Import the golden session with a mistake; return the session's folder."""
    source = folder / "source"
    source.mkdir()
    plan = (golden / SESSION / "plan.toml").read_text()
    for line, wrong in mistake.lines.items():
        assert line in plan, line
        plan = plan.replace(line, wrong)
    (source / "plan.toml").write_text(plan)
    if mistake.cells is not None:
        cells = (255 * np.asarray(mistake.cells())).astype(np.uint8)
        cv2.imwrite(str(source / "target.png"), cells)
    rows = []
    for row in (golden / SESSION / "frames.csv").read_text().splitlines():
        name, kind, range_mm = row.split(",")
        if kind != "kind":
            shutil.copy(golden / SESSION / name, source)
        if kind == "target" and mistake.fault is not None:
            write_altered(source / name, mistake.fault)
        if kind in ("target", "flat"):
            range_mm = str(mistake.ranges_mm.get(float(range_mm), range_mm))
        rows.append(f"{name},{kind},{range_mm}")
    (source / "frames.csv").write_text("\n".join(rows) + "\n")
    session = folder / "session"
    labkit.import_frames(source / "frames.csv", source / "plan.toml", session)
    return session


def write_altered(path: Path, fault: Callable[[Floats], Floats]) -> None:
    """Write a photograph with a fault in its place."""
    photograph = read_photograph(path, Sensor(pixel_pitch_um=5.2))
    black = round(float(photograph.black.mean()))
    light = fault(np.asarray(photograph.counts - float(black), np.float64))
    counts = np.clip(np.rint(light + black), 0, photograph.white).astype(np.uint16)
    old = photograph.counts.astype("<u2").tobytes()
    content = path.read_bytes()
    assert content.count(old) == 1, path  # not compressed, in one strip
    path.chmod(0o644)
    path.write_bytes(content.replace(old, counts.astype("<u2").tobytes()))


def processor_s() -> float:
    """Return the processor time of this process and of its children, seconds."""
    return sum(
        used.ru_utime + used.ru_stime
        for used in map(getrusage, (RUSAGE_SELF, RUSAGE_CHILDREN))
    )


def largest_error(results: Results, golden: Path) -> tuple[str, float]:
    """Return the largest error of the results over its standard error, and of which number."""
    truth = json.loads((golden / f"truth-{SESSION}.json").read_text())
    images = np.load(golden / f"truth-{SESSION}-psf.npz")
    every = list(lens_errors(results, truth))
    for frame in truth["frames"]:
        key = Key(frame["range_mm"], frame["channel"])
        if key in {w.key for w in results.wavefronts}:
            waves = [frame["defocus_waves"], *frame["alpha"].values()]
            w = nearest_sign(results[key], waves)
            every += wavefront_errors(w, waves, images[str(key)], truth["psf_spacing_um"])
    return max(every, key=lambda one: abs(one[1]))


def measure(name: str, golden: Path) -> str:
    """Return the line of a mistake."""
    off, began = "", processor_s()
    with TemporaryDirectory(prefix="labkit-mistakes-") as folder:
        try:
            session = write_session(golden, MISTAKES[name], Path(folder))
            with ended_after(LIMIT_S):
                results = labkit.fit(session, workers=1)
            warnings = [one.text for one in results.findings if one.warns]
            said = warnings[0] if warnings else "nothing"
            number, z = largest_error(results, golden)
            off = f"{number} {z:.1f}"
        except LabkitError as error:
            said = f"refused: {error}"
        except OutOfTime as error:
            said = str(error)
    return f"{name:18s} {processor_s() - began:6.0f} s  {off:24s} {said}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(MISTAKES))
    parser.add_argument("--golden", type=Path, default=Path("../shared/golden"))
    chosen = parser.parse_args()
    for name in chosen.names or MISTAKES:
        print(measure(name, chosen.golden.resolve()), flush=True)


if __name__ == "__main__":
    main()
