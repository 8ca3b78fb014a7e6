"""Draw what stands in an ordinary bright room, coarsely: wall, window, shelf, lamp, table, second screen, tripod.

Lengths are in heights of the frame, down and right of its upper left corner; light is red,
green and blue, relative to the white panel.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

Light = tuple[float, float, float]
Place = tuple[float, float]
"""Down and right."""

WALL: Light = (0.30, 0.28, 0.25)
SKY: Light = (2.4, 2.7, 3.2)
LEAVES: Light = (0.35, 0.55, 0.25)
WOOD: Light = (0.24, 0.15, 0.08)
SHADE: Light = (1.5, 1.2, 0.8)
BLACK_PLASTIC: Light = (0.012, 0.012, 0.013)
SHADE_DEPTHS = 0.06
"""Length over which the lamp lights the wall."""


class Canvas:
    """A layer of the room: its light, (rows, columns, 3), and where it covers what is behind, (rows, columns)."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self.light = np.zeros((*shape, 3), dtype=np.float32)
        self.cover = np.zeros(shape, dtype=np.float32)
        self.height = shape[0]
        self.width = shape[1] / shape[0]

    def polygon(self, corners: Sequence[Place], light: Light) -> None:
        """Fill a polygon."""
        points = np.array([(right, down) for down, right in corners]) * self.height
        for layer, value in ((self.light, light), (self.cover, 1.0)):
            cv2.fillPoly(layer, [np.rint(points).astype(np.int32)], value)

    def box(self, upper_left: Place, lower_right: Place, light: Light) -> None:
        """Fill an upright rectangle."""
        (top, left), (bottom, right) = upper_left, lower_right
        self.polygon([(top, left), (top, right), (bottom, right), (bottom, left)], light)

    def bar(self, start: Place, end: Place, thick: float, light: Light) -> None:
        """Fill a straight bar from place to place."""
        along = np.subtract(end, start)
        aside = thick / 2 * np.array([-along[1], along[0]]) / np.hypot(*along)
        sides = (start + aside, end + aside, end - aside, start - aside)
        self.polygon([(float(down), float(right)) for down, right in sides], light)

    def disc(self, centre: Place, radius: float, light: Light) -> None:
        """Fill a circle."""
        angle = np.linspace(0, 2 * np.pi, 40)
        around = zip(np.sin(angle), np.cos(angle), strict=True)
        self.polygon(
            [(centre[0] + radius * y, centre[1] + radius * x) for y, x in around], light
        )

    def shine(self, centre: Place, reach: Place, light: Light) -> None:
        """Add a soft spot of light, a Gaussian of sigmas `reach`, to whatever is there."""
        rows, cols = self.cover.shape
        down = (np.arange(rows) / self.height - centre[0]) / reach[0]
        right = (np.arange(cols) / self.height - centre[1]) / reach[1]
        spot = np.exp(-(down[:, None] ** 2 + right**2) / 2).astype(np.float32)
        self.light += (self.cover * spot)[:, :, None] * np.array(light, dtype=np.float32)


def background(shape: tuple[int, int], rng: np.random.Generator) -> Canvas:
    """Return the far wall with what stands before it."""
    canvas = Canvas(shape)
    canvas.box((0, 0), (1, canvas.width), WALL)
    uneven = rng.normal(1, 0.05, (5, 8)).astype(np.float32)
    canvas.light *= cv2.resize(uneven, shape[::-1], interpolation=cv2.INTER_CUBIC)[
        ..., None
    ]
    left, right = 0.04, canvas.width - 0.5
    window, shelf = (left, right) if rng.random() < 0.5 else (right, left)
    canvas.shine((0.3, window + 0.23), (0.5, 0.45), (0.25, 0.27, 0.3))
    _framed_picture(canvas, (0.06, canvas.width / 2 - 0.2 + rng.uniform(-0.1, 0.1)), rng)
    _window(canvas, window + rng.uniform(-0.05, 0.05), rng)
    _shelf(canvas, shelf, rng)
    return canvas


def foreground(shape: tuple[int, int], rng: np.random.Generator) -> Canvas:
    """Return what stands about as far away as the panel, on a table; nothing elsewhere."""
    canvas = Canvas(shape)
    edge = rng.uniform(0.84, 0.9)
    screen, lamp = (0.05, canvas.width - 0.22)
    if rng.random() < 0.5:
        screen, lamp = (canvas.width - 0.47, 0.2)
    _tripod(canvas, (edge + 0.02, canvas.width / 2 + rng.choice((-1, 1)) * 0.36))
    canvas.box((edge, 0), (1, canvas.width), (0.34, 0.24, 0.15))
    for down in edge + (1 - edge) * rng.uniform(0, 1, 12) ** 2:
        grain: Light = (0.29, 0.2, 0.12)
        canvas.bar((down, 0), (down + 0.01, canvas.width), 0.004, grain)
    # the window, and the screens, in the table's varnish
    canvas.shine((edge + 0.08, canvas.width / 2), (0.05, 0.12), (0.5, 0.52, 0.55))
    canvas.shine((edge + 0.03, screen + 0.2), (0.03, 0.1), (0.15, 0.2, 0.28))
    _second_screen(canvas, (edge - 0.3, screen), rng)
    _lamp(canvas, (edge, lamp))
    return canvas


def _window(canvas: Canvas, left: float, rng: np.random.Generator) -> None:
    """Draw a window with bars before sky and trees, much brighter than the panel's white."""
    top, bottom, wide = -0.05, 0.62, 0.46
    canvas.box((top, left), (bottom, left + wide), (0.6, 0.6, 0.58))
    canvas.box((top, left + 0.03), (bottom - 0.03, left + wide - 0.03), SKY)
    for _ in range(25):
        at = bottom - 0.06 - 0.12 * rng.random(), left + 0.08 + (wide - 0.16) * rng.random()
        leaf = rng.uniform(0.4, 1.4)
        canvas.disc(at, rng.uniform(0.02, 0.05), _dimmed(LEAVES, leaf))
    bar: Light = (0.5, 0.5, 0.48)
    canvas.box((top, left + wide / 2 - 0.012), (bottom, left + wide / 2 + 0.012), bar)
    canvas.box((0.24, left), (0.264, left + wide), bar)
    canvas.box(
        (bottom, left - 0.03), (bottom + 0.025, left + wide + 0.03), (0.7, 0.68, 0.64)
    )


def _shelf(canvas: Canvas, left: float, rng: np.random.Generator) -> None:
    """Draw three boards of books, some of which lean."""
    right = left + 0.46
    canvas.box((-0.05, left), (1, right), _dimmed(WOOD, 0.35))
    for board in (0.24, 0.55, 0.86):
        at = left + 0.02
        while at < right - 0.07:
            wide, high = rng.uniform(0.018, 0.055), rng.uniform(0.17, 0.26)
            light = _dimmed(_drawn_light(rng, 0.35, 1.0), rng.uniform(0.03, 0.5))
            lean = 0.05 if rng.random() < 0.06 else 0.0
            foot, head = at + lean, at
            canvas.bar(
                (board, foot + wide / 2), (board - high, head + wide / 2), wide, light
            )
            title: Light = (light[0] + 0.3, light[1] + 0.28, light[2] + 0.2)
            canvas.bar(
                (board - 0.75 * high, at + wide / 2 + 0.25 * lean),
                (board - 0.85 * high, at + wide / 2 + 0.15 * lean),
                0.6 * wide,
                title,
            )
            at += wide + lean + 0.002
        canvas.box((board, left), (board + 0.02, right), WOOD)
    for side in (left, right - 0.015):
        canvas.box((-0.05, side), (1, side + 0.015), WOOD)


def _framed_picture(canvas: Canvas, corner: Place, rng: np.random.Generator) -> None:
    """Draw a picture of squares behind glass that reflects the window."""
    top, left = corner
    canvas.box(corner, (top + 0.3, left + 0.4), (0.05, 0.04, 0.03))
    canvas.box((top + 0.015, left + 0.015), (top + 0.285, left + 0.385), (0.45, 0.44, 0.4))
    for row in range(3):
        for col in range(5):
            at = top + 0.045 + 0.07 * row, left + 0.045 + 0.062 * col
            light = _drawn_light(rng, 0.02, 0.5)
            canvas.box(at, (at[0] + 0.07, at[1] + 0.062), light)
    canvas.shine((top + 0.1, left + 0.1), (0.05, 0.03), (0.9, 0.95, 1.0))


def _second_screen(canvas: Canvas, corner: Place, rng: np.random.Generator) -> None:
    """Draw a monitor on its foot, with two windows of text."""
    top, left = corner
    high, wide = 0.25, 0.4
    canvas.box((top + high, left + 0.18), (top + high + 0.06, left + 0.22), BLACK_PLASTIC)
    canvas.box(
        (top + high + 0.05, left + 0.1), (top + high + 0.06, left + 0.3), BLACK_PLASTIC
    )
    canvas.box(corner, (top + high, left + wide), BLACK_PLASTIC)
    canvas.box(
        (top + 0.012, left + 0.012),
        (top + high - 0.018, left + wide - 0.012),
        (0.08, 0.16, 0.3),
    )
    for at in ((top + 0.03, left + 0.03), (top + 0.05, left + 0.2)):
        canvas.box(at, (at[0] + 0.16, at[1] + 0.16), (0.85, 0.85, 0.9))
        canvas.box(at, (at[0] + 0.014, at[1] + 0.16), (0.25, 0.27, 0.35))
        for line in range(8):
            down = at[0] + 0.026 + 0.016 * line
            end = at[1] + rng.uniform(0.06, 0.15)
            canvas.box((down, at[1] + 0.01), (down + 0.006, end), (0.12, 0.12, 0.14))


def _lamp(canvas: Canvas, foot: Place) -> None:
    """Draw a table lamp whose shade shines."""
    down, right = foot
    canvas.bar((down - 0.22, right), (down, right), 0.015, (0.4, 0.34, 0.2))
    canvas.disc((down, right), 0.04, (0.3, 0.26, 0.16))
    canvas.polygon(
        [
            (down - 0.36, right - 0.05),
            (down - 0.36, right + 0.05),
            (down - 0.2, right + 0.1),
            (down - 0.2, right - 0.1),
        ],
        SHADE,
    )
    canvas.shine((down - 0.25, right), (SHADE_DEPTHS, SHADE_DEPTHS), (1.2, 1.0, 0.7))


def _tripod(canvas: Canvas, head: Place) -> None:
    """Draw a tripod without a camera."""
    foot, right = head
    top = foot - 0.55
    for aside in (-0.14, 0.03, 0.15):
        canvas.bar(
            (top + 0.06, right), (foot + 0.2, right + aside), 0.016, (0.03, 0.03, 0.035)
        )
    canvas.bar((top, right), (foot - 0.2, right), 0.012, (0.2, 0.2, 0.21))
    canvas.box((top - 0.03, right - 0.03), (top + 0.02, right + 0.03), (0.04, 0.04, 0.045))


def _dimmed(light: Light, share: float) -> Light:
    red, green, blue = light
    return share * red, share * green, share * blue


def _drawn_light(rng: np.random.Generator, low: float, high: float) -> Light:
    """Return a random colour."""
    red, green, blue = map(float, rng.uniform(low, high, 3))
    return red, green, blue
