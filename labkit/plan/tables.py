"""The tables of a plan, as TOML writes them; attribute names are the TOML names."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Annotated, Literal

from pydantic import (
    AfterValidator,
    Field,
    ValidationInfo,
    field_validator,
    model_validator,
)

from labkit.plan.fields import (
    Address,
    Allowed,
    Corner,
    Count,
    Length,
    Line,
    Name,
    Number,
    matches,
    not_allowed,
    problem,
    repeated,
)
from labkit.plan.table import Table
from labkit.uncertain import Uncertain

LAST_NOLL = 66
"""The last Zernike mode that can be fitted: all of the tenth radial order."""

NEEDED = {
    **{
        "sierpinski": ("order",),
        "tribar": ("order",),
        "checkerboard": ("cells",),
        "noise": ("cells",),
        "image": ("file",),
    },
    "disks": ("grid", "diameter_mm"),
}
"""Kind of target -> the fields that it cannot do without."""

ENGRAVED_FOCAL_LENGTH, ENGRAVED_F_NUMBER, PRINTED_SIZE, FILTER_WAVELENGTH = 0.02, 0.03, 1e-4, 0.005
"""Relative standard errors of engravings, of a target's size, and of a colour's wavelength, that a plan does not state."""

WITHIN_CHANNEL = 0.05
"""Of a channel's wavelength: as far the mean of its spectrum may lie from it."""

LEAST_LIT = 0.05
APERTURE = f"[across, down], each {LEAST_LIT:g} to 1"
SPECTRUM = "[[nm, weight], ...] with weights from 0, some above"
NOLL = f"[first, last] with 4 <= first <= last <= {LAST_NOLL}"
CORNERS = "four finite corners [row, col] of a convex quadrilateral, in order around it"


Error = Annotated[Number, AfterValidator(Allowed(0, 1e6))]


class Lens(Table):
    """The lens as engraved: nominal values are enough.

    focal_length_std_mm, f_number_std: how far engravings may be off, standard errors; 2 % and 3 % where they are left out.
    """

    focal_length_mm: Annotated[Number, AfterValidator(Allowed(0.1, 10_000))]
    f_number: Annotated[Number, AfterValidator(Allowed(0.3, 256))]
    focal_length_std_mm: Error | None = None
    f_number_std: Error | None = None

    @property
    def stated_focal_length(self) -> Uncertain:
        """As engraved, with its error."""
        return _stated(self.focal_length_mm, self.focal_length_std_mm, ENGRAVED_FOCAL_LENGTH, "mm")

    @property
    def stated_f_number(self) -> Uncertain:
        """As engraved, with its error."""
        return _stated(self.f_number, self.f_number_std, ENGRAVED_F_NUMBER)

    @model_validator(mode="after")
    def _possible(self) -> Lens:
        _refuse_larger(self, "focal_length_mm", "focal_length_std_mm")
        _refuse_larger(self, "f_number", "f_number_std")
        return self


class Channel(Table):
    """A colour of the filter array and the wavelength that stands for it; 0.5 % is its standard error if none is given.

    spectrum: [[nm, weight], ...], of the light times the filter, where it is known.
    """

    name: Name
    wavelength_nm: Annotated[Number, AfterValidator(Allowed(100, 20_000))]
    wavelength_std_nm: Error | None = None
    spectrum: Annotated[tuple[tuple[Number, Number], ...] | None, Field(description=SPECTRUM)] = None

    @property
    def samples(self) -> tuple[list[float], list[float]]:
        """Wavelengths, nm, and weights of the spectrum. Raises ValueError where there is none."""
        if self.spectrum is None:
            raise ValueError(f"channel {self.name} has no spectrum")
        return [nm for nm, _ in self.spectrum], [weight for _, weight in self.spectrum]

    @property
    def stated_wavelength(self) -> Uncertain:
        """With its error."""
        return _stated(self.wavelength_nm, self.wavelength_std_nm, FILTER_WAVELENGTH, "nm")

    @model_validator(mode="after")
    def _possible(self) -> Channel:
        _refuse_larger(self, "wavelength_nm", "wavelength_std_nm")
        if self.spectrum is not None:
            nm, weights = self.samples
            if not weights or min(weights) < 0 or not sum(weights) > 0:
                raise problem(f"spectrum has no weight or one below 0: allowed is {SPECTRUM}")
            mean = sum(n * w for n, w in zip(nm, weights, strict=True)) / sum(weights)
            if abs(mean / self.wavelength_nm - 1) > WITHIN_CHANNEL or min(nm) < 100:
                raise problem(
                    f"spectrum lies outside the channel: its mean is {mean:.4g} nm, wavelength_nm is {self.wavelength_nm:g}; "
                    f"allowed is a mean within {WITHIN_CHANNEL:.0%}"
                )
        return self


Cells = Annotated[Count, AfterValidator(Allowed(1, 4096, whole=True))]


class TargetPixels(Table):
    """The pixels of the panel that shows the target, where the camera resolves them.

    pitch_mm: of square pixels; the display's where it is left out. layout: of red, green and blue in each, by columns from left
    to right ("stripes") or by rows from top to bottom, as the frame shows the panel upright. aperture: (across, down), the
    share of its third, and of the pitch along it, that a stripe is lit over; estimated where it is left out.
    """

    pitch_mm: Length | None = None
    layout: Literal["rgb-stripes", "bgr-stripes", "rgb-rows", "bgr-rows"] = "rgb-stripes"
    aperture: Annotated[tuple[Number, Number] | None, Field(description=APERTURE)] = None

    @field_validator("aperture")
    @classmethod
    def _possible(cls, aperture: tuple[float, float] | None) -> tuple[float, float] | None:
        if aperture is not None and not all(LEAST_LIT <= share <= 1 for share in aperture):
            raise not_allowed(APERTURE)
        return aperture


class TargetSpec(Table):
    """What was photographed. `file` is absolute once a plan is loaded.

    order: of a carpet, or octaves of a tri-bar target; cells: along a side of a checkerboard or of noise, which `seed` draws;
    angle_deg: by which a slanted edge leans; grid, diameter_mm: of disks, [rows, columns]. size_std_mm: standard error of the
    size; 1e-4 of it where it is left out.
    """

    kind: Annotated[str, matches("[a-z][a-z0-9_]*", "the name of a target, such as sierpinski or image")]
    size_mm: Length
    size_std_mm: Error | None = None
    order: Annotated[Count, AfterValidator(Allowed(1, 8, whole=True))] | None = None
    cells: Cells | None = None
    seed: Annotated[Count, AfterValidator(Allowed(0, 2**32 - 1, whole=True))] = 0
    angle_deg: Annotated[Number, AfterValidator(Allowed(-45, 45))] = 5.0
    grid: Annotated[tuple[Cells, Cells] | None, Field(description="[rows, columns], each from 1 to 4096")] = None
    diameter_mm: Length | None = None
    surround: Literal["black", "white", "unknown"] = "black"
    file: Path | None = None
    corners_px: Annotated[tuple[Corner, Corner, Corner, Corner] | None, Field(description=CORNERS)] = None
    pixels: TargetPixels | None = None

    @property
    def stated_size(self) -> Uncertain:
        """Its size, with its error."""
        return _stated(self.size_mm, self.size_std_mm, PRINTED_SIZE, "mm")

    @field_validator("file")
    @classmethod
    def _absolute(cls, file: Path | None, info: ValidationInfo) -> Path | None:
        folder: Path = (info.context or {}).get("folder", Path())
        return None if file is None else (folder / file).absolute()

    @field_validator("corners_px")
    @classmethod
    def _convex(cls, corners: tuple[tuple[float, float], ...] | None) -> tuple[tuple[float, float], ...] | None:
        if corners is not None and not _is_convex(corners):
            raise not_allowed(CORNERS)
        return corners

    @model_validator(mode="after")
    def _complete(self, info: ValidationInfo) -> TargetSpec:
        _refuse_larger(self, "size_mm", "size_std_mm")
        for key in NEEDED.get(self.kind, ()):
            if getattr(self, key) is None:
                raise problem(f'{key} is missing: kind = "{self.kind}" needs it')
        if self.pixels is not None and self.surround == "white":
            raise problem('surround = "white": allowed is "black" or "unknown" where [target.pixels] draws the panel')
        checked = (info.context or {}).get("files") != "unchecked"  # a plan that is only read about needs no picture
        if checked and self.file is not None and not os.path.isfile(self.file):
            raise problem(f'file = "{self.file}": there is no such file')
        return self


class FitSettings(Table):
    """What to estimate: Zernike modes by Noll index, the wavelength that waves are counted in, the focus model.

    Standard errors of the ranges: range_std_mm of each beside the others, range_zero_std_mm of what is common to all, the
    tape from the lens to the rail.
    """

    zernike_noll: Annotated[tuple[Count, Count], Field(description=NOLL)] = (4, 15)
    reference_wavelength_nm: Annotated[Number, AfterValidator(Allowed(100, 20_000))] | None = None
    convention: Literal["corrected", "thesis"] = "corrected"
    range_std_mm: Annotated[Number, AfterValidator(Allowed(0, 1000))] = 0.01
    range_zero_std_mm: Error = 10.0

    @field_validator("zernike_noll")
    @classmethod
    def _ordered(cls, noll: tuple[int, int]) -> tuple[int, int]:
        if not 4 <= noll[0] <= noll[1] <= LAST_NOLL:
            raise not_allowed(NOLL)
        return noll


class CameraSettings(Table):
    """How to expose. f_number: what to set on the body, lens.f_number if it is left out."""

    address: Address
    exposure_s: Annotated[Number, AfterValidator(Allowed(1e-5, 3600))]
    iso: Annotated[Count, AfterValidator(Allowed(1, 10_000_000, whole=True))] = 100
    f_number: Annotated[Number, AfterValidator(Allowed(0.3, 256))] | None = None
    capture_target: Literal["ram", "card"] = "ram"
    frames_per_range: Annotated[Count, AfterValidator(Allowed(1, 10_000, whole=True))] = 4
    flats_per_range: Annotated[Count, AfterValidator(Allowed(0, 10_000, whole=True))] = 8
    darks: Annotated[Count, AfterValidator(Allowed(0, 10_000, whole=True))] = 8


class RailSettings(Table):
    """Where to stop: range = range_at_zero_mm + direction * rail position.

    run_up_mm: every stop is approached from below over this way; microstep_um: what a Zaber counts in; homing_std_mm: to
    what its home switch repeats.
    """

    address: Address
    ranges_mm: Annotated[tuple[Length, ...], Field(min_length=1, description="one or more ranges in mm")]
    range_at_zero_mm: Annotated[Number, AfterValidator(Allowed(-1e6, 1e6))]
    direction: Literal[1, -1] = 1
    settle_s: Annotated[Number, AfterValidator(Allowed(0, 3600))] = 1.0
    run_up_mm: Annotated[Number, AfterValidator(Allowed(0, 100))] = 1.0
    microstep_um: Annotated[Number, AfterValidator(Allowed(1e-4, 1e4))] | None = None
    homing_std_mm: Annotated[Number, AfterValidator(Allowed(0, 1000))] = 0.03

    @field_validator("ranges_mm")
    @classmethod
    def _once_each(cls, ranges_mm: tuple[float, ...]) -> tuple[float, ...]:
        if twice := repeated(ranges_mm):
            raise not_allowed(f"each range once, not {twice[0]:g} twice")
        return ranges_mm

    def position_mm(self, range_mm: float) -> float:
        """Where the rail stands at a range."""
        return self.direction * (range_mm - self.range_at_zero_mm)

    def range_mm(self, position_mm: float) -> float:
        """The range when the rail stands at a position."""
        return self.range_at_zero_mm + self.direction * position_mm


class DisplaySettings(Table):
    """The glass the target is shown on: a panel by name, or its pitch and (height, width) in pixels; or "manual:", paper."""

    address: Address
    panel: Line | None = None
    pixel_pitch_mm: Length | None = None
    pixels: Annotated[tuple[Count, Count] | None, Field(description="[height, width] in pixels")] = None

    @property
    def by_hand(self) -> bool:
        """Whether a person puts the target before the camera."""
        return self.address == BY_HAND

    @model_validator(mode="after")
    def _one_way(self) -> DisplaySettings:
        if (self.pixel_pitch_mm is None) != (self.pixels is None):
            raise problem("pixel_pitch_mm and pixels belong together: give both or neither")
        if self.by_hand:
            if self.panel is not None or self.pixels is not None:
                raise problem(f'address = "{BY_HAND}" is a target on paper: leave out panel, pixel_pitch_mm and pixels')
            return self
        if (self.panel is None) == (self.pixels is None):
            raise problem("give either panel, or pixel_pitch_mm and pixels")
        if self.pixels is not None and min(self.pixels) < 1:
            raise problem(f"pixels = {list(self.pixels)}: allowed is [height, width], each at least 1")
        return self


BY_HAND = "manual:"
"""The address of a display that is a sheet of paper."""


def _stated(value: float, std: float | None, relative: float, unit: str = "") -> Uncertain:
    return Uncertain(value, relative * value if std is None else std, unit)


def _refuse_larger(table: Table, name: str, error: str) -> None:
    """Raise for a standard error that is larger than its value."""
    value, std = getattr(table, name), getattr(table, error)
    if std is not None and std > value:
        raise problem(f"{error} = {std:g}: allowed is 0 to {name} = {value:g}")


def _is_convex(corners: tuple[tuple[float, float], ...]) -> bool:
    """Whether going round the corners turns the same way at each."""
    turns = []
    for i in range(4):
        (r0, c0), (r1, c1), (r2, c2) = corners[i - 2], corners[i - 1], corners[i]
        turns.append((r1 - r0) * (c2 - c1) - (c1 - c0) * (r2 - r1))
    return all(math.isfinite(t) for t in turns) and (min(turns) > 0 or max(turns) < 0)
