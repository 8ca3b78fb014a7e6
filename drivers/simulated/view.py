"""The view of the simulated camera from one station: places and wavefronts over its frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import hypot

import numpy as np

from labkit.drivers.simulated.field import MOST_DISTORTION, Distortion, Pair, um_per_wave
from labkit.drivers.simulated.modes import Modes
from labkit.drivers.simulated.optics import (
    REFERENCE_NM,
    defocus_waves,
    entrance_pupil_to_target_mm,
    farthest_ray_um,
    image_per_tangent_mm,
    working_f_number,
)
from labkit.drivers.simulated.pupil import Pupil
from labkit.drivers.simulated.scene import carry, project
from labkit.drivers.simulated.world import (
    BenchSettings,
    TrueLens,
    TrueTile,
)
from labkit.types import Floats

MOST_FIELD_WAVES = 3.0
"""Of a mode at the frame's rim: the light of a stronger wavefront leaves the samples around a pixel."""

RAY_REACH = 2.0
"""Radius up to which diffraction is followed, over the distance of the farthest ray. In sessions of 0.5 and 1 wave RMS in Noll
5 to 37 a larger radius changes a pixel by up to 0.05 of its noise RMS; radii of 0.8 to 1 ray, by 0.06 to 0.1, left modes up to
10 standard errors off."""


@dataclass(frozen=True, slots=True)
class Aim:
    """Errors of the camera's aim: tilts about right and down, roll, and the target's offset, (right, down) pixels."""

    tilt_deg: tuple[float, float]
    roll_deg: float
    offset_px: tuple[float, float]


@dataclass(frozen=True, slots=True)
class View:
    """The view from a true range. Places are (row, column), pixels; panel mm run right and down from its centre.

    modes: of the lens, without those that change over the frame; wander_px: movement of the
    image, down and right; shown_mm: place of the picture's centre, down and right of the
    panel's: half a panel pixel where one of them is odd.
    """

    settings: BenchSettings
    modes: Modes
    aim: Aim
    range_mm: float
    wander_px: tuple[float, float]
    shown_mm: Pair = (0.0, 0.0)

    @property
    def middle(self) -> Pair:
        """The frame's centre."""
        sensor = self.settings.sensor
        return (sensor.rows - 1) / 2, (sensor.cols - 1) / 2

    def lateral(self, colour: str) -> float:
        """Return the relative size of a colour's image."""
        return 1 + self.settings.lens.lateral_colour.get(colour, 0.0)

    def to_pixels(self, lateral: float = 1.0) -> Floats:
        """Return the (3, 3) map from panel mm to pixels, without distortion: perspective from the entrance
        pupil.
        """
        pitch_mm = self.settings.sensor.pitch_um * 1e-3
        tangent_px = lateral * per_tangent_mm(self.settings.lens) / pitch_mm
        row, col = (at + by for at, by in zip(self.middle, self.wander_px, strict=True))
        camera = np.array([[tangent_px, 0, col], [0, tangent_px, row], [0, 0, 1]])
        aside = self.away_mm * lateral / tangent_px
        offset = self.aim.offset_px
        shift = (offset[0] * aside, offset[1] * aside)
        return camera @ project(self.aim.tilt_deg, self.aim.roll_deg, shift, self.away_mm)

    @property
    def away_mm(self) -> float:
        """Distance of the panel's centre from the entrance pupil along the axis."""
        lens = self.settings.lens
        return entrance_pupil_to_target_mm(
            self.range_mm, lens.focal_length_mm, lens.pupil_magnification
        )

    @property
    def distortion(self) -> Distortion | None:
        """The lens's distortion; None without any."""
        field = self.settings.lens.field_terms
        if not field.k1_per_mm2:
            return None
        pitch_mm = self.settings.sensor.pitch_um * 1e-3
        down, right = (mm / pitch_mm for mm in field.distortion_centre_mm)
        centre = self.middle[1] + right, self.middle[0] + down
        return Distortion(field.k1_per_mm2 * pitch_mm**2, centre)

    def place(self, right_mm: float, down_mm: float, lateral: float = 1.0) -> Pair:
        """Return where a point of the panel is seen."""
        x, y = carry(self.to_pixels(lateral), np.array(right_mm), np.array(down_mm))
        if self.distortion:
            x, y = self.distortion.distorted(x, y)
        return float(y), float(x)

    def on_panel(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Return the points of the panel, right and down in mm, that pixels (x right, y down) see; broadcast."""
        if self.distortion:
            x, y = self.distortion.straight(x, y)
        back = np.asarray(np.linalg.inv(self.to_pixels()), dtype=np.float64)
        return carry(back, x, y)

    def defocus(self, colour: str, range_mm: float | None = None) -> float:
        """Return the defocus of a range, the panel's by default, on the axis."""
        lens = self.settings.lens
        return defocus_waves(
            self.range_mm if range_mm is None else range_mm,
            lens.best_focus_mm[colour],
            lens.focal_length_in(colour),
            lens.f_number_in(colour),
            lens.pupil_magnification,
            REFERENCE_NM,
        )

    def waves(self, colour: str, place: Pair | None = None) -> dict[int, float]:
        """Return all modes at a place; None: on the axis of a lens that is the same over its frame."""
        modes = {4: self.defocus(colour), **self.modes[colour]}
        if place is None:
            return modes
        lens = self.settings.lens
        modes[4] = self.defocus(colour, self._range_seen_mm(place))
        of_field = lens.field_terms.waves(
            self.place_mm(place),
            lens.wavelength_nm[colour],
            um_per_wave(cone(lens), REFERENCE_NM),
            per_tangent_mm(lens),
        )
        for j, amount in of_field.items():
            modes[j] = modes.get(j, 0.0) + amount
        return dict(sorted(modes.items()))

    def reach_um(self, halo_um: float | None = None) -> float:
        """Return the radius up to which diffraction is followed: `halo_um` (None: the settings'), or as far as rays need."""
        lens = self.settings.lens
        row, col = self.middle
        places: tuple[Pair | None, ...] = (None,)
        if self.settings.varies:
            places = tuple((i * row, j * col) for i in (0, 1, 2) for j in (0, 1, 2))
        farthest = max(
            farthest_ray_um(self.waves(colour, place), cone(lens), self.pupil(place).extent)
            for colour in lens.wavelength_nm
            for place in places
        )
        return max(halo_um or self.settings.halo_um, RAY_REACH * farthest)

    def pupil(self, place: Pair | None = None) -> Pupil:
        """Return the pupil at a place; None: on the axis."""
        lens = self.settings.lens
        return (
            lens.pupil
            if place is None
            else lens.field_terms.pupil(self.place_mm(place), lens.pupil)
        )

    def through(self, place: Pair | None) -> BenchSettings:
        """Return the settings with the lens's pupil at a place."""
        lens = replace(self.settings.lens, pupil=self.pupil(place))
        return replace(self.settings, lens=lens)

    def place_mm(self, place: Pair) -> Pair:
        """Return a place in mm from the frame's centre, down and right."""
        pitch_mm = self.settings.sensor.pitch_um * 1e-3
        row, col = self.middle
        return (place[0] - row) * pitch_mm, (place[1] - col) * pitch_mm

    def tile_place(self, tile: tuple[int, int], colour: str | None = None) -> Pair:
        """Return where the centre of a tile is seen, in one colour or without lateral colour."""
        lateral = 1.0 if colour is None else self.lateral(colour)
        right, down = self.settings.grid.centre_mm(tile)
        return self.place(right + self.shown_mm[1], down + self.shown_mm[0], lateral)

    def tiles(self) -> tuple[TrueTile, ...]:
        """Return the truth of each tile in each colour: its place and the modes there."""
        found = list[TrueTile]()
        for tile in np.ndindex(*self.settings.grid.shape):
            for colour in self.settings.lens.wavelength_nm:
                place = self.tile_place((tile[0], tile[1]), colour)
                waves = self.waves(colour, place)
                found.append(TrueTile((tile[0], tile[1]), colour, place, waves))
        return tuple(found)

    def _range_seen_mm(self, place: Pair) -> float:
        """Return the range of the point of the panel seen at a place: a tilted panel has many."""
        right, down = self.on_panel(np.array(place[1]), np.array(place[0]))
        depth_mm = self.to_pixels()[2] @ np.array([float(right), float(down), 1.0])
        return self.range_mm + float(depth_mm) - self.away_mm


def per_tangent_mm(lens: TrueLens) -> float:
    """Return the height of a chief ray of unit tangent on the sensor."""
    return image_per_tangent_mm(
        lens.focused_mm, lens.focal_length_mm, lens.pupil_magnification
    )


def cone(lens: TrueLens) -> float:
    """Return the f-number of the cone at the sensor, of green or of the first colour."""
    return working_f_number(
        lens.f_number, lens.focused_mm, lens.focal_length_mm, lens.pupil_magnification
    )


def refuse_wild(settings: BenchSettings) -> None:
    """Raise ValueError where the field's numbers are too large for the frame: at its corners or at its edges' middles."""
    field = settings.lens.field_terms
    if not field.varies and not field.k1_per_mm2:
        return
    view = View(settings, {}, Aim((0.0, 0.0), 0.0, (0.0, 0.0)), 1.0, (0.0, 0.0))
    row, col = view.middle
    for place in ((i * row, j * col) for i in (0, 1, 2) for j in (0, 1, 2)):
        at = view.place_mm(place)
        centre = field.distortion_centre_mm
        far = hypot(at[0] - centre[0], at[1] - centre[1])
        if abs(grown := field.k1_per_mm2 * far**2) > MOST_DISTORTION:
            raise ValueError(
                f"distortion moves places at the frame's rim by {100 * grown:.2g} % of their distance: "
                f"allowed is {100 * MOST_DISTORTION:g} % at most"
            )
        field.pupil(at, settings.lens.pupil)
        for nm in settings.lens.wavelength_nm.values():
            per_wave = um_per_wave(cone(settings.lens), REFERENCE_NM)
            waves = field.waves(at, nm, per_wave, per_tangent_mm(settings.lens))
            mode = max(waves, key=lambda j: abs(waves[j]))
            if abs(waves[mode]) > MOST_FIELD_WAVES:
                raise ValueError(
                    f"at the frame's rim the lens has {waves[mode]:.3g} waves RMS of Noll {mode}: "
                    f"allowed is {MOST_FIELD_WAVES:g} at most"
                )
