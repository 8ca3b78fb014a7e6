"""The target's pose: the homography from its plane to the sensor's pixels (thesis 2.8, Appendix C)."""

from dataclasses import dataclass, replace

import numpy as np

from labkit.arrays import real_array
from labkit.types import Floats

POSE_SIZE = 8
BEND_POWERS = 4  # of polynomials of the third degree
CORNER_Y = np.array([-1.0, -1, 1, 1])
CORNER_X = np.array([-1.0, 1, 1, -1])


@dataclass(frozen=True, slots=True)
class Pose:
    """Eight numbers v that map target coordinates to pixels.

    With (y, x) in units of half the sides of a rectangle on the target, from its centre, y down and x right,

        row = (v0 + v1 y + v2 x) / (1 + v6 y + v7 x),    col = (v3 + v4 y + v5 x) / (1 + v6 y + v7 x).

    v0..v5 are in pixels (pixel centres at integers), v6 and v7 unitless. The rectangle is the target, or the part of a
    large target fitted alone: numbers of a distant rectangle would be known together only.

    A lens that distorts bends the rectangle, which no homography does. The homography's place (y, x) then shows the target's

        (y, x) - sum_ij bend[:, i, j] y^i x^j.

    Methods are those of the homography alone; a drawing has the bend (`labkit.imaging.scene`).

    Attributes
    ----------
    v : (8,) numbers
    half_size_mm : half (height, width) of the rectangle
    centre_mm : (y, x) of its centre from the target's
    bend : (2, 4, 4) cubic polynomials of the lens's distortion over the rectangle; None for a lens that is not known to
        distort
    """

    v: Floats
    half_size_mm: tuple[float, float]
    centre_mm: tuple[float, float] = (0.0, 0.0)
    bend: Floats | None = None

    def __post_init__(self) -> None:
        if self.bend is not None:
            real_array("bend", self.bend, (2, BEND_POWERS, BEND_POWERS), "unitless")
        object.__setattr__(
            self,
            "v",
            real_array("v", self.v, (POSE_SIZE,), "pose: six in pixels, two unitless"),
        )

    @classmethod
    def from_corners(cls, corners_px: Floats, size_mm: tuple[float, float]) -> "Pose":
        """Return the pose of corners (4, 2) as (row, col), in the order of the target's own (0,0), (0,w),
        (h,w), (h,0).

        Raises ValueError for another shape and for three corners on a line.
        """
        row, col = real_array("corners_px", corners_px, (4, 2), "pixels").T
        one = np.ones(4)
        zero = np.zeros(4)
        row_equations = np.stack(
            [one, CORNER_Y, CORNER_X, zero, zero, zero, -row * CORNER_Y, -row * CORNER_X],
            axis=1,
        )
        col_equations = np.stack(
            [zero, zero, zero, one, CORNER_Y, CORNER_X, -col * CORNER_Y, -col * CORNER_X],
            axis=1,
        )
        try:
            v = np.linalg.solve(
                np.concatenate([row_equations, col_equations]), np.concatenate([row, col])
            )
        except np.linalg.LinAlgError as error:
            raise ValueError(
                f"corners_px, shape (4, 2): no three may lie on a line (pixels): {corners_px}"
            ) from error
        return cls(v, (size_mm[0] / 2, size_mm[1] / 2))

    @classmethod
    def from_matrix(
        cls,
        matrix: Floats,
        half_size_mm: tuple[float, float],
        centre_mm: tuple[float, float] = (0.0, 0.0),
    ) -> "Pose":
        """Return the pose of a homography (3, 3), of any scale, from (y, x, 1) to (row, col, 1)."""
        (v1, v2, v0), (v4, v5, v3), (v6, v7, _) = matrix / matrix[2, 2]
        return cls(np.array([v0, v1, v2, v3, v4, v5, v6, v7]), half_size_mm, centre_mm)

    def moved(self, step: Floats) -> "Pose":
        """Return the pose v + step."""
        return replace(self, v=self.v + step)

    def about(
        self, half_size_mm: tuple[float, float], centre_mm: tuple[float, float] = (0.0, 0.0)
    ) -> "Pose":
        """Return the same homography in the coordinates of another rectangle on the target, without a bend."""
        own, other = np.array(self.half_size_mm), np.array(half_size_mm)
        away = np.subtract(centre_mm, self.centre_mm) / own
        there = np.diag([*(other / own), 1.0])
        there[:2, 2] = away
        matrix = self.matrix @ there
        return Pose.from_matrix(matrix, half_size_mm, centre_mm)

    def shifted(self, rows: float, columns: float) -> "Pose":
        """Return the pose in pixel coordinates with their origin at (rows, columns)."""
        v = self.v.copy()
        v[[0, 1, 2]] -= rows * np.array([1, v[6], v[7]])
        v[[3, 4, 5]] -= columns * np.array([1, v[6], v[7]])
        return replace(self, v=v)

    def of_target(self, size_mm: tuple[float, float]) -> "Pose":
        """Return the same pose in the coordinates of the whole target, of (height, width)."""
        return self.about((size_mm[0] / 2, size_mm[1] / 2))

    @property
    def matrix(self) -> Floats:
        """(3, 3) homography from (y, x, 1) to (row, col, 1)."""
        v = self.v
        return np.array([[v[1], v[2], v[0]], [v[4], v[5], v[3]], [v[6], v[7], 1.0]])

    def corners_px(self) -> Floats:
        """Return (4, 2) corners of the rectangle as (row, col)."""
        return self.to_pixels(CORNER_Y, CORNER_X)

    def to_pixels(self, y: Floats, x: Floats) -> Floats:
        """Return the pixels (..., 2) of unit target coordinates (...)."""
        v = self.v
        w = 1 + v[6] * y + v[7] * x
        return np.stack(
            [(v[0] + v[1] * y + v[2] * x) / w, (v[3] + v[4] * y + v[5] * x) / w], axis=-1
        )

    def to_target(self, row: Floats, col: Floats) -> tuple[Floats, Floats]:
        """Return the unit target coordinates (y, x) of pixels; row and col broadcast together."""
        inverse = np.linalg.inv(self.matrix)
        y, x, w = (a * row + b * col + c for a, b, c in inverse)
        return y / w, x / w

    def pixel_per_unit(self) -> tuple[float, float]:
        """Return the pixels spanned by one unit of y and of x at the rectangle's centre."""
        v = self.v
        dy = np.hypot(v[1] - v[0] * v[6], v[4] - v[3] * v[6])
        dx = np.hypot(v[2] - v[0] * v[7], v[5] - v[3] * v[7])
        return float(dy), float(dx)

    def log_scale(self) -> tuple[float, Floats]:
        """Return ln of pixels per mm at the rectangle's centre, the geometric mean over directions, and its slopes
        (8,) by v.

        A target tilted by t has a smaller scale than an upright one, by t^2 / 4 and the
        result of `log_foreshortening`.
        """
        log_det = np.linalg.slogdet(self.matrix)[1]
        slopes = np.asarray(0.5 * np.linalg.inv(self.matrix).T, dtype=float)
        mean = 0.5 * (log_det - np.log(self.half_size_mm[0] * self.half_size_mm[1]))
        return float(mean), slopes[[0, 0, 0, 1, 1, 1, 2, 2], [2, 0, 1, 2, 0, 1, 0, 1]]

    def log_foreshortening(self) -> float:
        """Return ln of pixels per mm along the line of constant range through the rectangle's centre, less the
        mean of all directions.

        A tilt shortens the target only across this line, wherever the target is in the
        image. The line has (y, x) in the direction (v7, -v6); an upright target is not
        shortened.
        """
        return float(self.log_foreshortenings(np.zeros((1, POSE_SIZE)))[0])

    def log_foreshortenings(self, steps: Floats) -> Floats:
        """Return `log_foreshortening` of the poses v + step, for steps (n, 8)."""
        v = (self.v + steps).T
        tall, wide = self.half_size_mm
        y, x = v[7], -v[6]
        matrix = np.array([[v[1], v[2], v[0]], [v[4], v[5], v[3]], [v[6], v[7], 1 + 0 * y]])
        area = np.linalg.slogdet(np.moveaxis(matrix, 2, 0))[1] - np.log(tall * wide)
        length = np.hypot(tall * y, wide * x)
        seen = np.hypot(v[1] * y + v[2] * x, v[4] * y + v[5] * x)
        upright = length == 0
        along = np.log(np.where(upright, 1.0, seen) / np.where(upright, 1.0, length))
        return np.asarray(np.where(upright, 0.0, along - 0.5 * area))

    def log_stretch(self) -> tuple[float, float]:
        """Return a cos 2 phi and a sin 2 phi of the picture at the rectangle's centre, longest in the direction phi.

        a is half ln of its length over that across, phi from right (along the rows) towards down.
        """
        v, sides = self.v, self.half_size_mm
        along = [
            [v[1] - v[0] * v[6], v[2] - v[0] * v[7]],
            [v[4] - v[3] * v[6], v[5] - v[3] * v[7]],
        ] / np.array(sides)
        (down, mixed), (_, right) = along @ along.T
        away = np.array([right - down, 2 * mixed]) / (down + right)
        length = float(np.hypot(*away))
        a, b = away * (np.arctanh(length) / length if length else 1.0) / 2
        return float(a), float(b)

    def jacobian(self, row: Floats, col: Floats) -> tuple[Floats, Floats]:
        """Return derivatives (8, ...) of row and of col by v, for the target's points at these pixels."""
        y, x, one = (
            a * row + b * col + c for a, b, c in np.linalg.inv(self.matrix)
        )  # (y, x, 1) / (1 + v6 y + v7 x)
        zero = np.zeros_like(y)
        basis = np.stack([one, y, x])
        rows = np.concatenate([basis, [zero, zero, zero], -row * basis[1:]])
        cols = np.concatenate([[zero, zero, zero], basis, -col * basis[1:]])
        return rows, cols
