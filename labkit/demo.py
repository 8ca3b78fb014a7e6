"""The main job on simulated devices, and the truth beside the estimate."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass
from math import dist, hypot
from pathlib import Path
from shutil import which
from typing import Any

from labkit.acquisition.capture import run_plan
from labkit.analysis.fit import fit
from labkit.devices.context import DeviceContext
from labkit.devices.registry import open_devices
from labkit.key import Key
from labkit.plan import Plan
from labkit.report.html import write_report
from labkit.results import Results
from labkit.session.making import refuse_existing
from labkit.session.session import Session
from labkit.types import no_progress
from labkit.uncertain import decimals

DEMO_PLAN = """\
# A 70 mm f/2.8 lens at three ranges, three colours, on simulated devices.
# For your own bench change the numbers and the three addresses; `labkit devices` says what is connected.

[about]                # on the report's title and in print on every page; may be left out
title = "A simulated lens"
operator = "labkit demo"

[lens]
focal_length_mm = 70.0
f_number = 2.8

[sensor]
pixel_pitch_um = 4.78  # between neighbouring samples of the raw file
fill_factor = 1.0      # active area over pitch squared

[[channel]]
name = "R"
wavelength_nm = 650.0

[[channel]]
name = "G"             # both green planes, fitted together
wavelength_nm = 550.0

[[channel]]
name = "B"
wavelength_nm = 450.0

[target]
kind = "sierpinski"
order = 5
size_mm = 46.8         # side of the whole carpet

[fit]
range_std_mm = 0.0015  # standard error of a range: the rail's encoder counts in 0.005 mm

[camera]
address = "{address}"
exposure_s = 0.02
iso = 100
frames_per_range = 2
flats_per_range = 4
darks = 4

[rail]
address = "{address}"
ranges_mm = [3000, 3200, 3300]
range_at_zero_mm = 2950.0  # range when the rail stands at 0
direction = 1              # +1: a larger rail position is a longer range
settle_s = 1.0

[display]
address = "{address}"
panel = "ipad-9.7-retina"
"""

Report = Callable[[int, int, str], None]
Progress = Callable[[str], AbstractContextManager[Report]]


@dataclass(frozen=True, slots=True)
class Compared:
    """A quantity's true value and its estimate."""

    quantity: str
    unit: str
    truth: float
    estimate: float
    std: float


@dataclass(frozen=True, slots=True)
class ComparedWavefront:
    """All modes of a wavefront as they truly are and as they were estimated, waves RMS."""

    channel: str
    range_mm: float
    noll: tuple[int, ...]
    truth: tuple[float, ...]
    estimate: tuple[float, ...]
    std: tuple[float, ...]

    @property
    def error_rms(self) -> float:
        """RMS of the difference between estimate and truth over the pupil."""
        return dist(self.truth, self.estimate)

    @property
    def expected_rms(self) -> float:
        """RMS error that the standard errors predict."""
        return hypot(*self.std)


@dataclass(frozen=True, slots=True)
class Comparison:
    """The demo's estimates beside the truth, and the path of the report."""

    compared: tuple[Compared, ...]
    wavefronts: tuple[ComparedWavefront, ...]
    report: Path

    def rows(self) -> list[list[str]]:
        """Return rows of quantity, truth, estimate, standard error, and error over standard error."""
        return [
            [
                f"{c.quantity} / {c.unit}" if c.unit else c.quantity,
                *(
                    f"{number:.{decimals(c.std)}f}"
                    for number in (c.truth, c.estimate, c.std)
                ),
                f"{(c.estimate - c.truth) / c.std:+.1f}",
            ]
            for c in self.compared
        ]

    def wavefront_rows(self) -> list[list[str]]:
        """Return rows of wavefront, RMS of truth, of error and expected error in waves; worst mode's error."""
        rows = []
        for w in self.wavefronts:
            z = [(e - t) / s for t, e, s in zip(w.truth, w.estimate, w.std, strict=True)]
            mode, worst = max(zip(w.noll, z, strict=True), key=lambda one: abs(one[1]))
            rows.append(
                [
                    f"wavefront {Key(w.range_mm, w.channel).label}",
                    f"{hypot(*w.truth):.4f}",
                    f"{w.error_rms:.4f}",
                    f"{w.expected_rms:.4f}",
                    f"{worst:+.1f} (Noll {mode})",
                ]
            )
        return rows

    def as_json(self) -> dict[str, Any]:
        """Return the comparison for --json."""
        return {
            "report": str(self.report),
            "compared": [asdict(c) for c in self.compared],
            "wavefronts": [
                {**asdict(w), "error_rms": w.error_rms} for w in self.wavefronts
            ],
        }


def unwatched(stage: str) -> AbstractContextManager[Report]:
    """Return the progress of a demo without a monitor."""
    return nullcontext(no_progress)


def run_demo(
    folder: Path | str, seed: int = 1, progress: Progress = unwatched
) -> Comparison:
    """Capture, fit and report a session of a simulated lens, and compare with the truth.

    Parameters
    ----------
    folder : the session's folder, to be made
    seed : number of the lens, sensor, rail and noise to simulate
    progress : returns, for the name of a stage, a context whose value is called with (done,
        total, step)

    Raises
    ------
    SessionError
        the folder exists

    >>> labkit.run_demo("labkit-demo").rows()
    """
    folder = Path(folder)
    refuse_existing(folder)
    text = DEMO_PLAN.format(address=f"simulated:seed={seed},sensor=6mp")
    context = DeviceContext()
    with (
        open_devices(Plan.parse(text, Path()), context=context) as devices,
        Session.create(folder, text, Path()) as session,
        progress("capturing") as report,
    ):
        run_plan(session, devices, progress=report)
        # the bench is a driver's: all that is known of it here is that it knows the truth
        (bench,) = context.shared.values()
    with progress("fitting") as report:
        results = fit(folder, progress=report)
    compared = compare(results, bench.truth)
    wavefronts = compare_wavefronts(results, bench.truth)
    with progress("reporting") as report:
        made = write_report(results, progress=report)
    return Comparison(tuple(compared), tuple(wavefronts), made)


def compare(results: Results, truth: Any) -> Iterator[Compared]:
    """Yield best focus, pupil magnification, lens and defocus, each with its true value."""
    focus = results.focus
    for channel, best in (focus.best_focus_mm if focus else {}).items():
        yield Compared(
            f"best focus {channel}",
            "mm",
            truth.best_focus_mm[channel],
            best.value,
            best.std,
        )
    if focus:
        mp = focus.pupil_magnification
        yield Compared(
            "pupil magnification", "", truth.pupil_magnification, mp.value, mp.std
        )
    if lens := results.lens:
        f = lens.focal_length
        n = lens.f_number
        zero = lens.range_zero
        yield Compared("focal length", "mm", truth.focal_length_mm, f.value, f.std)
        yield Compared("f-number at infinity", "", truth.f_number, n.value, n.std)
        yield Compared(
            "true ranges less stated", "mm", truth.range_zero_mm, zero.value, zero.std
        )
    visits = {visit.range_mm: visit for visit in truth.visits}
    for w in results:
        if w.defocus and w.range_mm in visits:
            true = visits[w.range_mm].defocus_waves[w.channel]
            name = f"defocus {w.key.label}"
            yield Compared(name, "waves RMS", true, w.defocus.value, w.defocus.std)


def compare_wavefronts(results: Results, truth: Any) -> Iterator[ComparedWavefront]:
    """Yield each wavefront with the true one, mode by mode."""
    visits = {visit.range_mm: visit for visit in truth.visits}
    for w in results:
        if w.range_mm is not None and w.range_mm in visits:
            modes = {
                **truth.modes_waves[w.channel],
                4: visits[w.range_mm].defocus_waves[w.channel],
            }
            true = tuple(modes.get(j, 0.0) for j in w.noll)
            estimate = tuple(map(float, w.waves))
            std = tuple(map(float, w.std))
            yield ComparedWavefront(w.channel, w.range_mm, w.noll, true, estimate, std)


def next_steps(folder: Path) -> str:
    """Return what to do after the demo, and how to put labkit on the path if necessary."""
    commands = {
        "labkit plan IMAGE": "drafts a plan from a photograph of your own",
        "labkit import FRAMES.csv PLAN.toml SESSION": "makes a session of photographs that you have",
        f"labkit advise {folder}/plan.toml": "predicts what a plan will determine",
        f"labkit capture {folder}/plan.toml SESSION": "photographs once more, on simulated devices",
    }
    width = max(map(len, commands))
    steps = "\n".join(
        [
            "",
            f"Next: open {folder}/results/latest/report.html in a browser. Then",
            *(f"  {command:{width}}  {does}" for command, does in commands.items()),
            "Documentation: docs/index.md in the repository; `make docs` builds it as a site.",
        ]
    )
    return steps if which("labkit") else f"{steps}\n{_on_the_path()}"


def _on_the_path() -> str:
    root = Path(__file__).resolve().parents[1]
    source = root if (root / "pyproject.toml").exists() else "labkit"
    ways = [f"  uv tool install {source}", f"  pipx install {source}"]
    activate = Path(sys.prefix) / "bin" / "activate"
    if activate.exists():
        ways.insert(0, f"  source {activate}   (in each shell)")
    return "\n".join(
        ["The command labkit is not on your path. One of these puts it there:", *ways]
    )


def new_folder(base: Path) -> Path:
    """Return `base` or the first of base-2, base-3, … that does not exist."""
    number = 1
    folder = base
    while folder.exists():
        number += 1
        folder = base.with_name(f"{base.name}-{number}")
    return folder
