"""The camera measured by a session, for its other photographs: same-camera check and optics."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path

from labkit.errors import DataError, RawError, SessionError
from labkit.estimation.stated import optics_of
from labkit.imaging.optics import Optics
from labkit.imaging.parts import KNOWN, Part
from labkit.optics.rim import Place
from labkit.optics.spectrum import ONE_WAVELENGTH
from labkit.photographs.container import recognise
from labkit.plan import Plan
from labkit.results import Results, Wavefront
from labkit.session.session import Session
from labkit.uncertain import Uncertain

SAME_CAMERA = 0.02  # relative: numbers of two plans that differ by more are of two cameras


def check_same_camera(
    results: Results,
    plan: Plan,
    channels: Collection[str],
    camera: str = "",
    *,
    force: bool = False,
) -> list[str]:
    """Return the contradictions between a session's camera and a plan's photographs, in words.

    Lens, aperture, sensor, channels and camera body are compared. camera: body as the
    photographs state it, empty if they do not. Raises DataError with all contradictions and
    the remedy unless `force`.
    """
    wrong = [*_numbers(results.plan, plan), *_channels(results, plan, channels)]
    theirs = camera_of(results)
    if camera and theirs and camera != theirs:
        wrong.append(f"camera {camera}, the session's is {theirs}")
    if wrong and not force:
        raise DataError(
            f"the session's PSF is of another camera: {'; '.join(wrong)}; give a session of the same one, or --force"
        )
    return wrong


def _numbers(theirs: Plan, ours: Plan) -> list[str]:
    """Return the differences of lens and sensor."""
    pairs = {
        "lens.focal_length_mm": (ours.lens.focal_length_mm, theirs.lens.focal_length_mm),
        "lens.f_number": (ours.lens.f_number, theirs.lens.f_number),
        "sensor.pixel_pitch_um": (ours.sensor.pixel_pitch_um, theirs.sensor.pixel_pitch_um),
        "sensor.fill_factor": (ours.sensor.fill_factor, theirs.sensor.fill_factor),
    }
    return [
        f"{name} = {a:g}, the session's is {b:g}"
        for name, (a, b) in pairs.items()
        if abs(a / b - 1) > SAME_CAMERA
    ]


def _channels(results: Results, plan: Plan, channels: Collection[str]) -> list[str]:
    """Return the channels that the session lacks, or has at another wavelength."""
    wrong = []
    for name in channels:
        light = next(c.wavelength_nm for c in plan.channel if c.name == name)
        fitted = {w.wavelength_nm for w in results.of_channel(name)}
        if not fitted:
            wrong.append(f"channel {name}, the session has {', '.join(results.channels)}")
        elif all(abs(light / nm - 1) > SAME_CAMERA for nm in fitted):
            wrong.append(
                f"channel {name} at {light:g} nm, the session's is at {fitted.pop():g} nm"
            )
    return wrong


def camera_of(results: Results) -> str:
    """Return the body that the session's photographs name; empty if session or photographs are missing."""
    if results.folder is None:
        return ""
    try:
        frames = Session.open(Path(results.folder).parent.parent).frames
        return recognise(frames[0].path).camera if frames else ""
    except (SessionError, RawError, OSError):
        return ""


def optics_behind(results: Results, plan: Plan, wavefront: Wavefront) -> Optics:
    """Return the optics of a plan's photographs: a session's wavefront and camera, the plan's sensor."""
    place = _tile_place(results, wavefront)
    optics = optics_of(plan, wavefront.channel, place)
    found = _found(results.model_parts, place)
    given = {part.name: part for part in (*optics.given, *found)}
    return replace(
        optics,
        f_number=wavefront.f_number
        if math.isfinite(wavefront.f_number)
        else optics.f_number,
        reference_nm=wavefront.reference_wavelength_nm,
        noll=wavefront.noll,
        spectrum=wavefront.spectrum if optics.spectrum is None else optics.spectrum,
        parts=(),
        given=tuple(given.values()),
        panel=None,
    )


def _tile_place(results: Results, wavefront: Wavefront) -> Place | None:
    """Return the place of a wavefront's tile in the frame; None without tiles."""
    if results.field is None or wavefront.placement is None:
        return None
    y, x = results.field.frame.relative(wavefront.placement.centre_px)
    return float(y), float(x)


def _found(quantities: Mapping[str, Uncertain], place: Place | None) -> list[Part]:
    """Return the parts of the camera at a place of the frame from the quantities in results."""
    known = [part for part in KNOWN.values() if not part.per_channel]
    found = [part.from_quantities(quantities) for part in known]
    return [part.about(ONE_WAVELENGTH, place) for part in found if part is not None]
