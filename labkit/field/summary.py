"""Gather all that a lens tester reads from a session's field: terms, curves, points, limits and tiles.

>>> summary = summarise_field(Results.load("night-3"))
>>> print(summary.terms["G"].tilt.over_frame)
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from labkit.errors import DataError
from labkit.field.curves import Band, Profile, profiles, usable_frequencies
from labkit.field.findings import geometry_findings, tilt_findings
from labkit.field.flats import session_illumination
from labkit.field.focus_curves import FocusCurve, through_focus
from labkit.field.geometry import FieldGeometry
from labkit.field.illumination import RelativeIllumination
from labkit.field.limits import Judged, judge_limits
from labkit.field.mount import ScrewMove, level
from labkit.field.places import azimuth_of, detail_deg, field_points
from labkit.field.session_geometry import (
    camera_tilt,
    corner_numbers,
    session_geometry,
)
from labkit.field.surfaces import Surface, focus_um
from labkit.field.symmetry import Share
from labkit.field.target_tilt import SeparatedTilt
from labkit.field.terms import LensTerms, lens_terms
from labkit.field.tiles import Tile, covered, sign_is_open, tiles_of
from labkit.field.turned import planned_screws
from labkit.jobs.threads import one_thread
from labkit.optics.field import FieldModel
from labkit.optics.mtf import Curve, mtf, mtf50
from labkit.plan import leading_channel
from labkit.results import Results
from labkit.types import Floats
from labkit.uncertain import Uncertain

NO_FIELD = (
    "these results have no field: photograph a grid of targets that fills the frame "
    "([target] grid and pitch_mm in the plan), then run labkit fit"
)

SIGN_OPEN_NOTE = (
    "these photographs leave a sign open: tilt, curvature, astigmatism and focus may all have the other sign, "
    "and no screw can be told to move; a second range tells"
)


LEAN_NOTE = (
    "the tilt is that of the sensor against the target: it holds the target's tilt, which a grid of targets at two ranges "
    "or more separates"
)


@dataclass(frozen=True, eq=False)
class FieldPoint:
    """MTF and focus of one direction of detail at a point of the frame.

    Parameters
    ----------
    place : name
    surface : sagittal or tangential
    mtf : at the usual frequencies
    mtf50 : cycles/mm
    focus_um : focus error of the sensor
    """

    place: str
    surface: Surface
    mtf: Curve
    mtf50: Uncertain
    focus_um: Uncertain


@dataclass(frozen=True, eq=False)
class FieldSummary:
    """A session's field.

    Parameters
    ----------
    model : the field
    channel : the one of points, curves and limits: green, or the first
    terms : of each channel
    points : of centre, edges and corners, sagittal and tangential
    limits : of the plan
    geometry : distortion and lateral colour; None for tiles that are no grid of equal targets
    camera_tilt : slope of focus without the target's tilt; None without a geometry, or without tiles for it
    illumination : light over the frame of each channel; empty without flats at hand
    screws : what to do at each screw of the plan's mount
    tiles : of the target
    covered : shares of the frame's height and width between the tiles' outermost edges
    sign_open : whether tilt, curvature, astigmatism and focus may all have the other sign,
        as from one range; screws are then left out
    notes : frequencies left out, an open sign, tiles out of place, a bent target,
        what is unknown of tilts
    """

    model: FieldModel
    channel: str
    terms: dict[str, LensTerms]
    frequency_per_mm: Floats
    points: tuple[FieldPoint, ...]
    limits: tuple[Judged, ...]
    geometry: FieldGeometry | None
    camera_tilt: SeparatedTilt | None
    illumination: dict[str, RelativeIllumination]
    screws: tuple[ScrewMove, ...]
    tiles: tuple[Tile, ...]
    covered: tuple[float, float]
    sign_open: bool
    notes: tuple[str, ...]

    @cached_property
    def profiles(self) -> tuple[Profile, ...]:
        """MTF and focus against image height along lines through the centre."""
        return profiles(self.model, self.channel, self.frequency_per_mm)

    @cached_property
    def through_focus(self) -> tuple[FocusCurve, ...]:
        """MTF against the sensor's position at all points."""
        return through_focus(self.model, self.channel, self.frequency_per_mm)

    def as_json(self) -> dict[str, Any]:
        """Return all numbers, with the curves."""
        return {
            "schema": 1,
            "channel": self.channel,
            "terms": {name: terms_as_json(one) for name, one in self.terms.items()},
            "points": [_point_as_json(point) for point in self.points],
            "profiles": [_profile_as_json(one) for one in self.profiles],
            "through_focus": [_focus_as_json(one) for one in self.through_focus],
            "limits": [one.as_json() for one in self.limits],
            "geometry": None if self.geometry is None else self.geometry.image.as_json(),
            "camera_tilt": None if self.camera_tilt is None else self.camera_tilt.as_json(),
            "illumination": {
                name: light.as_json() for name, light in self.illumination.items()
            },
            "screws": [one.as_json() for one in self.screws],
            "tiles": [one.as_json() for one in self.tiles],
            "covered": {"height": self.covered[0], "width": self.covered[1]},
            "sign_open": self.sign_open,
            "notes": list(self.notes),
        }


@one_thread
def summarise_field(results: Results, channel: str | None = None) -> FieldSummary:
    """Return what a lens tester reads from a session's field.

    channel : of points, curves and limits; by default green, or the first

    Raises
    ------
    DataError
        the results have no field, or no such channel

    >>> print(labkit.summarise_field(labkit.Results.load("night-3")).terms["G"].tilt.slope)
    """
    model = results.field
    if model is None:
        raise DataError(NO_FIELD)
    if channel is not None and channel not in model.channels:
        known = ", ".join(model.channels)
        raise DataError(f"the field has no channel {channel}: it has {known}")
    leading = leading_channel(model.channels) if channel is None else channel
    frequency, notes = usable_frequencies(model, leading)
    plan = results.plan
    terms = {name: lens_terms(model, name) for name in model.channels}
    geometry = session_geometry(results)
    others = {} if geometry is None else corner_numbers(geometry)
    tilt = camera_tilt(results, geometry)
    slope = terms[leading].tilt.slope if tilt is None else tilt.slope
    sign_open = sign_is_open(results)
    told = not sign_open and plan.mount.screws_mm is not None
    return FieldSummary(
        model,
        leading,
        terms,
        frequency,
        points_of(model, leading, frequency),
        judge_limits(plan.limits, model, leading, others),
        geometry,
        tilt,
        session_illumination(results),
        level(slope, planned_screws(plan)) if told else (),
        tiles_of(results, model),
        covered(results, model),
        sign_open,
        (
            *notes,
            *([SIGN_OPEN_NOTE] if sign_open else []),
            *([LEAN_NOTE] if tilt is None else []),
            *_geometry_notes(geometry, tilt),
        ),
    )


def _geometry_notes(
    geometry: FieldGeometry | None, tilt: SeparatedTilt | None
) -> tuple[str, ...]:
    """Return what the tiles' places say, in sentences."""
    of_places = () if geometry is None else geometry_findings(geometry)
    of_tilts = () if tilt is None else tilt_findings(tilt)
    return tuple(finding.text for finding in (*of_places, *of_tilts))


def points_of(
    model: FieldModel, channel: str, frequency_per_mm: Floats
) -> tuple[FieldPoint, ...]:
    """Return what is read at the frame's centre, edges and corners."""
    surfaces: tuple[Surface, ...] = ("sagittal", "tangential")
    found = []
    for name, place in field_points(model.frame).items():
        wavefront = model.wavefront(channel, place)
        for surface in surfaces:
            detail = detail_deg(azimuth_of(model.frame, place), surface)
            focus, std = focus_um(model, channel, place, surface)
            found.append(
                FieldPoint(
                    name,
                    surface,
                    mtf(wavefront, frequency_per_mm, detail),
                    mtf50(wavefront, detail),
                    Uncertain(float(focus), float(std), "um"),
                )
            )
    return tuple(found)


def terms_as_json(terms: LensTerms) -> dict[str, Any]:
    """Return the terms of a channel; units are in the names."""
    planes = terms.best_planes.items()
    return {
        "tilt_um_per_mm": terms.tilt.slope.as_json(),
        "tilt_arcmin": terms.tilt.angle.as_json(),
        "tilt_um": terms.tilt.over_frame.as_json(),
        "tilt_direction_deg": terms.tilt.direction_deg.as_json(),
        "tilt_across_um": _numbers(terms.tilt.across),
        "curvature_per_mm": terms.curvature.as_json(),
        "curvature_radius_mm": terms.curvature_radius_mm.as_json(),
        "sagittal_curvature_per_mm": terms.sagittal_curvature.as_json(),
        "tangential_curvature_per_mm": terms.tangential_curvature.as_json(),
        "astigmatism_per_mm": terms.astigmatism.as_json(),
        "level_at_mm": terms.level_at.as_json(),
        "linear_coma_waves_per_mm": terms.linear_coma.as_json(),
        "coma_waves": terms.coma.as_json(),
        "coma_free_at_mm": terms.coma_free_at.as_json(),
        "linear_astigmatism_waves_per_mm": terms.linear_astigmatism.as_json(),
        "constant_astigmatism_waves": terms.constant_astigmatism.as_json(),
        "spherical_waves": terms.spherical.as_json(),
        "best_plane_rms_um": _numbers({name: plane.rms for name, plane in planes}),
        "best_plane_peak_to_valley_um": _numbers(
            {name: plane.peak_to_valley for name, plane in planes}
        ),
        "misaligned_waves": _share(terms.misaligned),
        "rest_waves": _share(terms.rest),
    }


def _numbers(numbers: dict[Any, Uncertain]) -> dict[str, Any]:
    return {str(name): number.as_json() for name, number in numbers.items()}


def _share(share: Share) -> dict[str, Any]:
    p_value = share.p_value if np.isfinite(share.p_value) else None
    return {**share.rms.as_json(), "p_value": p_value}


def _band(band: Band | Curve) -> dict[str, Any]:
    return {"value": band.value.tolist(), "std": band.std.tolist()}


def _point_as_json(point: FieldPoint) -> dict[str, Any]:
    return {
        "place": point.place,
        "surface": point.surface,
        "frequency_per_mm": point.mtf.frequency_per_mm.tolist(),
        "mtf": _band(point.mtf),
        "mtf50_per_mm": point.mtf50.as_json(),
        "focus_um": point.focus_um.as_json(),
    }


def _profile_as_json(profile: Profile) -> dict[str, Any]:
    return {
        "azimuth_deg": profile.azimuth_deg,
        "surface": profile.surface,
        "frequency_per_mm": profile.frequency_per_mm.tolist(),
        "height_mm": profile.height_mm.tolist(),
        "mtf": _band(profile.mtf),
        "mtf50_per_mm": _band(profile.mtf50_per_mm),
        "focus_um": _band(profile.focus_um),
    }


def _focus_as_json(curve: FocusCurve) -> dict[str, Any]:
    return {
        "place": curve.place,
        "surface": curve.surface,
        "frequency_per_mm": curve.frequency_per_mm,
        "shift_um": curve.shift_um.tolist(),
        "mtf": _band(curve.mtf),
        "best_um": curve.best_um.as_json(),
    }
