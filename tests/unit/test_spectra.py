"""Spectra of named lights through named filters: the tables, and what a plan makes of them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from labkit.errors import PlanError
from labkit.estimation.stated import optics_of
from labkit.plan import Plan
from labkit.spectra import LIGHT_KINDS, TYPICAL, body_of, channel_light, tables
from tests.plans import PORTRAIT

BODY = "Nikon D700"


def plan(*channels: dict[str, Any], **sensor: Any) -> Plan:
    tables = {**PORTRAIT, "channel": list(channels)}
    return Plan.from_tables({**tables, "sensor": {**PORTRAIT["sensor"], **sensor}})


def refused(*channels: dict[str, Any], **sensor: Any) -> str:
    with pytest.raises(PlanError) as error:
        plan(*channels, **sensor)
    return str(error.value)


def test_incandescent_light_is_a_black_body_s() -> None:
    """By Planck's law, at the temperature that CIE 15 gives illuminant A on the scale of 1990."""
    nm, power = map(np.array, (tables().nm, tables().lights["CIE A"]))
    law = nm**-5.0 / np.expm1(1.4388e7 / (nm * 2855.54))
    # a unit of the last digit is 1/1000 of the largest value
    np.testing.assert_allclose(power / power.max(), law / law.max(), atol=1e-3)


def test_every_light_and_every_body_has_its_spectrum() -> None:
    assert {name for kind in LIGHT_KINDS.values() for name in kind} == set(tables().lights)
    for filters in tables().filters.values():
        curves = np.array(filters)
        red, green, blue = np.array(tables().nm)[curves.argmax(axis=1)]
        assert 440 <= blue <= 480 < 520 <= green <= 550 < 580 <= red <= 610
        steps = np.abs(np.diff(curves, axis=1)) / curves.max(axis=1, keepdims=True)
        assert steps.max() < 0.4  # a curve has no spike


@pytest.mark.parametrize(
    ("camera", "body"),
    [
        ("NIKON CORPORATION NIKON D700", "Nikon D700"),
        ("NIKON CORPORATION NIKON D70", "Nikon D70"),
        ("NIKON CORPORATION NIKON D70s", None),
        ("Canon Canon EOS 5D Mark II", "Canon EOS 5D Mark II"),
        ("Canon Canon EOS 5D", None),
        ("Canon EOS 400D DIGITAL", "Canon Digital Rebel XTi"),
        ("Canon Canon EOS DIGITAL REBEL XTi", "Canon Digital Rebel XTi"),
        ("SONY ILCE-7RM2", "Sony ILCE-7RM2"),
        ("SONY D700", None),
        ("", None),
    ],
)
def test_a_body_is_known_by_what_its_files_write(camera: str, body: str | None) -> None:
    assert body_of(camera) == body


def test_a_channel_s_light_is_the_light_times_the_filter() -> None:
    nm, filters = np.array(tables().nm), np.array(tables().filters[BODY])
    lights = [np.array(tables().lights[name]) for name in LIGHT_KINDS["halogen"]]
    products = [light * filters[1] / np.sum(light * filters[1]) for light in lights]
    means = [np.average(nm, weights=each) for each in products]
    light = channel_light("halogen", BODY, "G")
    mean = np.average(nm, weights=np.sum(products, axis=0))
    square = np.average((nm - mean) ** 2, weights=np.sum(products, axis=0))
    assert light.mean.value == pytest.approx(mean)
    assert light.width.value == pytest.approx(np.sqrt(square))
    # of two lights the standard deviation is half the root of their distance's square, and the tables err by 1 nm
    assert light.mean.std == pytest.approx(np.hypot(abs(means[0] - means[1]) / 2**0.5, 1))


def test_bodies_that_are_not_known_add_to_the_error() -> None:
    for colour in "RGB":
        known, typical = (channel_light("led", of, colour) for of in (BODY, TYPICAL))
        assert typical.mean.std > known.mean.std
        assert typical.width.std > known.width.std


def test_a_plan_that_names_its_light_needs_no_wavelength() -> None:
    named = plan({"name": "G", "light": "led"})
    light = channel_light("led", TYPICAL, "G")
    (channel,) = named.channel
    assert channel.wavelength_nm == pytest.approx(light.mean.value, abs=0.05)
    assert channel.stated_wavelength.std == pytest.approx(light.mean.std, rel=1e-3)
    assert Plan.parse(named.to_toml()) == named
    assert "wavelength_nm" not in named.to_toml()


def test_a_stated_wavelength_is_the_mean_of_the_named_light() -> None:
    stated = plan({"name": "G", "light": "led", "wavelength_nm": 530.0}, filters=BODY)
    light = stated.named_light("G")
    assert light is not None
    assert np.average(light.nm, weights=light.weights) == pytest.approx(530.0)
    assert light.width == channel_light("led", BODY, "G").width


def test_a_model_has_the_moments_of_the_named_light() -> None:
    named = plan({"name": "R", "light": "fluorescent"}, filters="NIKON D700")
    assert named.sensor.filters == BODY
    light = channel_light("fluorescent", BODY, "R")
    optics = optics_of(named, "R")
    assert optics.spectrum is not None
    nm = 1e3 * optics.wavelength_um
    assert nm * optics.spectrum.mean == pytest.approx(light.mean.value)
    assert nm * optics.spectrum.variance**0.5 == pytest.approx(light.width.value)


def test_photographs_may_contradict_a_named_light_and_no_stated_spectrum() -> None:
    optics = optics_of(plan({"name": "G", "light": "led"}), "G")
    assert "spectrum" in optics.lacking
    assert "spectrum" not in replace(optics, typical=False).lacking
    (part,) = optics.with_parts(["spectrum"]).parts
    assert part.light == optics.spectrum
    assert not part.one_sided


def test_a_light_or_body_that_is_not_known_lists_those_that_are() -> None:
    said = refused({"name": "G", "light": "candle"})
    assert said == (
        "channel \"G\".light = 'candle': allowed is one of led, led-panel, rgb-led, ccfl-panel, fluorescent, halogen, daylight"
    )
    said = refused({"name": "G", "light": "led"}, filters="Nikon D1")
    assert said.startswith("sensor.filters = 'Nikon D1': allowed is typical, or one of ")
    assert BODY in said


@pytest.mark.parametrize(
    ("channel", "words"),
    [
        ({"name": "G"}, 'channel "G".wavelength_nm is missing: needs a number, 100 to'),
        (
            {"name": "G", "light": "led", "wavelength_nm": 610},
            'light = "led" has its mean at 541.5 nm through such a filter, wavelength_nm is 610: allowed is within 5%',
        ),
        (
            {"name": "G", "light": "led", "width_nm": 20},
            "light stands beside width_nm: allowed is one of them",
        ),
        (
            {"name": "G", "light": "led", "spectrum": [[540, 1]]},
            "light stands beside spectrum: allowed is one of them",
        ),
        (
            {"name": "M", "light": "led"},
            "allowed is a light for channels R, G and B; give the spectrum of M",
        ),
    ],
)
def test_a_contradiction_is_one_line(channel: dict[str, Any], words: str) -> None:
    said = refused(channel)
    assert words in said
    assert "\n" not in said
