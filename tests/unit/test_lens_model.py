"""The laws that a session's observations follow, against the printed ones, whose slopes are complex steps."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from labkit.estimation.candidate import Reading
from labkit.estimation.laws import (
    AXIAL_COLOUR,
    FOCAL_LENGTH,
    FOCUS,
    LATERAL_COLOUR,
    MAGNIFICATION,
    PIXEL_PITCH,
    RANGE_ZERO,
    WAVELENGTH,
    Laws,
)
from labkit.estimation.lens_model import LensModel
from labkit.key import Key
from labkit.types import Floats
from tests.lens_samples import COLOURS, laws, reading, stated

NOLL = (4, 6, 11)
TILES = ((0, 0), (0, 1), (1, 1))
STEPS_LABEL = {
    FOCUS: 0.5,
    AXIAL_COLOUR: 0.5,
    RANGE_ZERO: 0.5,
    FOCAL_LENGTH: 0.6,
    MAGNIFICATION: 0.1,
    WAVELENGTH: 1e-3,
}
"""How far a point is off in a parameter, in its unit; 0.01 in others."""


def sampled() -> LensModel:
    """Three ranges and colours, homed thrice."""
    homed = {480.0: (1, 1), 500.0: (1, 2), 530.0: (2, 3)}
    readings = [
        replace(reading(r, c), homings=homings)
        for r, homings in homed.items()
        for c in COLOURS
    ]
    return LensModel(tuple(readings), NOLL, (), stated(60.0, 4.0))


def tiled() -> LensModel:
    """Three tiles at three ranges and in three colours."""
    readings = [
        reading(r, c, tile)
        for r in (480.0, 500.0, 530.0)
        for c in COLOURS
        for tile in TILES
    ]
    return LensModel(tuple(readings), NOLL, (), stated(60.0, 4.0))


def true_values(model: LensModel, theta: Any, own: Any, k: int) -> Any:
    """(modes + 2,) that observation k should measure, by the printed laws; theta (columns,) and own real or complex."""
    here = model.readings[k]
    common_light = model.laws.mistaken == (WAVELENGTH, ())

    def at(kind: str, *name: str | float) -> Any:
        return theta[model.index(kind, *name)]

    channel = here.key.channel
    homed = [
        here.homings.count(h) / len(here.homings) * at("homing", h)
        for h in {*here.homings} - {1}
    ]
    range_mm = here.range_mm + at("tape") + at("steps", here.station) + sum(homed)
    colour = 0.0 if channel == "G" else at("axial colour", channel)
    reference = at("best focus") + at("tape")
    f, n, mp = at("focal length"), at("f-number"), np.exp(at("pupil magnification"))
    waves, cone, scale = laws(range_mm, reference + colour, reference, f, n, mp)
    scale = (
        scale
        + at("target size")
        + (0.0 if channel == "G" else at("lateral colour", channel))
    )
    upper = [at("common mode", j) + at("mode", channel, j) for j in NOLL[1:]]
    if len(own):
        # Noll 2 and 3 of the field are 2x and 2y
        colours = iter(own)
        for k, height in ((2, 2 * here.place[1]), (3, 2 * here.place[0])):
            waves, *upper = (
                mode + height * (at("mode over the field", k, j) + next(colours))
                for mode, j in zip([waves, *upper], NOLL, strict=True)
            )
            cone = cone + height * at("cone over the field", k)
            tilt = at("target's tilt over the field", here.station, k)
            scale = scale + height * (at("scale over the field", k) + tilt)
    wavelength = at("wavelength", channel) + (at("wavelength") if common_light else 0.0)
    modes = [mode * np.exp(-wavelength) for mode in (waves, *upper)]
    pitch = at("pixel pitch") if model.laws.mistaken == (PIXEL_PITCH, ()) else 0.0
    return np.array([*modes, cone + at("cone") + wavelength + pitch, scale + pitch])


def near_focus(model: LensModel) -> tuple[Floats, Floats]:
    """A point, (columns,) and (blocks, local columns), that is off in everything."""
    rng, blocks = np.random.default_rng(1), int(model.blocks.max()) + 1
    theta = np.array([505.0 if c.kind == FOCUS else c.value for c in model.columns])
    theta = theta + np.array(
        [STEPS_LABEL.get(c.kind, 1e-2) for c in model.columns]
    ) * rng.normal(size=len(theta))
    own = np.array(
        [STEPS_LABEL.get(c.kind, 1e-2) for c in model.local_columns]
    ) * rng.normal(size=(blocks, len(model.local_columns)))
    return theta, own


def mistaken(kind: str) -> LensModel:
    """As `sampled`, with a pixel pitch or wavelengths that are a mistake."""
    return replace(sampled(), laws=Laws(mistaken=(kind, ())))


@pytest.mark.parametrize(
    "model",
    [sampled(), tiled(), mistaken(PIXEL_PITCH), mistaken(WAVELENGTH)],
    ids=["frames", "tiles", "pitch", "light"],
)
def test_slopes_are_those_of_the_printed_laws(model: LensModel) -> None:
    theta, own = near_focus(model)
    slopes, own_slopes = map(model.seen, model.slopes(theta, own))
    predicted = model.predicted(theta, own)
    for k, group in enumerate(model.blocks[model.exposures]):
        np.testing.assert_allclose(
            predicted[k], true_values(model, theta, own[group], k), rtol=1e-12
        )
        steps = theta + 1e-30j * np.eye(len(theta))
        wanted = np.array(
            [true_values(model, step, own[group], k).imag / 1e-30 for step in steps]
        ).T
        # differences of fourth order over 1e-3 of an argument: errors by rounding of defocus, some 1e3 waves
        np.testing.assert_allclose(slopes[k], wanted, rtol=1e-9, atol=1e-10)
        steps = own[group] + 1e-30j * np.eye(own.shape[1])
        wanted = np.array(
            [true_values(model, theta, step, k).imag / 1e-30 for step in steps]
        ).T
        np.testing.assert_allclose(
            own_slopes[k], wanted.reshape(own_slopes[k].shape), rtol=1e-9, atol=1e-10
        )


def test_light_as_stated_has_no_slope_by_its_wavelength() -> None:
    model = sampled()
    theta, own = near_focus(model)
    theta[[model.index(WAVELENGTH, c) for c in COLOURS]] = 0.0
    np.testing.assert_array_equal(model.predicted(theta, own), model.true(theta, own))
    slopes = model.slopes(theta, own)[0]
    at = [model.index(WAVELENGTH, r.key.channel) for r in model.readings]
    assert np.all(slopes[np.arange(9), 0, at] != 0)
    others = slopes.copy()
    others[np.arange(9), :, at] = 0.0
    np.testing.assert_array_equal(model.true_slopes(slopes), others)


def test_a_key_that_is_there_twice_is_named() -> None:
    readings = (reading(2000.0, "G"), reading(2100.0, "G"), reading(2000.0, "G"))
    with pytest.raises(ValueError, match=r"^2000_G: observed twice; give each key once$"):
        LensModel(readings, NOLL, (), stated(60.0, 4.0))


def test_the_first_channel_is_the_reference_where_none_is_green() -> None:
    readings = tuple(reading(r, c) for r in (2000.0, 2100.0) for c in "BR")
    model = LensModel(readings, NOLL, (), stated(60.0, 4.0))
    assert model.reference == "B"
    model.index(LATERAL_COLOUR, "R")
    with pytest.raises(KeyError):
        model.index(LATERAL_COLOUR, "B")


def test_photographs_before_and_after_a_homing_share_its_error() -> None:
    readings = (
        Reading(Key(2000.0, "G"), 2000.0, 2000.0, (0, 0)),
        Reading(Key(2100.0, "G"), 2100.0, 2100.0, (0, 1, 1, 1)),
    )
    model = LensModel(readings, (4,), (), stated(60.0, 4.0, homing_std_mm=0.1))
    theta = np.array([2050.0 if c.kind == FOCUS else c.value for c in model.columns])
    slopes = model.slopes(theta, np.zeros((1, 0)))[0]
    homing, station = model.index("homing", 1), model.index("steps", 2100.0)
    assert slopes[0, 0, homing] == 0
    assert slopes[1, 0, homing] == pytest.approx(0.75 * slopes[1, 0, station])


def test_rough_laws_add_their_errors_in_squares() -> None:
    rough = Laws(mode_scatter=0.004, f_number_scatter=0.004).rough()
    assert rough.mode_scatter == pytest.approx(0.005)
    assert rough.f_number_scatter == pytest.approx(0.005)
    assert not rough.shared
    assert rough.paraxial
