"""Choose a body's settings for a measurement among those offered: names differ, values are words.

Nothing here talks to a camera. Names of settings are libgphoto2's (camlibs/ptp2/config.c).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Literal

from labkit.devices.protocols import ExposureSettings, Setting
from labkit.errors import CameraError

Body = Mapping[str, Setting]
Choice = str | int | float

SHUTTERS = ("shutterspeed2", "shutterspeed")
ISOS = ("iso",)
APERTURES = ("f-number", "aperture")
FORMAT_NAMES = ("imagequality", "imageformat")
STORAGE_NAMES = ("capturetarget",)

SAME_CHOICE = 0.02
"""Relative difference up to which a choice is the requested value: bodies round 1/60 s to 0.0167."""

BULB = re.compile(r"bulb", re.IGNORECASE)
RAW = re.compile(
    r"(?<![a-z])(raw|nef|nrw|cr2|cr3|arw|dng|orf|raf|rw2|pef|3fr)", re.IGNORECASE
)
LOSSY = re.compile(
    r"jpe?g|heif|fine|normal|basic|large|medium|small|superfine|\+", re.IGNORECASE
)


@dataclass(frozen=True, slots=True)
class Insist:
    """A setting that must have a value, under any of its names; a body without the setting gets the line
    `by_hand`.

    value: the whole of a right value, in any case of letters; switch: a right value that
    only a switch on the lens sets.
    """

    names: tuple[str, ...]
    value: str
    by_hand: str
    switch: str = ""


INSISTED = (
    Insist(
        ("expprogram", "autoexposuremode", "autoexposuremodedial"),
        r"m|manual.*|bulb",
        "exposure mode M",
    ),
    Insist(
        ("focusmode", "focusmode2"),
        r"m|mf.*|manual.*",
        "manual focus, at the lens or the body",
        "MF (fixed)",
    ),
    Insist(("autofocus",), r"off|0", ""),
    Insist(("imagestabilization",), r"off|0", "vibration reduction off"),
    Insist(("longexpnr",), r"off|0|no", "long exposure noise reduction off"),
    Insist(("autoiso", "isoauto"), r"off|0", ""),
    Insist(("bracketing", "aeb"), r"off|0", ""),
    Insist(("mirrorlock",), r"off|0|no", ""),
    Insist(("autopoweroff",), r"0|off|disabled?|never", "auto power-off off"),
)


@dataclass(frozen=True, slots=True)
class Bulb:
    """An exposure timed by the driver: the settings that press and release the shutter."""

    press: tuple[str, Choice]
    release: tuple[str, Choice]


@dataclass(frozen=True, slots=True)
class Wanted:
    """Settings for a body. exposure_s: of its shutter then; files: of an exposure, None = unknown."""

    changes: tuple[tuple[str, Choice], ...]
    exposure_s: float
    bulb: Bulb | None
    files: int | None
    by_hand: tuple[str, ...]


def wanted(
    body: Body,
    exposure: ExposureSettings,
    f_number: float | None,
    target: Literal["ram", "card"] = "ram",
) -> Wanted:
    """Return every relevant setting in this body's terms.

    Raises CameraError, one line with all impossible settings.
    """
    problems: list[str] = []
    by_hand: list[str] = []
    changes: list[tuple[str, Choice]] = []
    for insisted in INSISTED:
        _insist(body, insisted, changes, problems, by_hand)
    shutter = _shutter(body, exposure.exposure_s, problems, by_hand)
    bulb = _bulb(body, problems) if shutter and BULB.search(str(shutter[1])) else None
    image = _format(body, problems, by_hand)
    picked = [
        shutter,
        _number(body, ISOS, "ISO ", float(exposure.iso), problems, by_hand),
        f_number and _number(body, APERTURES, "aperture f/", f_number, problems, by_hand),
        image,
        _target(body, target),
    ]
    if problems:
        raise CameraError(
            "the camera cannot be set as the plan wants it: " + "; ".join(problems)
        )
    changes += [choice for choice in picked if choice]
    seconds = exposure.exposure_s if shutter is None or bulb else seconds_of(shutter[1])
    files = None if image is None else 2 if LOSSY.search(str(image[1])) else 1
    return Wanted(
        tuple(changes), seconds or exposure.exposure_s, bulb, files, tuple(by_hand)
    )


def seconds_of(value: Choice) -> float | None:
    """Parse a shutter time: "1/50", "0.0200s", "1.3", "2''", "30 s"; None for "Bulb" and the like."""
    return _fraction(
        re.fullmatch(r"([\d./]+)\s*(?:s|sec|\"|'')?", str(value).strip(), re.IGNORECASE)
    )


def number_of(value: Choice) -> float | None:
    """Parse an aperture or sensitivity: "f/2.8", "2.8", "ISO 100", "100"; None for "Auto" and the like."""
    return _fraction(
        re.fullmatch(r"(?:f/?|iso)?\s*([\d./]+)", str(value).strip(), re.IGNORECASE)
    )


def percent_of(value: Any) -> float | None:
    """Parse a battery's charge: "50%"; None for a body that uses words."""
    found = re.fullmatch(r"(\d+)\s*%", str(value).strip())
    return float(found[1]) if found else None


def _fraction(found: re.Match[str] | None) -> float | None:
    try:
        return float(Fraction(found[1])) if found else None
    except (ValueError, ZeroDivisionError):
        try:  # "10/1.3"
            over, under = str(found[1]).split("/") if found else ("", "")
            return float(over) / float(under)
        except (ValueError, ZeroDivisionError):
            return None


def _first(body: Body, names: Sequence[str]) -> Iterator[Setting]:
    return (body[name] for name in names if name in body)


def _insist(
    body: Body,
    insisted: Insist,
    changes: list[tuple[str, Choice]],
    problems: list[str],
    by_hand: list[str],
) -> None:
    def right(value: object) -> bool:
        return bool(re.fullmatch(insisted.value, str(value).strip(), re.IGNORECASE))

    here = list(_first(body, insisted.names))
    if not here and insisted.by_hand:
        by_hand.append(insisted.by_hand)
    settled = False
    for setting in here:
        choices = [
            choice
            for choice in setting.choices
            if right(choice) and choice != insisted.switch
        ]
        if right(setting.value):
            settled = True
            # it is set all the same where it can be: a body that turns it by itself is turned back
            changes += (
                [(setting.name, setting.value)] if setting.value in setting.choices else []
            )
        elif choices and not setting.readonly:
            settled = True
            changes.append((setting.name, choices[0]))
    if (
        here and not settled
    ):  # bodies with two names for one thing let only one be set, and may report rubbish by the other
        advice = insisted.by_hand or f"{here[0].label} off"
        problems.append(f"{here[0].name} is {here[0].value}: set {advice} at the camera")


def _shutter(
    body: Body, exposure_s: float, problems: list[str], by_hand: list[str]
) -> tuple[str, Choice] | None:
    times: dict[float, tuple[str, Choice]] = {}
    bulb: tuple[str, Choice] | None = None
    for setting in _first(body, SHUTTERS):
        for choice in setting.choices:
            seconds = seconds_of(choice)
            if (
                seconds and _nearest(times, seconds) is None
            ):  # two settings of one shutter round differently
                times[seconds] = (setting.name, choice)
            elif bulb is None and BULB.fullmatch(str(choice).strip()):
                bulb = (setting.name, choice)
    if near := _nearest(times, exposure_s):
        return near
    if bulb and exposure_s > max(times, default=0.0):
        return bulb
    if not times:
        by_hand.append(f"shutter time {exposure_s:g} s")
        return None
    problems.append(
        f"exposure_s = {exposure_s:g}: allowed are {_listed(times, exposure_s)}{_longer(bulb)}"
    )
    return None


def _longer(bulb: object) -> str:
    return ", and anything longer" if bulb else ""


def _number(
    body: Body,
    names: Sequence[str],
    what: str,
    asked: float,
    problems: list[str],
    by_hand: list[str],
) -> tuple[str, Choice] | None:
    for setting in _first(body, names):
        now = number_of(setting.value)
        if setting.readonly and now and abs(now / asked - 1) <= SAME_CHOICE:
            return None
        offered = {
            number: (setting.name, choice)
            for choice in setting.choices
            if (number := number_of(choice))
        }
        if setting.readonly or not offered:
            break
        if near := _nearest(offered, asked):
            return near
        problems.append(f"{what}{asked:g}: allowed are {_listed(offered, asked)}")
        return None
    by_hand.append(f"{what}{asked:g}")
    return None


def _nearest(
    offered: Mapping[float, tuple[str, Choice]], asked: float
) -> tuple[str, Choice] | None:
    near = min(offered, key=lambda value: abs(value / asked - 1), default=None)
    return (
        offered[near] if near is not None and abs(near / asked - 1) <= SAME_CHOICE else None
    )


def _listed(offered: Mapping[float, tuple[str, Choice]], asked: float) -> str:
    """Return the choices around the request, and the extremes."""
    values = sorted(offered)
    near = sorted(sorted(values, key=lambda value: abs(value - asked))[:4])
    shown = sorted({values[0], *near, values[-1]})
    return ", ".join(f"{value:.4g}" for value in shown)


def _bulb(body: Body, problems: list[str]) -> Bulb | None:
    if "eosremoterelease" in body:
        choices = [str(choice) for choice in body["eosremoterelease"].choices]
        press = next(
            (name for name in ("Immediate", "Press Full") if name in choices), None
        )
        release = next(
            (name for name in ("Release Full", "Release 1") if name in choices), None
        )
        if press and release:
            return Bulb(("eosremoterelease", press), ("eosremoterelease", release))
    if "bulb" in body:
        return Bulb(("bulb", 1), ("bulb", 0))
    problems.append(
        "exposure_s is longer than the body times by itself, and it offers no bulb release"
    )
    return None


def _format(
    body: Body, problems: list[str], by_hand: list[str]
) -> tuple[str, Choice] | None:
    """Return the choice of raw alone if there is one, else of raw with JPEG."""
    for setting in _first(body, FORMAT_NAMES):
        if not setting.choices:
            continue
        raw = [choice for choice in setting.choices if RAW.search(str(choice))]
        if not raw:
            problems.append(
                f"{setting.name}: offers no raw format, only {', '.join(map(str, setting.choices))}"
            )
            return None
        alone = [choice for choice in raw if not LOSSY.search(str(choice))]
        best = alone or raw
        chosen = setting.value if setting.value in best else best[0]
        if setting.readonly and setting.value != chosen:
            problems.append(
                f"{setting.name} is {setting.value}: set it to {chosen} at the camera"
            )
        return None if setting.readonly else (setting.name, chosen)
    by_hand.append("image quality raw")
    return None


def _target(body: Body, target: Literal["ram", "card"]) -> tuple[str, Choice] | None:
    for setting in _first(body, STORAGE_NAMES):
        for choice in setting.choices:
            if re.search(
                r"^(?!.*card).*ram" if target == "ram" else r"^(memory )?card",
                str(choice),
                re.IGNORECASE,
            ):
                return setting.name, choice
    return None
