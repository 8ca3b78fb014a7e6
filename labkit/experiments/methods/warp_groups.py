"""Perspective and its subgroups of fewer degrees of freedom, with first and second derivatives (thesis, Appendices C, D).

    dof  parameters x                            motion
    1    angle                                   rotation
    2    shifts                                  translation
    3    shifts, angle                           rotation and translation
    4    shifts, magnification, angle            the same, and one magnification
    5    shifts, two magnifications, angle       the same, and a magnification of each axis (not closed under composition)
    6    shifts, matrix column by column         affine
    8    the same, and two of perspective        any plane onto any other

Shifts are in samples, angles in radians from the first axis to the second. The two parameters of perspective are per
sample, all others without unit. Coordinates are (row, column).
"""

from dataclasses import dataclass

import numpy as np

from labkit.arrays import real_array
from labkit.experiments.methods.cubic import Cubic
from labkit.types import Floats

DEGREES = (1, 2, 3, 4, 5, 6, 8)

ROTATING: dict[int, tuple[int | None, ...]] = {
    1: (None, None, None, None, 0),
    2: (0, 1, None, None, None),
    3: (0, 1, None, None, 2),
    4: (0, 1, 2, 2, 3),
    5: (0, 1, 2, 3, 4),
}
"""By dof: the places in x of two shifts, two magnifications and the angle; None: fixed at its value in `AT_REST`."""

AT_REST = np.array([0.0, 0.0, 1.0, 1.0, 0.0])

TRANSFORMATION_ORDER = ((0, 2), (1, 2), (0, 0), (1, 0), (0, 1), (1, 1), (2, 0), (2, 1))
"""(row, column) in the matrix of each parameter of the groups that are linear in x."""

SINGULAR_MATRIX = 1e-12  # determinant over the cube of the largest entry; an inverse keeps four digits there


@dataclass(frozen=True, slots=True)
class WarpGroup:
    """The transformations of `dof` degrees of freedom.

    Raises
    ------
    ValueError
        for a `dof` that is not in `DEGREES`
    """

    dof: int

    def __post_init__(self) -> None:
        if self.dof not in DEGREES:
            raise ValueError(f"dof = {self.dof}: allowed is one of {DEGREES}")

    def identity(self) -> Floats:
        """Return the (dof,) parameters of the identity."""
        if self.dof not in ROTATING:
            return np.array([0.0, 0, 1, 0, 0, 1, 0, 0][: self.dof])
        parameters = np.zeros(self.dof)
        for place, value in zip(ROTATING[self.dof], AT_REST, strict=True):
            if place is not None:
                parameters[place] = value
        return parameters

    def matrix(self, x: Floats) -> Floats:
        """Return the (3, 3) homography of (row, column, 1) for parameters x (dof,).

        Raises
        ------
        ValueError
            for x of another shape, or not finite
        """
        return self._matrices(x)[0]

    def matrix_derivatives(self, x: Floats) -> tuple[Floats, Floats]:
        """Return first (dof, 3, 3) and second (dof, dof, 3, 3) derivatives of `matrix` by x."""
        return self._matrices(x)[1:]

    def to_object(
        self, x: Floats, where: Floats, centre: tuple[float, float] = (0.0, 0.0)
    ) -> Floats:
        """Return object coordinates of image points, by the inverse of the matrix.

        Parameters
        ----------
        x : (dof,)
        where : (2, ...), rows and columns, samples
        centre : the fixed point of rotations and magnifications, samples

        Returns
        -------
        (2, ...), samples

        Raises
        ------
        ValueError
            for other shapes, a singular matrix, and points on or beyond the horizon of a
            perspective

        Notes
        -----
        Thesis (D.3).
        """
        inverse = self._inverse(x, centre)
        return _projected(np.tensordot(inverse, _homogeneous(where), 1))

    def to_object_derivatives(
        self, x: Floats, where: Floats, centre: tuple[float, float] = (0.0, 0.0)
    ) -> tuple[Floats, Floats]:
        """Return first (dof, 2, ...) and second (dof, dof, 2, ...) derivatives of `to_object` by x. Thesis
        (D.7)-(D.15).
        """
        inverse = self._inverse(x, centre)
        points = _homogeneous(where)
        about = _about(centre)
        first, second = (
            np.linalg.inv(about) @ d @ about for d in self.matrix_derivatives(x)
        )
        once = first @ inverse  # dV/dx_i V^-1, in the centred frame
        twice = np.einsum("iab,jbc->ijac", once, once)
        by_x = -inverse @ once
        by_xx = inverse @ (twice + twice.swapaxes(0, 1) - second @ inverse)
        here = np.tensordot(inverse, points, 1)
        slopes = np.tensordot(by_x, points, 1)
        bends = np.tensordot(by_xx, points, 1)
        y = here[:2] / here[2]
        by_point = slopes[:, :2] / here[2]  # (dof, 2, ...)
        by_depth = slopes[:, None, 2] / here[2]  # (dof, 1, ...)
        gradient = by_point - y * by_depth
        hessian = bends[:, :, :2] / here[2] - y * (bends[:, :, None, 2] / here[2])
        hessian -= gradient[:, None] * by_depth[None] + gradient[None] * by_depth[:, None]
        return gradient, hessian

    def _inverse(self, x: Floats, centre: tuple[float, float]) -> Floats:
        """Return the (3, 3) matrix of (D.3): L^-1 V^-1 L, where L moves the centre to the origin."""
        matrix = self.matrix(x)
        about = _about(centre)
        if not abs(np.linalg.det(matrix)) > SINGULAR_MATRIX * np.abs(matrix).max() ** 3:
            raise ValueError(
                f"x = {np.asarray(x)} makes a singular matrix: the plane would lie edge on"
            )
        return np.asarray(np.linalg.inv(about) @ np.linalg.inv(matrix) @ about)

    def _matrices(self, x: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the matrix, its first and its second derivatives."""
        x = real_array("x", x, (self.dof,), "samples, radians and ratios")
        if self.dof in ROTATING:
            return self._rotating(x)
        matrix = np.diag([0.0, 0, 1])
        first = np.zeros((self.dof, 3, 3))
        for i, place in enumerate(TRANSFORMATION_ORDER[: self.dof]):
            matrix[place] = x[i]
            first[(i, *place)] = 1.0
        return matrix, first, np.zeros((self.dof, self.dof, 3, 3))

    def _rotating(self, x: Floats) -> tuple[Floats, Floats, Floats]:
        """Return rotation times magnifications: derivatives by shifts, magnifications and angle, then by x."""
        places = ROTATING[self.dof]
        choose = np.array(
            [[float(place == i) for i in range(self.dof)] for place in places]
        )  # d (five) / d x
        five = choose @ x + np.where(choose.any(axis=1), 0.0, AT_REST)
        c = np.cos(five[4])
        s = np.sin(five[4])
        turn = np.array([[c, -s], [s, c]])
        turned = np.array([[-s, -c], [c, -s]])  # its derivative
        size = np.diag(five[2:4])
        matrix = np.eye(3)
        matrix[:2, :2] = turn @ size
        matrix[:2, 2] = five[:2]
        first = np.zeros((5, 3, 3))
        second = np.zeros((5, 5, 3, 3))
        first[0, 0, 2] = first[1, 1, 2] = 1.0
        first[4, :2, :2] = turned @ size
        second[4, 4, :2, :2] = -turn @ size
        for k, unit in enumerate(np.eye(2)):
            first[2 + k, :2, :2] = turn @ np.diag(unit)
            second[2 + k, 4, :2, :2] = second[4, 2 + k, :2, :2] = turned @ np.diag(unit)
        return (
            matrix,
            np.einsum("pi,pab->iab", choose, first),
            np.einsum("pi,qj,pqab->ijab", choose, choose, second),
        )


def warp(image: Floats, group: WarpGroup, x: Floats, where: Floats) -> Floats:
    """Move an image by a transformation about its middle: Keys' cubic on a torus.

    Parameters
    ----------
    image : (rows, columns), radiance
    group, x : the transformation and its parameters (dof,)
    where : (2, ...), points of the moved image, samples

    Returns
    -------
    (...), radiance at the points

    Raises
    ------
    ValueError
        for other shapes

    Notes
    -----
    Thesis (D.2).
    """
    image = _image(image)
    at = group.to_object(x, where, _middle(image))
    return _cubic(image, at).apply(image).reshape(at.shape[1:])


def warp_derivatives(
    image: Floats, group: WarpGroup, x: Floats, where: Floats
) -> tuple[Floats, Floats]:
    """Return first (dof, ...) and second (dof, dof, ...) derivatives of `warp` by x. Thesis (D.9), (D.16).

    The cubic's second derivative jumps where a point passes a sample.
    """
    image = _image(image)
    at = group.to_object(x, where, _middle(image))
    by_x, by_xx = group.to_object_derivatives(x, where, _middle(image))
    cubic = _cubic(image, at)
    orders = ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
    r, c, rr, rc, cc = (
        cubic.apply(image, *order).reshape(at.shape[1:]) for order in orders
    )
    slope = np.stack([r, c])
    bend = np.stack([np.stack([rr, rc]), np.stack([rc, cc])])
    gradient = np.einsum("a...,ia...->i...", slope, by_x)
    hessian = np.einsum("a...,ija...->ij...", slope, by_xx)
    return gradient, hessian + np.einsum("ab...,ia...,jb...->ij...", bend, by_x, by_x)


def _image(image: Floats) -> Floats:
    return real_array("image", image, (None, None), "radiance")


def _middle(image: Floats) -> tuple[float, float]:
    return (image.shape[0] - 1) / 2, (image.shape[1] - 1) / 2


def _cubic(image: Floats, at: Floats) -> Cubic:
    return Cubic((image.shape[0], image.shape[1]), at[0].ravel(), at[1].ravel())


def _about(centre: tuple[float, float]) -> Floats:
    """Return the (3, 3) translation L of the centre to the origin."""
    return np.array([[1.0, 0, -centre[0]], [0, 1, -centre[1]], [0, 0, 1]])


def _homogeneous(where: Floats) -> Floats:
    """Return (3, ...) homogeneous coordinates of points (2, ...)."""
    where = real_array("where", where, (2, *[None] * (np.ndim(where) - 1)), "samples")
    return np.concatenate([where, np.ones((1, *where.shape[1:]))])


def _projected(points: Floats) -> Floats:
    """Return (2, ...) points of homogeneous coordinates (3, ...)."""
    # the third coordinate is one over that of the object's own point, which is positive on the visible side
    if beyond := np.count_nonzero(points[2] <= 0):
        raise ValueError(
            f"where: {beyond} of {points[2].size} points (samples) lie on or beyond the perspective's horizon"
        )
    return np.asarray(points[:2] / points[2])
