"""What is set on bodies of several makers, by the names and words that libgphoto2 has for them."""

from __future__ import annotations

from typing import Any

import pytest

from labkit.devices.protocols import ExposureSettings, Setting
from labkit.drivers.gphoto2.settings import (
    Body,
    Bulb,
    number_of,
    percent_of,
    seconds_of,
    wanted,
)
from labkit.errors import CameraError


def body(**settings: tuple[Any, ...]) -> Body:
    """name=(value now, *choices); "read only" as the last choice makes it so."""
    named = {
        key.replace("f_number", "f-number"): values for key, values in settings.items()
    }
    return {
        name: Setting(
            name,
            name,
            value,
            tuple(c for c in choices if c != "read only"),
            "read only" in choices,
        )
        for name, (value, *choices) in named.items()
    }


NIKON = body(
    expprogram=("M", "M", "P", "A", "S", "read only"),
    focusmode=("Manual", "Manual", "read only"),
    shutterspeed=("0.0166s", "0.0166s", "0.0200s", "30.0000s", "Bulb"),
    shutterspeed2=("1/60", "1/60", "1/50", "30", "Bulb"),
    iso=("200", "100", "200"),
    autoiso=("On", "On", "Off"),
    f_number=("f/4", "f/2.8", "f/4"),
    imagequality=("JPEG Fine", "JPEG Fine", "NEF (Raw)", "NEF+Fine"),
    capturetarget=("Memory card", "Internal RAM", "Memory card"),
    longexpnr=("On", "On", "Off"),
    bulb=(0, 0, 1),
)

CANON = body(
    autoexposuremode=("Manual", "Manual", "read only"),
    focusmode=("Manual", "read only"),
    shutterspeed=("1/60", "bulb", "30", "1/60", "1/50"),
    iso=("Auto", "Auto", "100", "200"),
    aperture=("4", "2.8", "4"),
    imageformat=("L", "L", "RAW + L", "RAW"),
    capturetarget=("Internal RAM", "Internal RAM", "Memory card"),
    autopoweroff=("60", "60", "0"),
    eosremoterelease=(
        "None",
        "None",
        "Press Half",
        "Press Full",
        "Release Full",
        "Immediate",
    ),
)

SONY = body(
    expprogram=("M", "M", "read only"),
    focusmode=("AF-S", "Manual", "AF-S"),
    shutterspeed=("1/60", "1/60", "1/50", "3/10", "30", "Bulb"),
    iso=("100", "100", "200"),
    f_number=("f/2.8", "f/2.8", "f/4"),
    imagequality=("RAW+JPEG", "RAW+JPEG", "Fine"),
    capturetarget=("card", "sdram", "card", "card+sdram"),
    imagestabilization=("On", "On", "Off"),
)

AT_20_MS = ExposureSettings(0.02, 100)


@pytest.mark.parametrize(
    ("camera", "changes", "files"),
    [
        (NIKON, {"shutterspeed2": "1/50", "iso": "100", "autoiso": "Off", "f-number": "f/2.8", "imagequality": "NEF (Raw)",
                 "capturetarget": "Internal RAM", "longexpnr": "Off"}, 1),
        (CANON, {"shutterspeed": "1/50", "iso": "100", "aperture": "2.8", "imageformat": "RAW", "autopoweroff": "0"}, 1),
        (SONY, {"shutterspeed": "1/50", "focusmode": "Manual", "imagestabilization": "Off", "capturetarget": "sdram"}, 2),
    ],
)  # fmt: skip
def test_a_body_is_set_by_its_own_names_and_words(
    camera: Body, changes: dict[str, str], files: int
) -> None:
    found = wanted(camera, AT_20_MS, 2.8)
    changed = {name: value for name, value in found.changes if camera[name].value != value}
    assert changed == changes
    assert (found.exposure_s, found.bulb, found.files) == (0.02, None, files)


def test_photographs_go_to_the_card_if_they_are_to_stay() -> None:
    for camera, name in ((NIKON, "Memory card"), (CANON, "Memory card"), (SONY, "card")):
        assert ("capturetarget", name) in wanted(camera, AT_20_MS, 2.8, "card").changes


@pytest.mark.parametrize(
    ("camera", "shutter", "bulb"),
    [
        (NIKON, ("shutterspeed2", "Bulb"), Bulb(("bulb", 1), ("bulb", 0))),
        (CANON, ("shutterspeed", "bulb"),
         Bulb(("eosremoterelease", "Immediate"), ("eosremoterelease", "Release Full"))),
    ],
)  # fmt: skip
def test_beyond_the_longest_time_the_shutter_is_held(
    camera: Body, shutter: tuple[str, str], bulb: Bulb
) -> None:
    found = wanted(camera, ExposureSettings(90.0, 100), 2.8)
    assert shutter in found.changes
    assert (found.exposure_s, found.bulb) == (90.0, bulb)


def test_everything_that_cannot_be_set_is_said_at_once() -> None:
    with pytest.raises(CameraError) as caught:
        wanted(
            {
                **NIKON,
                **body(
                    focusmode=("AF-S", "AF-S", "read only"), expprogram=("A", "read only")
                ),
            },
            ExposureSettings(0.03, 50),
            1.4,
        )
    for words in (
        "expprogram is A: set exposure mode M at the camera",
        "focusmode is AF-S: set manual focus",
        "exposure_s = 0.03: allowed are 0.01667, 0.02, 30, and anything longer",
        "ISO 50: allowed are 100, 200",
        "aperture f/1.4: allowed are 2.8, 4",
    ):
        assert words in str(caught.value)


@pytest.mark.parametrize(
    ("told_by", "focus", "changes"),
    [
        ("Manual", "MF (fixed)", {}),
        ("AF-S", "MF (fixed)", {}),
        ("AF-S", "AF-S", {"focusmode2": "MF (selection)"}),
        ("AF-S", "MF (selection)", {}),
    ],
)
def test_of_two_names_for_manual_focus_one_is_enough(
    told_by: str, focus: str, changes: dict[str, str]
) -> None:
    # as a D3300 lists them; "fixed" means the switch on its lens
    second = (focus, "AF-S", "AF-C", "AF-A", "MF (fixed)", "MF (selection)")
    camera = {
        **NIKON,
        **body(focusmode=(told_by, "Manual", "AF-S", "read only"), focusmode2=second),
    }
    found = wanted(camera, AT_20_MS, 2.8).changes
    changed = {
        name: value
        for name, value in found
        if name.startswith("focus") and camera[name].value != value
    }
    assert changed == changes


def test_what_a_body_does_not_tell_is_left_to_a_person() -> None:
    assert wanted(SONY, AT_20_MS, 2.8).by_hand == (
        "long exposure noise reduction off",
        "auto power-off off",
    )
    manual_lens = {**SONY, **body(f_number=("f/0", "read only"))}
    assert "aperture f/2.8" in wanted(manual_lens, AT_20_MS, 2.8).by_hand


@pytest.mark.parametrize(
    ("words", "seconds"),
    [("1/50", 0.02), ("0.0200s", 0.02), ("10/13", 10 / 13), ("1/1.3", 1 / 1.3), ("1.3", 1.3), ("30", 30.0), ("2''", 2.0),
     ("Bulb", None), ("bulb", None), ("x 200", None), ("1/0", None), ("", None)],
)  # fmt: skip
def test_shutter_times_are_read(words: str, seconds: float | None) -> None:
    assert seconds_of(words) == (seconds if seconds is None else pytest.approx(seconds))


@pytest.mark.parametrize(
    ("words", "number"),
    [
        ("f/2.8", 2.8),
        ("2.8", 2.8),
        ("F5.6", 5.6),
        ("100", 100.0),
        ("Auto", None),
        ("f/", None),
    ],
)
def test_apertures_and_sensitivities_are_read(words: str, number: float | None) -> None:
    assert number_of(words) == number


@pytest.mark.parametrize(
    ("words", "percent"), [("50%", 50.0), ("100 %", 100.0), ("Low", None), (None, None)]
)
def test_a_battery_is_read_where_it_has_numbers(
    words: str | None, percent: float | None
) -> None:
    assert percent_of(words) == percent
