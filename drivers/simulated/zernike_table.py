"""A table of Zernike modes over field and wavelength, as a lens designer's program writes it."""

from __future__ import annotations

import csv
from cmath import exp
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import atan, degrees, pi
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from labkit.drivers.simulated.optics import REFERENCE_NM, noll_to_nm
from labkit.storage.reading import read_text, reason
from labkit.types import Floats

MOST_TABLE_BYTES = 2**22

LIKE_PLACE = 3
"""Modes from 4 on change the PSF: 1 is a constant, 2 and 3 move light, and places are those of chief rays."""

FEWEST_FIELDS = 4


@dataclass(frozen=True, eq=False)
class ZernikeTable:
    """Modes of a rotationally symmetric lens at field angles from 0, in some wavelengths.

    The field of the table points down: at a place straight below the axis the lens has the
    table's modes, elsewhere the same wavefront turned about the axis.

    Parameters
    ----------
    path : of the file
    wavelengths_nm : (wavelengths,), rising
    fields_deg : (fields,), rising from 0
    paths_nm : (wavelengths, fields, modes) RMS of the path, Noll's modes from 4 on
    """

    path: str
    wavelengths_nm: Floats
    fields_deg: Floats
    paths_nm: Floats

    @property
    def noll(self) -> range:
        """The table's modes."""
        return range(LIKE_PLACE + 1, LIKE_PLACE + 1 + self.paths_nm.shape[2])

    @cached_property
    def _spline(self) -> CubicSpline:
        """The modes over the field angle, also on the other side of the axis.

        There the wavefront is turned by half a turn, which changes the sign of modes of odd
        azimuthal order.
        """
        sign = np.array([(-1.0) ** noll_to_nm(j)[1] for j in self.noll])
        beyond = (self.paths_nm * sign)[:, :0:-1]
        angles = np.concatenate([-self.fields_deg[:0:-1], self.fields_deg])
        return CubicSpline(angles, np.concatenate([beyond, self.paths_nm], axis=1), axis=1)

    def waves(self, tangent: float, azimuth: float, nm: float) -> dict[int, float]:
        """Return the modes of a place, waves RMS at REFERENCE_NM.

        Defocus counts from the axis's, since best focus is that of the axis. Between
        wavelengths the path is linear, beyond the table's it is that of the nearest.

        Parameters
        ----------
        tangent : of the field angle
        azimuth : of the place about the axis, from right towards down, radians
        nm : wavelength

        Raises
        ------
        ValueError
            for an angle beyond the table's
        """
        angle = degrees(atan(tangent))
        if angle > self.fields_deg[-1]:
            raise ValueError(
                f"lens.table={self.path} ends at {self.fields_deg[-1]:g} degrees of field, "
                f"and the frame reaches {angle:.3g}: allowed is a smaller frame or a longer focal length"
            )
        paths = self._spline(angle)
        paths[:, 0] -= self._spline(0.0)[:, 0]
        here = [np.interp(nm, self.wavelengths_nm, column) for column in paths.T]
        modes = {
            j: float(path) / REFERENCE_NM for j, path in zip(self.noll, here, strict=True)
        }
        return turned(modes, azimuth - pi / 2)


def turned(waves: Mapping[int, float], angle: float) -> dict[int, float]:
    """Return the modes of a wavefront turned by an angle, radians, from right towards down."""
    of_order: dict[tuple[int, int], complex] = {}
    for j, amount in waves.items():
        n, m = noll_to_nm(j)
        part = amount * (1j if m < 0 else 1)
        of_order[n, abs(m)] = of_order.get((n, abs(m)), 0j) + part
    found = dict[int, float]()
    for (n, m), both in of_order.items():
        after = both * exp(1j * m * angle)
        for j in range(n * (n + 1) // 2 + 1, (n + 1) * (n + 2) // 2 + 1):
            signed = noll_to_nm(j)[1]
            if abs(signed) == m:
                found[j] = after.imag if signed < 0 else after.real
    return dict(sorted(found.items()))


@lru_cache(maxsize=8)
def read_table(path: str) -> ZernikeTable:
    """Return the table of a CSV file: wavelength_nm, field_deg, z1, z2 and so on, waves RMS of the wavelength itself.

    Raises ValueError for a file that cannot be read, or is no such table.
    """
    try:
        text = read_text(Path(path), MOST_TABLE_BYTES, follow_link=True)
        heading, *lines = csv.reader(text.splitlines())
        numbers = np.array(lines, dtype=np.float64)
    except (OSError, ValueError) as error:
        raise ValueError(f"lens.table={path} cannot be read: {reason(error)}") from error
    modes = [f"z{j}" for j in range(1, len(heading) - 1)]
    if heading != ["wavelength_nm", "field_deg", *modes] or len(modes) <= LIKE_PLACE:
        raise ValueError(
            f"lens.table={path}: allowed are the columns wavelength_nm, field_deg, z1, z2 and so on to z4 or more"
        )
    wavelengths = np.unique(numbers[:, 0])
    angles = np.unique(numbers[:, 1])
    ordered = numbers[np.lexsort((numbers[:, 1], numbers[:, 0]))]
    every = [(nm, angle) for nm in wavelengths for angle in angles]
    if not (
        np.all(np.isfinite(numbers))
        and np.array_equal(ordered[:, :2], every)
        and angles[0] == 0
        and angles.size >= FEWEST_FIELDS
        and wavelengths[0] > 0
    ):
        raise ValueError(
            f"lens.table={path}: allowed are finite numbers, and for each wavelength the same "
            f"{FEWEST_FIELDS} or more field angles from 0"
        )
    waves = ordered[:, 2 + LIKE_PLACE :].reshape(wavelengths.size, angles.size, -1)
    return ZernikeTable(path, wavelengths, angles, waves * wavelengths[:, None, None])
