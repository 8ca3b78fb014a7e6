"""Distortion, lateral colour and tilt of a session's results, and their numbers in the corners of the frame."""

from __future__ import annotations

from math import sqrt

import numpy as np

from labkit.field.geometry import FieldGeometry, fit_geometry
from labkit.field.limits import POINTS, Numbers
from labkit.field.places import field_points
from labkit.field.session_tilt import session_tilt
from labkit.field.target_tilt import SeparatedTilt
from labkit.field.tile_places import TileGrid, tile_places
from labkit.optics.field import FieldFrame
from labkit.plan import leading_channel
from labkit.results import Results
from labkit.types import Floats
from labkit.uncertain import Uncertain


def session_geometry(results: Results) -> FieldGeometry | None:
    """Return where the lens puts the tiles; None without a field, or for tiles that are no grid of equal targets."""
    target = results.plan.target
    places = tile_places(results)
    known = target.grid is not None and target.pitch_mm is not None
    if results.field is None or not known or not places:
        return None
    assert target.grid is not None
    assert target.pitch_mm is not None
    grid = TileGrid(target.grid, target.pitch_mm, (target.size_mm, target.size_mm))
    leading = leading_channel(results.channels)
    return fit_geometry(results.field.frame, grid, places, results.thin_lens, leading)


def camera_tilt(results: Results, geometry: FieldGeometry | None) -> SeparatedTilt | None:
    """Return the slope of focus that is the camera's, not the target's; None where the tiles' places do not show it."""
    if geometry is None or results.field is None:
        return None
    lens, stated = results.lens, results.plan.lens.stated_focal_length
    focal = stated if lens is None else lens.focal_length
    return session_tilt(
        results, results.field, geometry, results.thin_lens, focal.std / focal.value
    )


def corner_numbers(geometry: FieldGeometry) -> dict[str, Numbers]:
    """Return distortion, % of the image height, and lateral colour, um, in each corner, by the names of their limits."""
    frame = geometry.model.frame
    corners = {name: field_points(frame)[name] for name in POINTS["corner"]}
    return {
        "distortion_percent": _distortion(geometry, corners),
        "lateral_colour_um": _lateral(geometry, corners),
    }


def _distortion(geometry: FieldGeometry, corners: dict[str, Floats]) -> Numbers:
    frame = geometry.model.frame
    places = np.array(list(corners.values()))
    shift, covariance = geometry.distortion_px(places)
    outwards = frame.heights_mm(places) / frame.radius_mm
    factor = 100 / _radius_px(frame)
    return {
        name: Uncertain(factor * float(out @ moved), factor * sqrt(out @ of @ out), "%")
        for name, out, moved, of in zip(corners, outwards, shift, covariance, strict=True)
    }


def _lateral(geometry: FieldGeometry, corners: dict[str, Floats]) -> Numbers:
    """Return the distance of each channel's image from the reference's."""
    pitch_um = geometry.model.frame.pixel_pitch_um
    places = np.array(list(corners.values()))
    found = dict[str, Uncertain]()
    for channel in geometry.model.channels[1:]:
        shift, covariance = geometry.lateral_px(channel, places)
        for name, moved, of in zip(corners, shift, covariance, strict=True):
            length = float(np.hypot(*moved))
            along = moved / length if length else np.zeros(2)
            std = sqrt(along @ of @ along if length else np.linalg.eigvalsh(of)[-1])
            number = Uncertain(pitch_um * length, pitch_um * std, "µm")
            found[f"{name}, {channel}"] = number
    return found


def _radius_px(frame: FieldFrame) -> float:
    return 1e3 * frame.radius_mm / frame.pixel_pitch_um
