"""The room around the simulated panel, as the camera sees it: coarse and out of focus, but for the panel's bezel.

The room stays where it is in the frame; the panel moves on the rail. The room sends no
light into the pixels rendered finely: diffraction brings less than 1e-4 of it over
a bezel of 300 µm on the sensor.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from labkit.drivers.simulated.field import um_per_wave
from labkit.drivers.simulated.furniture import Canvas, background, foreground
from labkit.drivers.simulated.optics import REFERENCE_NM
from labkit.drivers.simulated.scene import Glass
from labkit.drivers.simulated.view import View, cone
from labkit.drivers.simulated.world import BenchSettings, TrueRoom
from labkit.types import Floats32

ROOM_CELL_PX = 4
"""Side of a place of the room's picture, in pixels of the sensor."""

BACKGROUND_RANGE, FOREGROUND_RANGE = 1.3, 1.04
"""Distances of both layers, relative to best focus."""

SHARPEST_EDGE_PX = 1.5
STAND_MM = 30.0
STAND_LIGHT = 0.06


@dataclass(frozen=True, slots=True, eq=False)
class Room:
    """The room of a bench, drawn at birth.

    picture: light of red, green and blue, (3, rows / ROOM_CELL_PX, columns / ROOM_CELL_PX), relative
    to the panel's white.
    """

    room: TrueRoom
    picture: Floats32

    def light(self, view: View, glass: Glass, rows: slice) -> Floats32:
        """Return the light on some rows of the frame, from an even row on, in each pixel's own colour."""
        seen = self._around(view.settings, rows)
        self._put_panel(seen, view, glass, rows)
        return seen

    def _around(self, settings: BenchSettings, rows: slice) -> Floats32:
        sensor = settings.sensor
        seen = np.empty((rows.stop - rows.start, sensor.cols), dtype=np.float32)
        if sensor.pattern == "mono":
            seen[:] = _enlarged(self.picture.mean(axis=0), (rows.start, 0), 1, seen.shape)
            return seen
        for number, colour in enumerate(sensor.pattern):
            down, right = divmod(number, 2)
            plane = seen[down::2, right::2]
            first = rows.start + down, right
            plane[:] = _enlarged(self.picture["RGB".index(colour)], first, 2, plane.shape)
        return seen

    def _put_panel(self, seen: Floats32, view: View, glass: Glass, rows: slice) -> None:
        """Lay the panel with bezel and stand over the room, in place."""
        high_mm, wide_mm = self.room.bezel_mm
        edge_px = max(SHARPEST_EDGE_PX, blur_px(view))
        columns = self._columns(view, edge_px)
        x = np.arange(columns.start, columns.stop, dtype=np.float64)[None, :]
        y = np.arange(rows.start, rows.stop, dtype=np.float64)[:, None]
        right, down = (mm.astype(np.float32) for mm in view.on_panel(x, y))
        edge_mm = np.float32(edge_px * mm_per_px(view))

        def inside(high: float, wide: float, middle: float = 0.0) -> Floats32:
            """Return the share of a rectangle in each pixel, with blurred edges."""
            apart = np.minimum(high / 2 - abs(down - middle), wide / 2 - abs(right))
            return np.asarray(np.clip(apart / edge_mm + 0.5, 0, 1), dtype=np.float32)

        part = seen[:, columns]
        stand = inside(10 * high_mm, STAND_MM, 5 * high_mm)
        part += stand * (np.float32(STAND_LIGHT * self.room.light) - part)
        part *= 1 - inside(high_mm, wide_mm)
        shown = [count * glass.pitch_mm for count in glass.codes.shape]
        share = inside(shown[0], shown[1])
        if share.any():
            part += share * _radiance_at(glass, right, down, mm_per_px(view))

    def _columns(self, view: View, edge_px: float) -> slice:
        """Return the columns of the frame that the bezel covers, blurred edges included."""
        high, wide = (side / 2 for side in self.room.bezel_mm)
        corners = [(x, y) for x in (-wide, wide) for y in (-high, high)]
        at = [view.place(x, y)[1] for x, y in corners]
        first = max(int(min(at) - edge_px), 0)
        return slice(
            first, max(min(int(max(at) + edge_px) + 2, view.settings.sensor.cols), first)
        )


def drawn_room(settings: BenchSettings, rng: np.random.Generator) -> Room | None:
    """Return the room of a bench's settings, drawn by a generator; None without a room."""
    if settings.room is None:
        return None
    sensor = settings.sensor
    shape = -(-sensor.rows // ROOM_CELL_PX), -(-sensor.cols // ROOM_CELL_PX)
    behind = _blurred(background(shape, rng), defocus_px(settings, BACKGROUND_RANGE))
    near = _blurred(foreground(shape, rng), defocus_px(settings, FOREGROUND_RANGE))
    light = near.light + (1 - near.cover)[:, :, None] * behind.light
    picture = np.ascontiguousarray(light.transpose(2, 0, 1))
    return Room(settings.room, picture * np.float32(settings.room.light))


def defocus_px(settings: BenchSettings, relative_range: float) -> float:
    """Return the diameter of a point's image at a range relative to best focus, by geometry, pixels."""
    lens = settings.lens
    magnified = lens.focal_length_mm / (lens.focused_mm - lens.focal_length_mm)
    opening_mm = lens.focal_length_mm / lens.f_number
    blur_mm = opening_mm * magnified * abs(1 - 1 / relative_range)
    return blur_mm * 1e3 / settings.sensor.pitch_um


def blur_px(view: View) -> float:
    """Return the diameter of the image of a point of the panel, by geometry, pixels."""
    lens = view.settings.lens
    colour = "G" if "G" in lens.best_focus_mm else next(iter(lens.best_focus_mm))
    shift_um = view.defocus(colour) * um_per_wave(cone(lens), REFERENCE_NM)
    return abs(shift_um) / cone(lens) / view.settings.sensor.pitch_um


def mm_per_px(view: View) -> float:
    """Return the length on the panel that a pixel sees in the panel's middle."""
    row, col = view.place(0.0, 0.0)
    right, down = view.on_panel(np.array([col, col + 1]), np.array([row, row]))
    return float(np.hypot(*np.ptp([right, down], axis=1)))


def _blurred(canvas: Canvas, diameter_px: float) -> Canvas:
    """Return a layer through a disc of a diameter in pixels of the sensor, and at least a place of the canvas."""
    radius = max(diameter_px / ROOM_CELL_PX, 1.0) / 2
    around = np.arange(-(n := int(np.ceil(radius))), n + 1)
    disc = np.clip(radius + 0.5 - np.hypot(around[:, None], around), 0, 1)
    disc /= disc.sum()
    for name in ("light", "cover"):
        layer = getattr(canvas, name)
        setattr(
            canvas, name, cv2.filter2D(layer, -1, disc, borderType=cv2.BORDER_REPLICATE)
        )
    return canvas


def _enlarged(
    plane: Floats32, first: tuple[int, int], step: int, shape: tuple[int, ...]
) -> Floats32:
    """Return a plane of the room's picture at every `step`-th pixel of the sensor from `first` on, (rows, columns)."""
    scale = step / ROOM_CELL_PX
    onto = np.array(
        [
            [scale, 0, (first[1] + 0.5) / ROOM_CELL_PX - 0.5],
            [0, scale, (first[0] + 0.5) / ROOM_CELL_PX - 0.5],
        ]
    )
    return np.asarray(
        cv2.warpAffine(
            plane,
            onto,
            shape[::-1],
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_REPLICATE,
        ),
        dtype=np.float32,
    )


def _radiance_at(glass: Glass, right: Floats32, down: Floats32, px_mm: float) -> Floats32:
    """Return the panel's radiance at places in mm from its centre, averaged over about a pixel of the sensor."""
    rows, cols = glass.radiance.shape
    side = max(1, round(px_mm / glass.pitch_mm))
    even = cv2.blur(glass.radiance, (side, side), borderType=cv2.BORDER_REPLICATE)
    pitch = np.float32(glass.pitch_mm)
    return np.asarray(
        cv2.remap(
            even,
            right / pitch + np.float32(cols / 2 - 0.5),
            down / pitch + np.float32(rows / 2 - 0.5),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        ),
        dtype=np.float32,
    )
