"""Check the bench before the first photograph, at both ends of the rail, and name all faults at once.

The check covers devices, free disk space, and test photographs of white and target at the
nearest and the farthest range: is the light right, is the whole target in the frame, is it
sharp enough for a fit? The latest test photographs are kept in SESSION/preflight, each with
a picture that shows the target's outline; they are no frames.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from labkit.acquisition.log import CaptureLog
from labkit.acquisition.patient import PatientDevices
from labkit.devices.protocols import Check, Checkable, Picture
from labkit.errors import DataError, DeviceError, InputError, LabkitError, TargetError
from labkit.finder.cut import cut_around
from labkit.finder.find_target import margin_px
from labkit.finder.lattice import find_targets
from labkit.finder.preview import Look, jpeg
from labkit.finder.sharpness import blur_px, sharpest_edge_px
from labkit.optics.lens import (
    ThinLens,
    blur_per_wave_um,
    circle_of_confusion_mm,
    ground_sample_mm,
)
from labkit.optics.wavefront import FARTHEST_WAVES
from labkit.panel.picture import PanelPicture
from labkit.photographs.decoding import read_photograph
from labkit.photographs.exposure import exposure_problem
from labkit.photographs.photograph import WHOLE, Cut, Photograph
from labkit.plan import Plan
from labkit.session.session import PREFLIGHT_FOLDER
from labkit.storage.files import write_atomically, writing
from labkit.target.target import open_target
from labkit.types import Floats

Result = TypeVar("Result")

SPARE_SHARE = 0.05
"""Of the room that photographs will take: kept free for journal and results."""


@dataclass(slots=True)
class Findings:
    """Results of a preflight: errors, remarks for a person, and measured numbers by subject.

    dark: whether camera or display failed for good, so that no more photographs are tried.
    """

    problems: list[LabkitError] = field(default_factory=list)
    dark: bool = False
    corners_px: list[Floats] = field(default_factory=list)
    """(4, 2) of each target found."""
    by_hand: list[str] = field(default_factory=list)
    measured: dict[str, Any] = field(default_factory=dict)

    def tried(self, action: Callable[[], Result]) -> Result | None:
        """Return the result of an action; record its error and return None if it fails."""
        try:
            return action()
        except (DeviceError, InputError) as error:
            self.problems.append(error)
            return None

    def succeeds(self, action: Callable[[], object]) -> bool:
        """Run an action, record its error, and return whether it succeeded."""
        before = len(self.problems)
        self.tried(action)
        return len(self.problems) == before

    def raise_problems(self) -> None:
        """Raise the only error, or a single one that lists all; do nothing without errors."""
        if len(self.problems) == 1:
            raise self.problems[0]
        if self.problems:
            kind = (
                DeviceError
                if any(isinstance(error, DeviceError) for error in self.problems)
                else DataError
            )
            listed = "; ".join(f"({i}) {error}" for i, error in enumerate(self.problems, 1))
            raise kind(f"{len(self.problems)} things are not right: {listed}")


def preflight(
    plan: Plan,
    patient: PatientDevices,
    log: CaptureLog,
    *,
    picture: PanelPicture,
    ends_mm: Sequence[float],
    frames: int,
    folder: Path,
) -> Findings:
    """Look at everything once. ends_mm: the nearest and the farthest stop; frames: photographs to come, into `folder`."""
    findings = Findings()
    look = _Round(plan, patient, log, findings, folder / PREFLIGHT_FOLDER)
    shutil.rmtree(look.folder, ignore_errors=True)  # of an earlier preflight
    ready = findings.succeeds(patient.ready)
    for device in (patient.devices.camera, patient.devices.rail, patient.devices.display):
        _check(device, frames, findings)
    homed = bool(ends_mm) and findings.succeeds(patient.home)
    blurs_px: dict[float, float] = {}
    for range_mm in ends_mm:
        there = homed and findings.succeeds(partial(patient.go_to, range_mm))
        blur = (
            look.round(picture, range_mm) if there and ready and not findings.dark else None
        )
        if blur is not None:
            blurs_px[range_mm] = blur
    if "frame_bytes" in findings.measured:
        _check_disk(folder, frames, findings)
    findings.problems += _focus_problems(plan, blurs_px)
    return findings


def _check(device: object, frames: int, findings: Findings) -> None:
    if isinstance(device, Checkable):
        check = findings.tried(lambda: device.check(frames)) or Check()
        findings.problems += [DeviceError(problem) for problem in check.problems]
        findings.by_hand += check.by_hand


@dataclass(frozen=True, slots=True)
class _Round:
    """Test photographs and what they show. folder: of the photographs."""

    plan: Plan
    patient: PatientDevices
    log: CaptureLog
    findings: Findings
    folder: Path

    def round(self, picture: PanelPicture, range_mm: float) -> float | None:
        """Photograph white and target at a range. Return the target's blur circle in pixels; None without target."""
        white = self._photograph(range_mm, "white")
        shown = self._photograph(range_mm, picture.grey)
        found = None if shown is None else self._search(shown.look, range_mm)
        corners = None if isinstance(found, TargetError) else found
        if white is not None:
            problem = (
                self._check_white(white, range_mm, corners)
                if "exposure" not in self.findings.measured
                else ""
            )
            self._keep(replace(white.look, note=problem), white)
        if shown is None:
            return None
        before = len(self.findings.problems)
        if isinstance(found, TargetError):
            self.findings.problems.append(
                TargetError(f"at {range_mm:g} mm: {found}, see {shown.seen}")
            )
        likely = found.likely_px if isinstance(found, TargetError) else ()
        look = replace(shown.look, corners_px=corners, likely_px=likely)
        blur = None
        if corners is not None:
            self.findings.corners_px += list(corners)
            blur = self._blur_px(look, range_mm, shown.seen)
        note = "; ".join(map(str, self.findings.problems[before:])).partition(", see ")[0]
        place = _place(corners, look.mosaic)
        edge = sharpest_edge_px(look.mosaic, place)
        self._keep(replace(look, note=note, edge_px=edge), shown)
        return blur

    def _check_white(self, white: _Kept, range_mm: float, corners: Floats | None) -> str:
        """Record how white is exposed, where the target is found (n, 4, 2) or in the whole frame."""
        mosaic = white.look.mosaic
        names = (channel.name for channel in self.plan.channel)
        place = _place(corners, mosaic)
        problem = exposure_problem(mosaic, "flat", names, place)
        self.findings.measured["exposure"] = problem or "right"
        if problem:
            hint = (
                "; is the cap on the lens, the display dark?" if "black" in problem else ""
            )
            words = f"a test photograph of white at {range_mm:g} mm {problem}{hint}"
            self.findings.problems.append(DataError(f"{words}, see {white.seen}"))
        return problem or ""

    def _search(self, look: Look, range_mm: float) -> Floats | TargetError:
        """Return the corners of all targets (n, 4, 2), or why none is found."""
        plan = self.plan
        if given := plan.target.corners_px:
            return np.array([given])
        lens = ThinLens(plan.lens.focal_length_mm, plan.lens.f_number)
        scale = float(ground_sample_mm(lens, range_mm, plan.sensor.pixel_pitch_um))
        try:
            return find_targets(look.mosaic, plan.target, mm_per_pixel=scale)
        except TargetError as error:
            return error

    def _blur_px(self, look: Look, range_mm: float, seen: Path) -> float:
        corners, shape = look.corners_px, look.mosaic.shape
        assert corners is not None
        blur = blur_px(look.mosaic, open_target(self.plan.target), corners[0])
        margin = margin_px(corners, shape)
        if margin < 0:
            away = f"the target reaches {-margin:.0f} pixels out of the frame: move it, or the camera, back in"
            self.findings.problems.append(
                TargetError(f"at {range_mm:g} mm: {away}, see {seen}")
            )
        self.findings.measured[f"{range_mm:g} mm"] = {
            "blur_px": round(blur, 1),
            "margin_px": round(margin, 1),
        }
        if self.plan.target.of_many:
            self._note_field(corners, shape, range_mm)
        return blur

    def _note_field(self, tiles: Floats, shape: tuple[int, ...], range_mm: float) -> None:
        """State how much of the frame a grid's targets (n, 4, 2) cover, and how many are missing."""
        covered = np.ptp(tiles.reshape(-1, 2), axis=0) / shape
        of_all = int(np.prod(self.plan.target.grid or (1, 1)))
        self.findings.measured[f"{range_mm:g} mm"]["targets"] = len(tiles)
        self.findings.by_hand.append(
            f"at {range_mm:g} mm {len(tiles)} of the grid's {of_all} targets are wholly in the frame, and cover "
            f"{covered[1]:.0%} of its width and {covered[0]:.0%} of its height"
        )

    def _photograph(self, range_mm: float, picture: Picture) -> _Kept | None:
        name = (
            f"preflight_{range_mm:.10g}_{picture if isinstance(picture, str) else 'target'}"
        )

        def take() -> _Kept:
            self.patient.show(picture)
            self.log.step(f"taking {name}")
            path = self.patient.photograph(picture, name).path
            file = self.folder / path.name
            with writing(file):
                self.folder.mkdir(exist_ok=True)
                path.replace(file)
            self.findings.measured["frame_bytes"] = file.stat().st_size
            return _Kept(
                Look(name, range_mm, read_photograph(file, self.plan.sensor)), file
            )

        if self.findings.dark:
            return None
        kept = self.findings.tried(take)
        self.findings.dark = kept is None and isinstance(
            self.findings.problems[-1], DeviceError
        )
        return kept

    def _keep(self, look: Look, kept: _Kept) -> None:
        """Show a look to observers, and write its picture beside the photograph."""
        self.log.saw(look)
        self.findings.succeeds(
            lambda: write_atomically(
                kept.seen, jpeg(look.mosaic, look.corners_px, look.likely_px)
            )
        )


@dataclass(frozen=True, slots=True)
class _Kept:
    """A test photograph and its file."""

    look: Look
    file: Path

    @property
    def seen(self) -> Path:
        """Path of the photograph's preview."""
        return self.file.with_name(f"{self.file.stem}_seen.jpg")


def _place(corners: Floats | None, mosaic: Photograph) -> Cut:
    """Return rows and columns around the targets (n, 4, 2); the whole frame where none are found."""
    return WHOLE if corners is None else cut_around(list(corners), mosaic.shape)


def _check_disk(folder: Path, frames: int, findings: Findings) -> None:
    needed = findings.measured["frame_bytes"] * frames * (1 + SPARE_SHARE)
    free = shutil.disk_usage(folder).free
    findings.measured["free_bytes"] = free
    if free < needed:
        findings.problems.append(
            InputError(
                f"{frames} photographs take {needed / 1e9:.2f} GB, and {free / 1e9:.2f} GB are free at {folder}: "
                f"make room, or capture to another disk"
            )
        )


def _focus_problems(plan: Plan, blurs_px: dict[float, float]) -> list[LabkitError]:
    """Return errors for blur too large for a fit, and for best focus far beyond the rail.

    Best focus may lie beyond the rail by at most the rail's own travel.
    """
    lens = ThinLens(plan.lens.focal_length_mm, plan.lens.f_number)
    pitch_mm = plan.sensor.pixel_pitch_um * 1e-3
    per_wave_um = blur_per_wave_um(lens.f_number, plan.reference_wavelength_nm * 1e-3)
    limit_mm = FARTHEST_WAVES * per_wave_um * 1e-3
    problems: list[LabkitError] = [
        DataError(
            f"out of focus at {range_mm:g} mm: a point spreads over {blur:.0f} pixels, "
            f"up to {limit_mm / pitch_mm:.0f} can be fitted; focus on the middle of the ranges"
        )
        for range_mm, blur in blurs_px.items()
        if blur * pitch_mm > limit_mm
    ]
    if len(blurs_px) == 2 and not problems:
        near, far = sorted(blurs_px)
        way_px = float(circle_of_confusion_mm(lens, far, near)) / pitch_mm
        least = min(blurs_px.values())
        if least > max(2 * way_px, 8.0):
            problems.append(
                DataError(
                    f"best focus is far from the ranges: a point spreads over {blurs_px[near]:.0f} pixels at {near:g} mm and "
                    f"{blurs_px[far]:.0f} at {far:g} mm; focus between them"
                )
            )
    return problems
