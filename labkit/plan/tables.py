"""The tables of a plan, as TOML writes them; attribute names are the TOML names."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Annotated, Literal

from pydantic import (
    AfterValidator,
    Field,
    Strict,
    ValidationInfo,
    field_validator,
    model_validator,
)

from labkit.plan.fields import (
    LONGEST_PATH,
    Address,
    Allowed,
    Corner,
    Count,
    Length,
    Line,
    Note,
    Number,
    Short,
    Takes,
    matches,
    not_allowed,
    or_fit,
    problem,
    repeated,
)
from labkit.plan.mode_groups import MODE_GROUPS, MOST_NOLL, USUAL_NOLL
from labkit.plan.table import Error, Table, refuse_larger, stated
from labkit.uncertain import Uncertain

LAST_NOLL = 66
"""The last Zernike mode that can be fitted: all of the tenth radial order."""

NEEDED_BY_KIND = {
    **{
        "sierpinski": ("order",),
        "tribar": ("order",),
        "checkerboard": ("cells",),
        "noise": ("cells",),
        "image": ("file",),
    },
    "disks": ("grid", "diameter_mm"),
}
"""Required fields by kind of target."""

ENGRAVED_FOCAL_LENGTH, ENGRAVED_F_NUMBER, PRINTED_SIZE = 0.02, 0.03, 1e-4
"""Relative standard errors of engravings and of a target's size that a plan does not state."""

MOST_TARGETS = 10_000
"""Targets in a grid: a frame of 100 megapixels has room for as many."""

LEAST_APERTURE = 0.05
APERTURE_WORDS = f"[across, down], each {LEAST_APERTURE:g} to 1"
NOLL_WORDS = f"[first, last] with 4 <= first <= last <= {LAST_NOLL}"
CORNERS_WORDS = (
    "four finite corners [row, col] of a convex quadrilateral, in order around it"
)


class Lens(Table):
    """The lens as engraved; nominal values are enough."""

    focal_length_mm: Annotated[Number, AfterValidator(Allowed(0.1, 10_000))]
    """Focal length as engraved."""
    f_number: Annotated[Number, AfterValidator(Allowed(0.3, 256))]
    """Engraved f-number: at infinity, at the selected aperture, of the circle as large as the pupil's clear
    area.
    """
    veil: Annotated[
        float | Literal["fit"] | None, or_fit(0, 0.5), Takes('0 to 0.5, or "fit"')
    ] = None
    """Veiling glare: share of the light that the lens scatters widely; `"fit"` estimates it. Default: none, and
    `labkit fit` tests for glare.
    """
    veil_scale_px: Annotated[Number, AfterValidator(Allowed(3, 100))] = 15.0
    """Distance over which the veiling glare falls to 1/e, pixels. A fitted glare starts here and has its own
    distance.
    """
    blades: Annotated[Count, AfterValidator(Allowed(3, 20, whole=True))] | None = None
    """Number of blades of the diaphragm, which shape the pupil; their direction and roundness are estimated. Default:
    `labkit fit` looks for 5 to 11 blades."""
    obstruction: Annotated[
        float | Literal["fit"] | None, or_fit(0, 0.89), Takes('0 to 0.89, or "fit"')
    ] = None
    """Diameter of the pupil's obstructed middle over the pupil's, such as a mirror lens's; `"fit"` estimates
    it. Default: none, and `labkit fit` tests for an obstruction.
    """
    name: Short | None = None
    """Name of the lens, for the report and the catalogue. Default: as the photographs' EXIF states it."""
    serial: Short | None = None
    """Serial number of the lens. Default: as the photographs' EXIF states it."""
    focal_length_std_mm: Error | None = None
    """Standard error of the engraved focal length. Default: 2 %."""
    f_number_std: Error | None = None
    """Standard error of the engraved f-number. Default: 3 %."""

    @property
    def stated_focal_length(self) -> Uncertain:
        """Engraved focal length, with its error."""
        return stated(
            self.focal_length_mm, self.focal_length_std_mm, ENGRAVED_FOCAL_LENGTH, "mm"
        )

    @property
    def stated_f_number(self) -> Uncertain:
        """Engraved f-number, with its error."""
        return stated(self.f_number, self.f_number_std, ENGRAVED_F_NUMBER)

    @model_validator(mode="after")
    def _possible(self) -> Lens:
        refuse_larger(self, "focal_length_mm", "focal_length_std_mm")
        refuse_larger(self, "f_number", "f_number_std")
        return self


Cells = Annotated[Count, AfterValidator(Allowed(1, 4096, whole=True))]


class TargetPixels(Table):
    """The pixels of the panel that shows the target, where the camera resolves them. The table may be empty."""

    pitch_mm: Length | None = None
    """Pitch of the panel's square pixels. Default: as in `[display]`."""
    layout: Literal["rgb-stripes", "bgr-stripes", "rgb-rows", "bgr-rows"] = "rgb-stripes"
    """Order of the colours in a pixel, as the photograph shows the panel upright: columns from left to right (stripes), or rows
    from top to bottom."""
    aperture: Annotated[tuple[Number, Number] | None, Takes(APERTURE_WORDS)] = None
    """Lit share of a stripe: of its third of a pixel, and of the pitch along the stripe. Default: estimated."""

    @field_validator("aperture")
    @classmethod
    def _possible(cls, aperture: tuple[float, float] | None) -> tuple[float, float] | None:
        if aperture is not None and not all(
            LEAST_APERTURE <= share <= 1 for share in aperture
        ):
            raise not_allowed(APERTURE_WORDS)
        return aperture


class TargetSpec(Table):
    """The photographed target. The needed keys depend on its kind."""

    kind: Annotated[
        str, matches("[a-z][a-z0-9_]*", "the name of a target, such as sierpinski or image")
    ]
    """Kind of target: built into labkit, or from a package of your own."""
    size_mm: Length
    """Side of the whole target; the height of a target that is not square."""
    size_std_mm: Error | None = None
    """Standard error of the size. Default: 1e-4 of the size."""
    order: Annotated[Count, AfterValidator(Allowed(1, 8, whole=True))] | None = None
    """Order of a Sierpinski carpet, which has 3ⁿ × 3ⁿ cells; octaves of a tri-bar target. Default: none."""
    cells: Cells | None = None
    """Squares along a side of a checkerboard or of noise. Default: none."""
    seed: Annotated[Count, AfterValidator(Allowed(0, 2**32 - 1, whole=True))] = 0
    """Number from which noise is drawn; the same number draws the same target."""
    angle_deg: Annotated[Number, AfterValidator(Allowed(-45, 45))] = 5.0
    """Angle of a slanted edge to the vertical; its lower end leans to the right."""
    grid: Annotated[
        tuple[Cells, Cells] | None, Takes("[rows, columns], each from 1 to 4096")
    ] = None
    """Rows and columns of equal targets that fill the frame, `pitch_mm` apart; `size_mm` stays the size of one target. Of
    disks: rows and columns of disks, each in the middle of a square; `size_mm` is the height of all rows. Default: none."""
    pitch_mm: Length | None = None
    """Distance of a grid's targets from centre to centre, the same along rows and columns, larger than a target.
    Default: none, a grid of targets needs it."""
    marks: Annotated[bool, Strict()] = False
    """Whether ArUco marks stand between a grid's targets. They tell which rows and columns a photograph shows where the frame
    cuts the grid, and whether the grid is turned or mirrored. Of a single target: whether one stands beyond each corner, by
    which it is found. With its marks it takes 2.2 of its sides."""
    diameter_mm: Length | None = None
    """Diameter of a disk, less than the side of its square. Default: none."""
    surround: Literal["black", "white", "unknown"] = "black"
    """Radiance around the target."""
    file: Path | None = None
    """Grey PNG, PGM or TIFF, relative to the plan; its values are relative radiance. Default: none."""
    corners_px: Annotated[
        tuple[Corner, Corner, Corner, Corner] | None, Takes(CORNERS_WORDS)
    ] = None
    """Corners of the target in the photographs, in the order (0, 0), (0, w), (h, w), (h, 0) of its own; pixel centres are at
    integers, rows count down, columns right. Default: labkit searches for the target."""
    pixels: TargetPixels | None = None

    @property
    def stated_size(self) -> Uncertain:
        """Size of the target, with its error."""
        return stated(self.size_mm, self.size_std_mm, PRINTED_SIZE, "mm")

    @property
    def of_many(self) -> bool:
        """Return whether `grid` is of whole targets."""
        return self.grid is not None and self.kind != "disks"

    @field_validator("file")
    @classmethod
    def _absolute(cls, file: Path | None, info: ValidationInfo) -> Path | None:
        folder: Path = (info.context or {}).get("folder", Path())
        if file is not None and len(str(file)) > LONGEST_PATH:
            raise not_allowed(f"a path of {LONGEST_PATH} characters at most")
        return None if file is None else (folder / file).absolute()

    @field_validator("corners_px")
    @classmethod
    def _convex(
        cls, corners: tuple[tuple[float, float], ...] | None
    ) -> tuple[tuple[float, float], ...] | None:
        if corners is not None and not _is_convex(corners):
            raise not_allowed(CORNERS_WORDS)
        return corners

    @model_validator(mode="after")
    def _complete(self, info: ValidationInfo) -> TargetSpec:
        refuse_larger(self, "size_mm", "size_std_mm")
        for key in NEEDED_BY_KIND.get(self.kind, ()):
            if getattr(self, key) is None:
                raise problem(f'{key} is missing: kind = "{self.kind}" needs it')
        self._possible_grid()
        if self.pixels is not None and self.surround == "white":
            raise problem(
                'surround = "white": allowed is "black" or "unknown" where [target.pixels] draws the panel'
            )
        # a plan that is only read about needs no picture
        needed = (info.context or {}).get("files_needed", True)
        if needed and self.file is not None and not os.path.isfile(self.file):
            if os.path.exists(self.file):
                raise problem(f'file = "{self.file}": a folder, a pipe or a device')
            raise problem(f'file = "{self.file}": there is no such file')
        return self

    def _possible_grid(self) -> None:
        """Raise an error for a grid of targets without distance, or for a distance without grid."""
        if not self.of_many:
            if self.pitch_mm is not None:
                raise problem(
                    f"pitch_mm = {self.pitch_mm:g}: {_NO_PITCH[self.kind == 'disks']}"
                )
            return
        rows, cols = self.grid or (1, 1)
        if self.marks and rows == cols == 1:
            raise problem(
                "grid = [1, 1]: marks of a single target need no grid, leave it out"
            )
        if rows * cols > MOST_TARGETS:
            raise problem(
                f"grid = [{rows}, {cols}]: allowed are up to {MOST_TARGETS} targets"
            )
        if self.pitch_mm is None:
            raise problem("pitch_mm is missing: a grid of targets needs it")
        if not self.pitch_mm > self.size_mm:
            raise problem(
                f"pitch_mm = {self.pitch_mm:g}: allowed is more than size_mm = {self.size_mm:g}, the side of one target"
            )
        if self.corners_px is not None:
            raise problem("corners_px are of a single target: leave out corners_px or grid")


_NO_PITCH = (
    "only a grid of targets has a pitch: give grid = [rows, columns] too",
    "disks are size_mm / rows apart: leave out pitch_mm",
)


class FitSettings(Table):
    """Settings of the estimate, and the uncertainty of the ranges."""

    zernike_noll: Annotated[tuple[Count, Count], Takes(NOLL_WORDS)] | None = None
    """First and last Zernike mode to estimate, in Noll's order: exactly these. Default: 4 to 15, and the higher
    radial orders that the photographs show.
    """
    most_noll: Annotated[Count, AfterValidator(Allowed(USUAL_NOLL[1], 45, whole=True))] = (
        MOST_NOLL
    )
    """Last mode that may be added if `zernike_noll` is not stated."""
    reference_wavelength_nm: (
        Annotated[Number, AfterValidator(Allowed(100, 20_000))] | None
    ) = None
    """Wavefronts are reported in waves of this wavelength. Default: 450 nm, or the wavelength of a single channel."""
    convention: Literal["corrected", "thesis"] = "corrected"
    """Focus model: with the thesis's equation (4.40) corrected, or as printed there."""
    range_std_mm: Annotated[Number, AfterValidator(Allowed(0, 1000))] = 0.01
    """Standard error of a range reading relative to the others."""
    range_zero_std_mm: Error = 10.0
    """Standard error of the range zero, which all ranges share: of the tape measure from lens to rail."""

    @field_validator("zernike_noll")
    @classmethod
    def _ordered(cls, noll: tuple[int, int] | None) -> tuple[int, int] | None:
        if noll is not None and not 4 <= noll[0] <= noll[1] <= LAST_NOLL:
            raise not_allowed(NOLL_WORDS)
        return noll

    @property
    def noll(self) -> tuple[int, ...]:
        """Modes that are always estimated, by Noll's numbers."""
        first, last = self.zernike_noll or USUAL_NOLL
        return tuple(range(first, last + 1))

    @property
    def mode_groups(self) -> tuple[str, ...]:
        """Names of the groups of modes that the session may add, the lowest first."""
        if self.zernike_noll is not None:
            return ()
        return tuple(
            group.name for group in MODE_GROUPS.values() if group.last <= self.most_noll
        )


class About(Table):
    """Text for the report's title and every page of its PDF. No number depends on this table."""

    title: Short | None = None
    """Title of the report. Default: the session's name."""
    operator: Short | None = None
    """Name of the person who measured."""
    note: Note | None = None
    """Further text for every page."""


class CameraSettings(Table):
    """The camera: its name, and for a capture its address, exposure and number of photographs."""

    body: Short | None = None
    """Name of the camera's body, for the catalogue. Default: as the photographs' EXIF states it."""
    address: Address = Field(default_factory=str)
    """Driver and device: `"gphoto2:"` for the only camera on USB, `"gphoto2:usb:001,004"`, on a network
    `"gphoto2:ptpip:192.168.1.5"`, `"simulated:"`. Default: none, a capture needs it."""
    exposure_s: Annotated[Number, AfterValidator(Allowed(1e-5, 3600))] = Field(
        default_factory=float
    )
    """Exposure time of every frame. Default: none, a capture needs it."""
    iso: Annotated[Count, AfterValidator(Allowed(1, 10_000_000, whole=True))] = 100
    """Sensitivity of every frame."""
    f_number: Annotated[Number, AfterValidator(Allowed(0.3, 256))] | None = None
    """Aperture to set on the camera, if different from `lens.f_number`. Default: `lens.f_number`."""
    capture_target: Literal["ram", "card"] = "ram"
    """The camera's storage for a photograph before its transfer; photographs on a card stay there."""
    frames_per_range: Annotated[Count, AfterValidator(Allowed(1, 10_000, whole=True))] = 4
    """Photographs of the target at each range."""
    flats_per_range: Annotated[Count, AfterValidator(Allowed(0, 10_000, whole=True))] = 8
    """Photographs of the white display at each range."""
    darks: Annotated[Count, AfterValidator(Allowed(0, 10_000, whole=True))] = 8
    """Photographs with the lens capped."""

    @property
    def captures(self) -> bool:
        """Return whether a capture can use the camera: a table with only the body's name is not enough."""
        return bool(self.address)

    @model_validator(mode="after")
    def _complete(self) -> CameraSettings:
        needed = ("address", "exposure_s")
        missing = [name for name in needed if name not in self.model_fields_set]
        if missing and self.model_fields_set != {"body"}:
            raise problem(
                f"{missing[0]} is missing: allowed is body alone, or both of {', '.join(needed)}"
            )
        return self


Time = Annotated[Number, AfterValidator(Allowed(1e-6, 3600))]


class NoiseSettings(Table):
    """A photon-transfer series: with this table `labkit capture` takes darks and flats of several exposure times at the
    first range, for `labkit noise`, and no photographs of the target."""

    exposures_s: Annotated[
        tuple[Time, ...], Field(min_length=5), Takes("five or more exposure times in s")
    ]
    """Exposure times of flats and darks, each once: 15 or more in even steps, the last one or two beyond saturation."""
    frames_per_exposure: Annotated[Count, AfterValidator(Allowed(2, 1000, whole=True))] = 2
    """Flats, and darks, at each exposure time."""

    @field_validator("exposures_s")
    @classmethod
    def _once_each(cls, exposures_s: tuple[float, ...]) -> tuple[float, ...]:
        if twice := repeated(exposures_s):
            raise not_allowed(f"each exposure time once, not {twice[0]:g} twice")
        return exposures_s


class RailSettings(Table):
    """The rail: its address and stations. The range is `range_at_zero_mm` + `direction` × rail position."""

    address: Address
    """Driver and device: `"grbl:/dev/ttyUSB0"`, `"zaber:/dev/ttyUSB0"`, `"manual:"`, `"simulated:"`; `"grbl:simulated"` and
    `"zaber:simulated"` are the real drivers on simulated controllers."""
    ranges_mm: Annotated[
        tuple[Length, ...], Field(min_length=1), Takes("one or more ranges in mm")
    ]
    """Distances from the target to the camera at which to photograph, each once and above the focal length."""
    range_at_zero_mm: Annotated[Number, AfterValidator(Allowed(-1e6, 1e6))]
    """Range at rail position 0; `labkit rail calibrate` determines it."""
    direction: Literal[1, -1] = 1
    """1: a larger position is a longer range; -1: a shorter one."""
    settle_s: Annotated[Number, AfterValidator(Allowed(0, 3600))] = 1.0
    """Wait after each move."""
    run_up_mm: Annotated[Number, AfterValidator(Allowed(0, 100))] = 1.0
    """Each stop is approached upward over this distance, to remove backlash."""
    microstep_um: Annotated[Number, AfterValidator(Allowed(1e-4, 1e4))] | None = None
    """Microstep of a Zaber stage, from its data sheet. Default: none; a Zaber stage needs it."""
    homing_std_mm: Annotated[Number, AfterValidator(Allowed(0, 1000))] = 0.03
    """Repeatability of the home switch, as a standard error."""

    @field_validator("ranges_mm")
    @classmethod
    def _once_each(cls, ranges_mm: tuple[float, ...]) -> tuple[float, ...]:
        if twice := repeated(ranges_mm):
            raise not_allowed(f"each range once, not {twice[0]:g} twice")
        return ranges_mm

    def position_mm(self, range_mm: float) -> float:
        """Return the rail's position at a range."""
        return self.direction * (range_mm - self.range_at_zero_mm)

    def range_mm(self, position_mm: float) -> float:
        """Return the range at a position of the rail."""
        return self.range_at_zero_mm + self.direction * position_mm


class DisplaySettings(Table):
    """The display that shows the target. Give `panel`, or `pixel_pitch_mm` and `pixels`; or `address = "manual:"`, paper."""

    address: Address
    """Driver and place: `"web://127.0.0.1:8642"` for a browser on this machine, `"web://0.0.0.0:8642"` also for
    browsers on the network, `"simulated:"`.
    """
    panel: Line | None = None
    """Name of a known panel. Default: none."""
    pixel_pitch_mm: Length | None = None
    """Pixel pitch of any other panel, from its data sheet. Default: as of `panel`."""
    pixels: Annotated[tuple[Count, Count] | None, Takes("[height, width] in pixels")] = None
    """Size of any other panel. Default: as of `panel`."""

    @property
    def by_hand(self) -> bool:
        """Return whether a person puts the target before the camera."""
        return self.address == BY_HAND

    @model_validator(mode="after")
    def _one_way(self) -> DisplaySettings:
        if (self.pixel_pitch_mm is None) != (self.pixels is None):
            raise problem("pixel_pitch_mm and pixels belong together: give both or neither")
        if self.by_hand:
            if self.panel is not None or self.pixels is not None:
                raise problem(
                    f'address = "{BY_HAND}" is a target on paper: leave out panel, pixel_pitch_mm and pixels'
                )
            return self
        if (self.panel is None) == (self.pixels is None):
            raise problem("give either panel, or pixel_pitch_mm and pixels")
        if self.pixels is not None and min(self.pixels) < 1:
            raise problem(
                f"pixels = {list(self.pixels)}: allowed is [height, width], each at least 1"
            )
        return self


BY_HAND = "manual:"
"""The address of a display that is a sheet of paper."""


def _is_convex(corners: tuple[tuple[float, float], ...]) -> bool:
    """Return whether going round the corners turns the same way at each."""
    turns = []
    for i in range(4):
        (r0, c0), (r1, c1), (r2, c2) = corners[i - 2], corners[i - 1], corners[i]
        turns.append((r1 - r0) * (c2 - c1) - (c1 - c0) * (r2 - r1))
    return all(math.isfinite(t) for t in turns) and (min(turns) > 0 or max(turns) < 0)
