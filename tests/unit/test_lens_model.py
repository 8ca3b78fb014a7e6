"""The laws that a session's observations follow, against the printed ones, whose slopes are complex steps, and a pinhole."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from labkit.estimation.candidate import Reading
from labkit.estimation.laws import (
    AXIAL_COLOUR,
    FIELD_TILT,
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
from labkit.estimation.tilted_target import foreshortenings
from labkit.key import Key
from labkit.optics.lens import ThinLens
from labkit.types import Floats
from tests.lens_samples import COLOURS, laws, measured, reading, stated

NOLL = (4, 6, 11)
TILES = ((0, 0), (0, 1), (1, 1))
STEPS_LABEL = {
    FOCUS: 0.5,
    AXIAL_COLOUR: 0.5,
    RANGE_ZERO: 0.5,
    FOCAL_LENGTH: 0.6,
    MAGNIFICATION: 0.1,
    WAVELENGTH: 1e-3,
    FIELD_TILT: 0.0,
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
        # near no tilt: the range is that of the tiles' middle
        middle = np.mean([one.place for one in model.readings], axis=0)
        for k, place, of in zip((3, 2), here.place, middle, strict=True):
            tilt = at("target's tilt over the field", here.station, k)
            scale = scale + tilt * (1.5 * place - of)
    wavelength = at("wavelength", channel) + at("wavelength")
    modes = [mode * np.exp(-wavelength) for mode in (waves, *upper)]
    pitch = at("pixel pitch")
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


def picture(turn: Floats, at_mm: Floats, away_mm: float, image_mm: float) -> Floats:
    """Points (n, 2) of a plane turned about its middle, as a pinhole shows them."""
    turned = at_mm @ turn[:, :2].T
    return np.asarray(image_mm * turned[:, :2] / (away_mm + turned[:, 2:]))


def turned_by(down_deg: float, right_deg: float) -> Floats:
    """The rotation (3, 3), down, right and away, of a target that is tilted."""
    (down, right), (c, s) = np.radians([down_deg, right_deg]), (np.cos, np.sin)
    about_right = [[c(down), 0, -s(down)], [0, 1, 0], [s(down), 0, c(down)]]
    about_down = [[1, 0, 0], [0, c(right), -s(right)], [0, s(right), c(right)]]
    return np.array(about_down) @ np.array(about_right)


@pytest.mark.parametrize("lean_deg", [(0.0, 0.0), (4.0, -2.0), (-3.0, 8.0)])
def test_sizes_of_a_leaning_grid_are_those_of_a_pinhole(
    lean_deg: tuple[float, float],
) -> None:
    lens, focus_mm, range_mm = ThinLens(60.0, 4.0, 1.3), 500.0, 510.0
    image_mm = float(lens.pupil_to_image_mm(focus_mm)) / lens.pupil_magnification
    away_mm = range_mm - 60.0 + 60.0 / lens.pupil_magnification
    turn, tiles = turned_by(*lean_deg), [*np.ndindex(4, 6)]
    at_mm = 20.0 * (np.array(tiles) - [1.5, 2.5])
    seen = [
        picture(turn, at_mm + move, away_mm, image_mm)
        for move in 1e-3 * np.array([[0, 0], [-1, 0], [1, 0], [0, -1], [0, 1]])
    ]
    linear = np.stack([seen[2] - seen[1], seen[4] - seen[3]], axis=-1) / 2e-3
    sizes = np.log(np.linalg.det(linear)) / 2
    radius_mm = 8.0
    readings = [
        replace(reading(range_mm, "G", tile), place=tuple(at))
        for tile, at in zip(tiles, seen[0] / radius_mm, strict=True)
    ]
    model = LensModel(tuple(readings), NOLL, (), stated(60.0, 4.0))
    theta = model.centre.copy()
    theta[model.index(FOCUS)] = focus_mm
    theta[model.index(MAGNIFICATION)] = np.log(lens.pupil_magnification)
    nearer = turn[:2, 2] / turn[2, 2] * radius_mm / image_mm
    for k, tilt in zip((3, 2), nearer, strict=True):
        theta[model.index(FIELD_TILT, range_mm, k)] = tilt
    predicted = model.predicted(theta, np.zeros((1, 0)))[:, -1]
    cosine = turn[2, 2]
    # measured 1e-9 and 4e-8
    assert predicted == pytest.approx(sizes - np.log(cosine) / 2, abs=7e-8)
    axes, lengths, _ = np.linalg.svd(linear)
    longer = np.log(lengths[:, 0] / lengths[:, 1]) / 2
    twice = 2 * np.arctan2(axes[:, 0, 0], axes[:, 1, 0])
    stretches = longer[:, None] * np.stack([np.cos(twice), np.sin(twice)], axis=1)
    shapes = [
        replace(measured(np.zeros(3)), stretch=(float(a), float(b))) for a, b in stretches
    ]
    every = np.ones(len(tiles), bool)
    found = foreshortenings(readings, shapes, every, tiled=True)[:, 0]
    # measured 4e-5 at 8.5 degrees: what is of second order over the frame
    assert found == pytest.approx(-np.log(cosine) / 2, abs=6e-5)


def test_light_and_a_pitch_as_stated_have_no_slopes_by_their_errors() -> None:
    model = sampled()
    theta, own = near_focus(model)
    pitch, light = model.index(PIXEL_PITCH), model.index(WAVELENGTH)
    of_colours = [model.index(WAVELENGTH, c) for c in COLOURS]
    theta[[pitch, light, *of_colours]] = 0.0
    np.testing.assert_array_equal(model.predicted(theta, own), model.true(theta, own))
    slopes = model.slopes(theta, own)[0]
    at = [model.index(WAVELENGTH, r.key.channel) for r in model.readings]
    assert np.all(slopes[np.arange(9), 0, at] != 0)
    others = slopes.copy()
    others[:, :, [pitch, light, *of_colours]] = 0.0
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
