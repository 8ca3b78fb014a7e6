"""Camera or lens: misalignment that turns with the lens is the lens's, the rest is the body's.

A misalignment of the first order is a vector on the sensor: the tilt of the focal surface,
constant coma, linear astigmatism (K. P. Thompson, J. Opt. Soc. Am. A 22, 1389 (2005)). With
the lens turned by an angle, clockwise as seen from behind the camera, which is from right
towards down in the photographs, the sensor shows

    body + R(angle) lens.

Two angles determine both parts. The errors are least where they differ by 180°.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan
from typing import Any

import numpy as np
from scipy.linalg import block_diag
from scipy.stats import chi2

from labkit.field.pair import Pair
from labkit.types import Floats

FULL_TURN_DEG = 360.0

SAME_ANGLE_DEG = 1.0
"""Largest difference of angles that count as one."""


@dataclass(frozen=True, eq=False)
class Split:
    """A misalignment in two parts.

    Parameters
    ----------
    body : part that stays as the lens turns
    lens : part that turns with the lens, as at angle 0
    covariance : (4, 4) of both, body first
    p_value : probability of sessions that contradict each other as much; nan for two sessions, which cannot
    """

    body: Pair
    lens: Pair
    covariance: Floats
    p_value: float

    def as_json(self) -> dict[str, Any]:
        """Return both parts with their joint covariance, and the probability that each is zero."""
        return {
            "body": self.body.as_json(),
            "lens": self.lens.as_json(),
            "covariance": self.covariance.tolist(),
            "p_no_body": self.body.p_value,
            "p_no_lens": self.lens.p_value,
            "p_value": None if np.isnan(self.p_value) else self.p_value,
        }


def split(measured: Sequence[Pair], turned_deg: Sequence[float]) -> Split:
    """Split a misalignment of several sessions into the body's and the lens's part.

    Parameters
    ----------
    measured : of each session, in one unit
    turned_deg : angle of the lens in each session

    Raises
    ------
    ValueError : angles of another number than sessions, or all the same
    """
    check_angles(len(measured), turned_deg)
    rows = np.concatenate([np.hstack([np.eye(2), turn(angle)]) for angle in turned_deg])
    values = np.concatenate([pair.value for pair in measured])
    weights = np.linalg.inv(block_diag(*[pair.covariance for pair in measured]))
    covariance = np.linalg.inv(rows.T @ weights @ rows)
    parts = covariance @ rows.T @ weights @ values
    left = values - rows @ parts
    spare = len(values) - len(parts)
    p_value = float(chi2.sf(left @ weights @ left, spare)) if spare else nan
    unit = measured[0].unit
    return Split(
        Pair(parts[:2], covariance[:2, :2], unit),
        Pair(parts[2:], covariance[2:, 2:], unit),
        covariance,
        p_value,
    )


def check_angles(sessions: int, turned_deg: Sequence[float]) -> None:
    """Raise ValueError for angles that split nothing."""
    shown = ", ".join(f"{angle:g}" for angle in turned_deg)
    if len(turned_deg) != sessions:
        raise ValueError(
            f"{len(turned_deg)} angles ({shown}) for {sessions} sessions: one for each is needed"
        )
    if not all(np.isfinite(angle) for angle in turned_deg):
        raise ValueError(f"turned by {shown}°: finite angles are needed")
    half = FULL_TURN_DEG / 2
    apart = [(a - turned_deg[0] + half) % FULL_TURN_DEG - half for a in turned_deg]
    if not max(apart, default=0.0) - min(apart, default=0.0) > SAME_ANGLE_DEG:
        raise ValueError(
            f"turned by {shown}°: two different angles are needed to tell the lens from the body, best 0 and 180"
        )


def turn(angle_deg: float) -> Floats:
    """Return the matrix (2, 2) that turns a vector (down, right) from right towards down."""
    angle = np.radians(angle_deg)
    return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
