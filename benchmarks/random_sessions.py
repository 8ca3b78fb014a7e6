"""Sessions of many kinds on the simulated bench, their lenses, tapes and targets off from what the plan states by its errors.

A small sensor makes one in seconds: up to 160 pixels a side, and diffraction followed ring by ring for so far only as a pixel
sees it, light and ambient fitted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import brentq

from labkit.acquisition.capture import run_plan
from labkit.devices.context import DeviceContext
from labkit.devices.registry import open_devices
from labkit.devices.shared import SharedParts
from labkit.drivers.simulated.bench import Bench
from labkit.drivers.simulated.optics import (
    REFERENCE_NM,
    defocus_waves,
    entrance_pupil_to_target_mm,
    image_per_tangent_mm,
)
from labkit.drivers.simulated.parts import LowPassFilter, Smear, Spectrum, Veil
from labkit.drivers.simulated.pupil import Pupil
from labkit.drivers.simulated.world import (
    BenchSettings,
    TrueLens,
    TruePanel,
    TruePose,
    TrueRail,
    TrueSensor,
    Truth,
)
from labkit.plan import Plan
from labkit.plan.mode_groups import MOST_NOLL
from labkit.session.session import Session
from labkit.types import Floats

FOCAL_STD, F_NUMBER_STD, SIZE_STD, WAVELENGTH_STD = 0.02, 0.03, 1e-4, 0.005
"""Relative errors of engravings, target and filters: those that a plan has by default, as the tape's here."""

TAPE_STD_MM, HOMING_STD_MM = 10.0, 0.02

HALO_UM, HALO_AIRY = 350.0, 120.0
"""Out to the lesser of which, the second in lambda N, diffraction is followed ring by ring, or as far as rays need; beyond, the
mean of the rings.
Against 700 um that changes a pixel by 0.01 of its noise RMS, at f/1.9 by 0.04 (five sessions)."""

SAMPLES = 6
"""To a pixel, or as many as diffraction needs: a pixel changes by less than 0.01 of its noise from twenty."""

MANY_MODES = 22
"""Last of Noll's modes."""

SEVEN_BLADES = Pupil(blades=7, turn_deg=20.0, rounding=0.4)
CATS_EYE = Pupil(cats_eye=(0.3, 1.0, 60.0))
"""Pupils of strong wavefronts' sessions."""

HIGHER_WAVES = 0.005, 0.05
"""Of lenses as they are made, RMS of Noll's modes 16 to 36."""

PANEL_PIXELS = 320
"""Of a side; a cell of the carpet is one of them, and a flat fills all that the camera sees, its halo included."""

WAVELENGTHS_NM = {"R": (600, 650), "G": (525, 555), "B": (450, 475)}
ENCODER_STD_MM = 0.005 / 12**0.5
"""Of a range: the encoder counts in steps of 0.005 mm."""

PARTS_STREAM, AS_MADE_STREAM = 1, 2
"""Set what draws a session's parts, or its lens as it is made, apart from what draws the session."""

EXPOSURE_S, WHITE_COUNTS = 0.02, 10_350.0
ADDRESS = "simulated:"


@dataclass(frozen=True, slots=True)
class Drawn:
    """A session to be made: what is known, what is true, and of which kind it is."""

    plan: Plan
    settings: BenchSettings
    kind: dict[str, Any]


def draw(seed: int, index: int) -> Drawn:
    """The session of that number of a study, with a lens that blurs enough between ranges within a rail's reach."""
    rng = np.random.default_rng([seed, index])
    while True:
        mono = bool(rng.random() < 0.3)
        lens = _lens(["G"] if mono else ["R", "G", "B"], rng)
        sides = str(rng.choice(["around", "around", "short", "beyond"]))
        ranges_mm = _true_ranges_mm(lens, sides, rng)
        if ranges_mm:
            return _session(lens, ranges_mm, sides, rng)


def draw_many_modes(
    seed: int, index: int, last: int = MANY_MODES, waves: float = 0.5
) -> Drawn:
    """One of so many waves RMS in Noll's modes 5 to `last`, a wavefront for each of three ranges: before, about and behind best
    focus. Its plan states the modes."""
    rng = np.random.default_rng([seed, index])
    best_mm = _even_in_log(rng, 1000, 3000)
    lens = TrueLens(
        f_number=_even_in_log(rng, 2.5, 4),
        wavelength_nm={"G": float(rng.uniform(*WAVELENGTHS_NM["G"]))},
        best_focus_mm={"G": best_mm},
        noll=tuple(range(5, last + 1)),
        aberration_waves=waves,
    )
    stations = np.array([-0.8, 0.0, 0.8]) + rng.uniform(-0.15, 0.15, 3)
    drawn = _session(lens, _ranges_at(lens, best_mm, stations), "through focus", rng)
    return replace(drawn, plan=drawn.plan.replace(fit={"zernike_noll": (4, last)}))


def draw_strong(
    seed: int, index: int, waves: float = 0.5, pupil: Pupil | None = None
) -> Drawn:
    """Draw a session of `draw_many_modes` with modes to Noll 37, of which its plan says nothing.

    Parameters
    ----------
    waves : RMS of the modes 5 to 37
    pupil : the pupil, if not round; Drawn.kind["as_made"] has it
    """
    drawn = draw_many_modes(seed, index, MOST_NOLL, waves)
    made = replace(drawn, plan=drawn.plan.replace(fit={"zernike_noll": None}))
    if pupil is None:
        return made
    settings = replace(drawn.settings, lens=replace(drawn.settings.lens, pupil=pupil))
    kind = {**drawn.kind, "as_made": {"pupil": asdict(pupil)}}
    return replace(made, settings=settings, kind=kind)


def draw_with_parts(seed: int, index: int) -> Drawn:
    """The session that `draw` has of that number, with parts of real cameras and light that its plan says nothing of.

    Drawn.kind["parts"] tells those that it has: low_pass_px (rows, columns), spectrum (colour: lines of nm and share, whose
    mean is the wavelength drawn), diffusion_px, smear (pixels, degrees from right towards down), veil (share, scale in pixels).
    """
    drawn = draw(seed, index)
    rng = np.random.default_rng([seed, index, PARTS_STREAM])
    likely, rare = rng.random(3) < 0.5, rng.random(2) < 0.2
    wavelengths = drawn.settings.lens.wavelength_nm
    every: dict[str, Any] = {
        "low_pass_px": rng.uniform(0.3, 0.9, 2).tolist(),
        "spectrum": {colour: _lines(nm, rng) for colour, nm in wavelengths.items()},
        "diffusion_px": float(rng.uniform(0.1, 0.3)),
        "smear": [float(rng.uniform(0.1, 0.5)), float(rng.uniform(0, 180))],
        "veil": [float(rng.uniform(0.005, 0.03)), _even_in_log(rng, 10, 100)],
    }
    parts = {
        name: part
        for (name, part), has in zip(every.items(), [*likely, *rare], strict=True)
        if has
    }
    return replace(
        drawn,
        settings=_with_parts(drawn.settings, parts),
        kind={**drawn.kind, "parts": parts},
    )


def draw_silent(seed: int, index: int) -> Drawn:
    """Draw the session that `draw` has of that number, whose plan says nothing of the lens's modes."""
    drawn = draw(seed, index)
    return replace(drawn, plan=drawn.plan.replace(fit={"zernike_noll": None}))


def draw_as_made(seed: int, index: int) -> Drawn:
    """The session that `draw` has of that number, through a lens as it is made, of which its plan says nothing.

    Every lens has modes beyond Noll 15; most have a diaphragm, some of these an obstruction in place of it, some a cat's eye.
    Drawn.kind["as_made"] tells them: higher_waves, and what the pupil has.
    """
    drawn = draw(seed, index)
    rng = np.random.default_rng([seed, index, AS_MADE_STREAM])
    higher_waves, pupil = _even_in_log(rng, *HIGHER_WAVES), _pupil(rng)
    lens = replace(drawn.settings.lens, higher_waves=higher_waves, pupil=Pupil(**pupil))
    return Drawn(
        drawn.plan.replace(fit={"zernike_noll": None}),
        replace(drawn.settings, lens=lens),
        {**drawn.kind, "as_made": {"higher_waves": higher_waves, **pupil}},
    )


def _pupil(rng: np.random.Generator) -> dict[str, Any]:
    """Draw a pupil: of 100, 60 have blades and 15 an obstruction; 25 of 100 have a cat's eye."""
    pupil: dict[str, Any] = {}
    kind, has_eye = rng.random(), bool(rng.random() < 0.25)
    blades = int(rng.integers(5, 12))
    turn_deg, rounding = float(rng.uniform(0, 360 / blades)), float(rng.uniform(0, 1))
    obstruction, shift = float(rng.uniform(0.2, 0.5)), float(rng.uniform(0.2, 0.6))
    eye = shift, float(rng.uniform(0.9, 1.2)), float(rng.uniform(0, 360))
    if kind < 0.6:
        pupil |= {"blades": blades, "turn_deg": turn_deg, "rounding": rounding}
    elif kind < 0.75:
        pupil["obstruction"] = obstruction
    if has_eye:
        pupil["cats_eye"] = eye
    return pupil


KINDS: dict[str, Callable[[int, int], Drawn]] = {
    "any": draw,
    "many-modes": draw_many_modes,
    "many-modes-37": draw_strong,
    "many-modes-37-one-wave": partial(draw_strong, waves=1.0),
    "many-modes-37-blades": partial(draw_strong, pupil=SEVEN_BLADES),
    "many-modes-37-cats-eye": partial(draw_strong, pupil=CATS_EYE),
    "many-modes-37-one-wave-blades": partial(draw_strong, waves=1.0, pupil=SEVEN_BLADES),
    "many-modes-37-one-wave-cats-eye": partial(draw_strong, waves=1.0, pupil=CATS_EYE),
    "with-parts": draw_with_parts,
    "silent": draw_silent,
    "as-made": draw_as_made,
}


def make(drawn: Drawn, folder: Path) -> Truth:
    """Capture it into a new folder; the truth of it."""
    bench = Bench(drawn.settings)
    context = DeviceContext(shared=SharedParts({ADDRESS: bench}))
    with (
        open_devices(drawn.plan, context=context) as devices,
        Session.create(folder, drawn.plan.to_toml(), Path()) as session,
    ):
        run_plan(session, devices, check=False)
    return bench.truth


def _lens(colours: list[str], rng: np.random.Generator) -> TrueLens:
    """Each colour's best focus lies up to a fifth of a wave from the first one's."""
    best_mm = _even_in_log(rng, 400, 5000)
    lens = TrueLens(
        focal_length_mm=_even_in_log(rng, 30, min(135, best_mm / 5)),
        f_number=_even_in_log(rng, 1.8, 8),
        pupil_magnification=float(rng.uniform(0.6, 1.6)),
        wavelength_nm={
            colour: float(rng.uniform(*WAVELENGTHS_NM[colour])) for colour in colours
        },
        aberration_waves=float(rng.uniform(0.05, 0.3)),
        lateral_colour={"R": float(rng.normal(0, 1e-4)), "B": float(rng.normal(0, 1e-4))}
        if rng.random() < 0.3
        else {},
    )
    wave_mm = 1 / (
        _defocus(lens, best_mm + 0.5, best_mm) - _defocus(lens, best_mm - 0.5, best_mm)
    )
    apart = [0.0, *rng.uniform(-0.2, 0.2, len(colours) - 1)]
    focus_mm = {
        colour: best_mm + waves * wave_mm
        for colour, waves in zip(colours, apart, strict=True)
    }
    return replace(lens, best_focus_mm=focus_mm)


def _lines(nm: float, rng: np.random.Generator) -> list[list[float]]:
    """Five lines of a leaning bell of 5 to 60 nm (FWHM), with their shares; their mean is the wavelength given."""
    at, lean = np.linspace(-1, 1, 5), rng.uniform(-0.6, 0.6)
    shares = np.exp(-4 * np.log(2) * at**2) * (1 + lean * at)
    shares /= shares.sum()
    lines = nm + rng.uniform(5, 60) * (at - at @ shares)
    return [[float(line), float(share)] for line, share in zip(lines, shares, strict=True)]


def _with_parts(settings: BenchSettings, parts: dict[str, Any]) -> BenchSettings:
    """A world with the parts that `draw_with_parts` tells of."""
    lens, sensor, rail = settings.lens, settings.sensor, settings.rail
    spectra = {
        colour: Spectrum(tuple((nm, share) for nm, share in lines))
        for colour, lines in parts.get("spectrum", {}).items()
    }
    low_pass = LowPassFilter(*parts.get("low_pass_px", (0.0, 0.0)))
    return replace(
        settings,
        lens=replace(
            lens,
            spectrum=spectra,
            veil=Veil(*parts["veil"]) if "veil" in parts else lens.veil,
        ),
        sensor=replace(
            sensor, low_pass=low_pass, diffusion_px=parts.get("diffusion_px", 0.0)
        ),
        rail=replace(rail, smear=Smear(*parts.get("smear", (0.0, 0.0)))),
    )


def _even_in_log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _defocus(lens: TrueLens, range_mm: float, best_mm: float) -> float:
    return defocus_waves(
        range_mm, best_mm, lens.focal_length_mm, lens.f_number, lens.pupil_magnification
    )


def _true_ranges_mm(lens: TrueLens, sides: str, rng: np.random.Generator) -> list[float]:
    """Two to six, around best focus or on one side of it, up to 1.5 waves away; none where a rail does not get so far."""
    best_mm, reach = (
        float(np.mean(list(lens.best_focus_mm.values()))),
        rng.uniform(0.5, 1.5),
    )
    low, high = {
        "around": (-reach, reach),
        "short": (-reach, -0.1),
        "beyond": (0.1, reach),
    }[sides]
    stations = np.linspace(low, high, rng.integers(2, 7)) + rng.uniform(-0.05, 0.05)
    return _ranges_at(lens, best_mm, stations)


def _ranges_at(lens: TrueLens, best_mm: float, stations: Floats) -> list[float]:
    """Where defocus is as wanted, waves in rising order; none where that is too far from best focus for a rail."""
    near_mm, far_mm = best_mm / 1.3, best_mm * 1.3
    if (
        not _defocus(lens, near_mm, best_mm)
        < stations[0]
        < stations[-1]
        < _defocus(lens, far_mm, best_mm)
    ):
        return []
    return [
        brentq(lambda mm, waves=waves: _defocus(lens, mm, best_mm) - waves, near_mm, far_mm)
        for waves in stations
    ]


def _session(
    lens: TrueLens,
    ranges_mm: list[float],
    sides: str,
    rng: np.random.Generator,
    white_electrons: float | None = None,
    tape_std_mm: float = TAPE_STD_MM,
) -> Drawn:
    """Plan and world; what the plan states is off by its standard errors. white_electrons: None for a random number."""
    tape_mm = float(rng.normal(0, tape_std_mm))
    stated_mm = [round(mm - tape_mm, 1) for mm in ranges_mm]
    rail = TrueRail(
        high_mm=stated_mm[-1] - stated_mm[0] + 50,
        range_at_zero_mm=stated_mm[0] - 20,
        tape_error_mm=tape_mm,
        homing_scatter_mm=HOMING_STD_MM,
    )
    electrons = white_electrons or _even_in_log(rng, 3000, 40_000)
    sensor = TrueSensor(
        rows=(rows := int(rng.integers(14, 21)) * 8),
        cols=rows,
        pitch_um=round(float(rng.uniform(3.5, 6.0)), 2),
        pattern="mono" if len(lens.wavelength_nm) == 1 else "RGGB",
        counts_per_electron=WHITE_COUNTS / electrons,
        white_electrons_per_s=electrons / EXPOSURE_S,
        hot_pixels=3,
        dead_pixels=3,
    )
    order = int(rng.choice([3, 4]))
    size_mm = round(0.76 * rows * sensor.pitch_um * 1e-3 / _scale(lens, ranges_mm[0]), 3)
    pitch_mm = size_mm * (1 + rng.normal(0, SIZE_STD)) / 3**order
    halo_um = min(
        HALO_UM, HALO_AIRY * max(lens.wavelength_nm.values()) * 1e-3 * lens.f_number
    )
    panel = TruePanel(pixels=(PANEL_PIXELS,) * 2, pitch_mm=pitch_mm)
    settings = BenchSettings(
        int(rng.integers(2**31)),
        lens,
        sensor,
        panel,
        rail,
        TruePose(2.0, 3.0, 3.0),
        halo_um,
        SAMPLES,
    )
    others = [colour for colour in lens.wavelength_nm if colour != "G"]
    chosen = sorted(
        ["G", *rng.permutation(others)[: rng.integers(0, 3)]], key="RGB".index
    )  # the truth's f is green's
    plan = _plan(settings, chosen, stated_mm, order, size_mm, rng)
    kind = {
        "ranges": sides,
        "electrons": electrons,
        "colours": len(chosen),
        "mono": sensor.pattern == "mono",
    }
    return Drawn(plan, settings, kind)


def _scale(lens: TrueLens, range_mm: float) -> float:
    """Size of the picture over that of a target at a range."""
    focal_mm, mp = lens.focal_length_mm, lens.pupil_magnification
    tangent_mm = image_per_tangent_mm(lens.focused_mm, focal_mm, mp)
    return tangent_mm / entrance_pupil_to_target_mm(range_mm, focal_mm, mp)


def _plan(
    settings: BenchSettings,
    colours: list[str],
    stated_mm: list[float],
    order: int,
    size_mm: float,
    rng: np.random.Generator,
) -> Plan:
    lens, sensor, rail = settings.lens, settings.sensor, settings.rail
    engraved_mm = lens.focal_length_mm * (1 + rng.normal(0, FOCAL_STD))
    engraved = lens.f_number * (1 + rng.normal(0, F_NUMBER_STD))
    levels = {
        "black_level": sensor.black_level,
        "white_level": sensor.white_level,
        "cfa_pattern": "mono",
    }
    stated_nm = {
        colour: lens.wavelength_nm[colour] * (1 + rng.normal(0, WAVELENGTH_STD))
        for colour in colours
    }
    tables = {
        "lens": {"focal_length_mm": engraved_mm, "f_number": engraved},
        "sensor": {
            "pixel_pitch_um": sensor.pitch_um,
            **(levels if sensor.pattern == "mono" else {}),
        },
        "channel": [
            {"name": colour, "wavelength_nm": nm} for colour, nm in stated_nm.items()
        ],
        "target": {"kind": "sierpinski", "order": order, "size_mm": size_mm},
        "fit": {
            "zernike_noll": [4, 15],
            "range_std_mm": ENCODER_STD_MM,
            "reference_wavelength_nm": REFERENCE_NM,  # the truth counts in waves of it
        },
        "camera": {
            "address": ADDRESS,
            "exposure_s": EXPOSURE_S,
            "frames_per_range": 2,
            "flats_per_range": 3,
            "darks": 3,
        },
        "rail": {
            "address": ADDRESS,
            "ranges_mm": stated_mm,
            "range_at_zero_mm": rail.range_at_zero_mm,
            "settle_s": 0,
        },
        "display": {
            "address": ADDRESS,
            "pixel_pitch_mm": size_mm / 3**order,
            "pixels": list(settings.panel.pixels),
        },
    }
    return Plan.from_tables(tables)
