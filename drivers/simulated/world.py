"""The true simulated bench: lens, sensor, panel, rail and pose, coming faults, and the truth, which only demos
and tests may read.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from labkit.drivers.simulated.field import FieldTerms
from labkit.drivers.simulated.optics import REFERENCE_NM
from labkit.drivers.simulated.parts import Lit, LowPassFilter, Smear, Spectrum, Veil
from labkit.drivers.simulated.pupil import ROUND_PUPIL, Pupil
from labkit.types import Floats

FIXED_MODES = tuple(range(5, 16))
"""Noll's modes of the lens's fixed aberration; defocus, 4, comes from the range."""

HIGHER_MODES = tuple(range(16, 37))
"""Noll's modes of radial orders 5 to 7, of which a lens as it is made has a little."""

LEAST_PATCH_PX = 8.0
MOST_STATED_NOLL = 45
MOST_STATED_WAVES = 2.0


@dataclass(frozen=True, slots=True)
class TrueLens:
    """The lens: per colour a wavelength, a best focus, and random fixed modes of an RMS (waves at 450 nm).

    best_focus_mm: true ranges, from the front principal plane. Focal length and f-number
    are green's, or the first colour's; all colours share sensor and aperture, so their own
    follow from their best focus. Modes are Noll's over the disc of the f-number. Raises
    ValueError for impossible aberrations.
    """

    focal_length_mm: float = 70.0
    f_number: float = 2.8
    """At infinity: focal length over the diameter of the circle of the entrance pupil's clear area on the axis.
    """
    pupil_magnification: float = 0.985
    wavelength_nm: Mapping[str, float] = field(
        default_factory=lambda: {"R": 650.0, "G": 550.0, "B": 450.0}
    )
    best_focus_mm: Mapping[str, float] = field(
        default_factory=lambda: {"R": 3024.0, "G": 3013.2, "B": 3031.0}
    )
    noll: tuple[int, ...] = FIXED_MODES
    aberration_waves: float = 0.07
    colour_share: float = 0.15
    """Size of each colour's own aberration, relative to the aberration common to all."""
    higher_waves: float = 0.0
    """RMS of random modes of the orders beyond, `HIGHER_MODES`."""
    stated_waves: Mapping[int, float] = field(default_factory=dict)
    """{Noll mode: waves RMS} of all colours, in place of drawn modes; 5 to 45."""
    pupil: Pupil = ROUND_PUPIL
    lateral_colour: Mapping[str, float] = field(default_factory=dict)
    """Relative excess of a colour's image size; 0 for colours left out."""
    vignetting: float = 0.10
    """Light lost in the frame's corner."""
    spectrum: Mapping[str, Spectrum] = field(default_factory=dict)
    """Spectra of colours with more than one wavelength."""
    veil: Veil = field(default_factory=Veil)
    """Stray light, as vignetted as all light is."""
    field_terms: FieldTerms = field(default_factory=FieldTerms)
    """Properties of the lens that vary over the frame."""

    def __post_init__(self) -> None:
        if not 0 <= self.higher_waves <= MOST_STATED_WAVES:
            raise ValueError(
                f"modes beyond Noll 15 have 0 to {MOST_STATED_WAVES:g} waves RMS, "
                f"not {self.higher_waves:g}"
            )
        for j, waves in self.stated_waves.items():
            if not FIXED_MODES[0] <= j <= MOST_STATED_NOLL:
                raise ValueError(
                    f"modes are stated for Noll {FIXED_MODES[0]} to {MOST_STATED_NOLL}, not {j}; "
                    "defocus, 4, comes from the range"
                )
            if not abs(waves) <= MOST_STATED_WAVES:
                raise ValueError(
                    f"a mode has at most {MOST_STATED_WAVES:g} waves RMS, not {waves:g} (Noll {j})"
                )

    @property
    def outer_f_number(self) -> float:
        """f-number at infinity of the smallest circle round the pupil: outer rim or corners of the blades."""
        return self.f_number / self.pupil.extent

    @property
    def focused_mm(self) -> float:
        """Best focus of green, or of the first colour."""
        return self.best_focus_mm.get("G", next(iter(self.best_focus_mm.values())))

    def focal_length_in(self, colour: str) -> float:
        """Return the focal length, mm, of a colour with another best focus on the same sensor."""
        sensor = (
            1 / self.focal_length_mm - 1 / self.focused_mm
        )  # 1 over its distance from the rear principal plane
        return 1 / (sensor + 1 / self.best_focus_mm[colour])

    def f_number_in(self, colour: str) -> float:
        """Return the f-number of a colour, at infinity."""
        return self.focal_length_in(colour) * self.f_number / self.focal_length_mm

    def lines_in(self, colour: str) -> tuple[tuple[float, float], ...]:
        """Return a colour's wavelengths, nm, and their shares of its light, which sum to one."""
        return (
            self.spectrum[colour].shares
            if colour in self.spectrum
            else ((self.wavelength_nm[colour], 1.0),)
        )

    def defocus_within(self, colour: str, nm: float) -> float:
        """Return the defocus of a wavelength relative to its colour's, waves RMS at REFERENCE_NM."""
        spectrum = self.spectrum.get(colour)
        return (
            spectrum.defocus_waves_per_nm * (nm - self.wavelength_nm[colour])
            if spectrum
            else 0.0
        )

    @property
    def shortest_nm(self) -> float:
        """The shortest wavelength of all colours."""
        return min(nm for colour in self.wavelength_nm for nm, _ in self.lines_in(colour))


@dataclass(frozen=True, slots=True)
class TrueSensor:
    """The sensor and its electronics, at ISO 100."""

    rows: int = 264
    cols: int = 264
    pitch_um: float = 4.78
    fill_factor: float = 1.0
    pattern: str = "RGGB"
    """The 2x2 colour cell, row by row; "mono" for none."""
    black_level: int = 600
    white_level: int = 16383
    counts_per_electron: float = 0.45
    read_noise_electrons: float = 2.5
    response_std: float = 0.007
    hot_pixels: int = 12
    dead_pixels: int = 6
    white_electrons_per_s: float = 1.15e6
    """Electrons from the white panel, in the middle of the frame; other colours have the shares below."""
    colour_response: Mapping[str, float] = field(
        default_factory=lambda: {"R": 0.85, "B": 0.75}
    )
    low_pass: LowPassFilter = field(default_factory=LowPassFilter)
    diffusion_px: float = 0.0
    """Diffusion of charge before collection: sigma of a Gaussian, pixel pitches."""


@dataclass(frozen=True, slots=True)
class TruePanel:
    """The panel: (height, width) in pixels, pitch, gamma, contrast, RMS of its smooth unevenness.

    layout: "rgb-stripes" lights a third of each pixel in each colour, red, green, blue from
    left to right, over a share lit_across of its third and lit_down of its height, with
    black around; a pixel's mean radiance stays the same.
    """

    pixels: tuple[int, int] = (1536, 2048)
    pitch_mm: float = 46.8 / 486
    gamma: float = 2.2
    contrast: float = 800.0
    unevenness: float = 0.02
    layout: Literal["none", "rgb-stripes"] = "none"
    lit_across: float = 0.82
    lit_down: float = 0.88

    def lit(self, colour: str) -> Lit | None:
        """Return the part of each pixel that shines in a colour; None for all of it.

        Raises ValueError for a colour without a stripe.
        """
        if self.layout == "none":
            return None
        if colour not in ("R", "G", "B"):
            raise ValueError(
                f'a panel of stripes shines in R, G and B: none is for "{colour}"'
            )
        middle = ("RGB".index(colour) + 0.5) / 3
        half = self.lit_across / 6
        return Lit(
            (middle - half, middle + half),
            (0.5 - self.lit_down / 2, 0.5 + self.lit_down / 2),
        )


@dataclass(frozen=True, slots=True)
class TrueRail:
    """The rail: travel, its scatter from visit to visit, play between screw and carriage, the encoder's step.

    range_at_zero_mm: as measured by tape in the plan; tape_error_mm: excess of the true
    range
    """

    low_mm: float = 0.0
    high_mm: float = 500.0
    scatter_mm: float = 0.02
    play_mm: float = 0.15
    encoder_step_mm: float = 0.005
    speed_mm_per_s: float = 20.0
    range_at_zero_mm: float = 2950.0
    tape_error_mm: float = 0.0
    homing_scatter_mm: float = 0.0
    """Standard deviation of the home switch's trip point, from which the encoder counts."""
    direction: int = 1
    smear: Smear = field(default_factory=Smear)
    """Smear by vibration during the exposure."""


@dataclass(frozen=True, slots=True)
class TruePose:
    """Largest errors of the camera's aim, drawn evenly within plus and minus these; the roll is at least half
    its limit.
    """

    tilt_deg: float = 0.3
    roll_deg: float = 1.2
    offset_px: float = 3.0
    wander_px: float = 0.5
    """Movement of the image from one station of the rail to the next."""


@dataclass(frozen=True, slots=True)
class TrueGrid:
    """The grid of equal targets on the panel, (rows, columns) and the distance of their centres; one by default."""

    shape: tuple[int, int] = (1, 1)
    pitch_mm: float = 1.0

    def centre_mm(self, tile: tuple[int, int]) -> tuple[float, float]:
        """Return the centre of a tile on the panel, right and down."""
        down, right = (
            (at - (count - 1) / 2) * self.pitch_mm
            for at, count in zip(tile, self.shape, strict=True)
        )
        return right, down

    def nearest(self, right_mm: Floats, down_mm: Floats) -> NDArray[np.int16]:
        """Return the number, row by row, of the tile nearest to each place of the panel."""
        row, col = (
            np.clip(np.floor(at / self.pitch_mm + count / 2), 0, count - 1)
            for at, count in zip((down_mm, right_mm), self.shape, strict=True)
        )
        return np.asarray(row * self.shape[1] + col, dtype=np.int16)


@dataclass(frozen=True, slots=True)
class TrueRoom:
    """A room around the panel, for a sensor much larger than the target.

    light: relative to an ordinary bright room; target_px: place of the panel's centre, down
    and right of the frame's; fine_px: rows and columns around it rendered finely,
    even numbers; bezel_mm: height and width of the panel with its black bezel, which holds
    what these pixels see.
    """

    light: float
    target_px: tuple[float, float]
    fine_px: tuple[int, int]
    bezel_mm: tuple[float, float]


@dataclass(frozen=True, slots=True)
class BenchSettings:
    """All chosen settings of the simulated world; the seed draws the rest."""

    seed: int = 1
    lens: TrueLens = TrueLens()
    sensor: TrueSensor = TrueSensor()
    panel: TruePanel = TruePanel()
    rail: TrueRail = TrueRail()
    pose: TruePose = TruePose()
    halo_um: float = 400.0
    """Least radius up to which diffraction is followed ring by ring; beyond, the mean of rings is used."""
    samples_per_pixel: int = 10
    """Least number of samples; a fast lens gets as many as its diffraction needs."""
    grid: TrueGrid = field(default_factory=TrueGrid)
    patch_px: float = 0.0
    """Side of a patch over which PSFs are interpolated; 0: one PSF for each tile of the grid."""
    room: TrueRoom | None = None
    """Without a room the sensor sees the panel only."""

    def __post_init__(self) -> None:
        if self.patch_px and not self.patch_px >= LEAST_PATCH_PX:
            raise ValueError(
                f"PSFs are interpolated over {LEAST_PATCH_PX:g} pixels or more (0: one for each tile), not {self.patch_px:g}"
            )

    @property
    def varies(self) -> bool:
        """Return whether the PSF changes over the frame."""
        return self.lens.field_terms.varies or self.grid.shape != (1, 1)

    @property
    def fine(self) -> tuple[slice, slice]:
        """Rows and columns rendered finely: around the target in a room, else all."""
        shape = self.sensor.rows, self.sensor.cols
        if self.room is None:
            return slice(0, shape[0]), slice(0, shape[1])
        rows, cols = (
            _around(count / 2 + aside, part, count)
            for count, aside, part in zip(
                shape, self.room.target_px, self.room.fine_px, strict=True
            )
        )
        return rows, cols

    @property
    def fine_shape(self) -> tuple[int, int]:
        """Numbers of rows and columns rendered finely."""
        rows, cols = self.fine
        return rows.stop - rows.start, cols.stop - cols.start


def _around(middle: float, part: int, count: int) -> slice:
    """Return `part` of `count` pixels about a place, from an even one: the filter array's cell begins there."""
    first = 2 * round((middle - part / 2) / 2)
    first = min(max(first, 0), count - part)
    return slice(first, first + part)


FAULTS = {
    "camera": ("timeout", "unplug", "card_full"),
    "rail": ("stall", "limit", "lost_steps"),
    "display": ("sleep",),
}
"""Kinds of `Fault`, by device."""


@dataclass(frozen=True, slots=True)
class Fault:
    """Trouble on a device's call number `call` (from 1: exposures, moves, pictures shown), `times` calls in a
    row.

    camera: timeout, unplug (until identified again), card_full (for good); rail: stall,
    limit, lost_steps; display: sleep (until the next picture).
    """

    device: Literal["camera", "rail", "display"]
    kind: Literal["timeout", "unplug", "card_full", "stall", "limit", "lost_steps", "sleep"]
    call: int
    times: int = 1


@dataclass(frozen=True, slots=True)
class TrueTile:
    """The truth of one tile of the target's grid, (row, column), in one colour.

    centre_px: (row, column) of its centre in the frame; modes_waves: {Noll: waves RMS at
    450 nm} there, with defocus.
    """

    tile: tuple[int, int]
    channel: str
    centre_px: tuple[float, float]
    modes_waves: Mapping[int, float]


@dataclass(frozen=True, slots=True)
class Visit:
    """The truth of one station: requested range, true range, defocus in waves RMS per colour.

    range_mm: on the plan's scale; actual_range_mm: from the front principal plane;
    range_zero_mm: the true range less encoder and tape, the same until the rail is homed
    again. target_to_pixels: (3, 3) panel mm (x right, y down from the centre, 1) to pixels
    (column, row, 1), without lateral colour and distortion. tiles: where the PSF changes
    over the frame.
    """

    range_mm: float
    actual_range_mm: float
    range_zero_mm: float
    defocus_waves: Mapping[str, float]
    target_to_pixels: tuple[tuple[float, ...], ...]
    tiles: tuple[TrueTile, ...] = ()


@dataclass(frozen=True, slots=True)
class Truth:
    """True values for comparison with an estimate. Modes are {Noll: waves RMS at 450 nm} per colour.

    best_focus_mm: on the plan's scale, as measured by tape; range_zero_mm: the true range
    less the tape's. f_number: by clear area on the axis, and modes over this circle;
    outer_f_number: of the circle round the pupil; clear_share: share of this area that a
    cat's eye leaves. modes_waves: without those that change over the frame, whose numbers
    `field_terms` has by the names of `FieldTerms`.
    """

    seed: int
    best_focus_mm: Mapping[str, float]
    range_zero_mm: float
    focal_length_mm: float
    f_number: float
    pupil_magnification: float
    lateral_colour: Mapping[str, float]
    modes_waves: Mapping[str, Mapping[int, float]]
    counts_per_electron: float
    read_noise_counts: float
    visits: tuple[Visit, ...]
    pupil: Pupil = ROUND_PUPIL
    outer_f_number: float | None = None
    clear_share: float = 1.0
    reference_wavelength_nm: float = REFERENCE_NM
    field_terms: Mapping[str, Any] = field(default_factory=dict)

    def waves(self, range_mm: float, channel: str) -> dict[int, float]:
        """Return all modes of a visit in one colour, of the target's middle tile where the PSF changes over the frame."""
        (visit,) = (one for one in self.visits if one.range_mm == range_mm)
        tiles = [tile for tile in visit.tiles if tile.channel == channel]
        if tiles:
            return dict(tiles[len(tiles) // 2].modes_waves)
        return {4: visit.defocus_waves[channel], **self.modes_waves[channel]}

    def to_json(self) -> str:
        """Return the truth as JSON."""
        return json.dumps(asdict(self), indent=1)
