"""Mistakes in a plan: each is named, or its effect is within the errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from labkit.estimation.candidate import Measured, Observed
from labkit.estimation.laws import (
    F_NUMBER,
    FOCAL_LENGTH,
    MAGNIFICATION,
    PIXEL_PITCH,
    RANGE_ZERO,
    SIZE,
    WAVELENGTH,
    Place,
)
from labkit.estimation.lens_fit import LensFit
from labkit.estimation.mistakes import models, with_doubts
from labkit.estimation.select import select
from labkit.estimation.stated import Stated
from labkit.key import Key
from labkit.types import Floats
from labkit.uncertain import Uncertain
from tests.lens_samples import (
    COLOURS,
    best_focus,
    measured_of,
    members,
    stated,
    with_measured,
    with_values,
)

FOCAL_MM, N, MP, FOCUS_MM = 70.0, 2.8, 1.05, 3100.0
MODES = {5: 0.03, 6: -0.02, 8: 0.05, 11: 0.04}
FAR, NEAR = (3000.0, 3200.0, 3300.0), (480.0, 500.0, 530.0)


def plan(focal_mm: float = FOCAL_MM, n: float = N) -> Stated:
    """A plan with the errors that plans have unless they state others."""
    return stated(
        focal_mm,
        n,
        focal_length=Uncertain(focal_mm, 0.02 * focal_mm, "mm"),
        f_number=Uncertain(n, 0.03 * n),
        size_std=1e-4,
        range_std_mm=0.01,
        range_zero_std_mm=10.0,
        wavelength_std=dict.fromkeys(COLOURS, 0.005),
    )


Seen = Callable[[Floats, str], Floats]
"""What is measured under a mistake, of true values (modes, ln of the cone, ln of the scale) and a channel."""


def longer(ratio: float, channels: str = "G") -> Seen:
    """Light of a wavelength `ratio` times as long as stated."""

    def seen(values: Floats, channel: str) -> Floats:
        log = np.log(ratio) if channel in channels else 0.0
        return np.array([*values[:-2] * np.exp(-log), values[-2] + log, values[-1]])

    return seen


def of_pitch(ratio: float) -> Seen:
    """A stated pixel pitch that is `ratio` times the true one."""
    return lambda values, _: (
        values + np.log(ratio) * (np.arange(len(values)) >= len(values) - 2)
    )


def of_size(ratio: float) -> Seen:
    """A stated size of the target that is `ratio` times the true one."""
    return lambda values, _: (
        values - np.log(ratio) * (np.arange(len(values)) == len(values) - 1)
    )


RIGHT = plan()


@dataclass(frozen=True)
class Case:
    """A mistake in a plan. column: which column it is of; named: whether the photographs tell that it is."""

    column: Place | None
    seen: Seen = lambda values, _: values
    plan: Stated = RIGHT
    tape_mm: float = 0.0
    channels: str = "RGB"
    named: bool = True


CASES = {
    "no mistake": Case(None),
    "no mistake, one channel": Case(None, channels="G"),
    "450 nm for 550 nm": Case((WAVELENGTH, ("G",)), longer(550 / 450)),
    "450 nm for 550 nm, one channel": Case(
        (WAVELENGTH, ("G",)), longer(550 / 450), channels="G"
    ),
    "570 nm for 550 nm": Case((WAVELENGTH, ("G",)), longer(550 / 570)),
    "all wavelengths 10 % too short": Case((WAVELENGTH, ()), longer(1 / 0.9, "RGB")),
    "pitch 5 % too large": Case((PIXEL_PITCH, ()), of_pitch(1.05), named=False),
    "pitch 5 % too small": Case((PIXEL_PITCH, ()), of_pitch(0.95), named=False),
    "pitch of another camera": Case((PIXEL_PITCH, ()), of_pitch(1.25)),
    "size 3 % too large": Case((SIZE, ()), of_size(1.03)),
    "size 3 % too small": Case((SIZE, ()), of_size(0.97)),
    "one stop too far open": Case((F_NUMBER, ()), plan=plan(n=N / 2**0.5)),
    "one stop too far closed": Case((F_NUMBER, ()), plan=plan(n=N * 2**0.5)),
    "another focal length": Case((FOCAL_LENGTH, ()), plan=plan(focal_mm=85.0)),
    "a tape 300 mm off": Case((RANGE_ZERO, ()), tape_mm=300.0),
}


def seen_covariance(one: Observed, case: Case, channel: str) -> Measured:
    """The measurement with the covariance of modes that a mistake makes smaller or larger."""
    measured = measured_of(one)
    change = np.ones(len(measured.values))
    change[:-2] = case.seen(np.ones(len(change)), channel)[:-2]
    return replace(measured, covariance=measured.covariance * np.outer(change, change))


def observed(
    case: Case, ranges: tuple[float, ...], rng: np.random.Generator
) -> list[Observed]:
    """What the fits measure of a session with a mistake in its plan."""
    focus_mm = 505.0 if ranges == NEAR else FOCUS_MM
    every = []
    for one in members(ranges, focus_mm, FOCAL_MM, N, MP, modes=MODES):
        key = one.reading.key
        if key.channel not in case.channels:
            continue
        values = rng.multivariate_normal(
            measured_of(one).values, measured_of(one).covariance
        )
        at = one.reading.range_mm - case.tape_mm
        reading = replace(one.reading, key=Key(at, key.channel), range_mm=at, station=at)
        one = with_measured(one, seen_covariance(one, case, key.channel))
        every.append(
            replace(with_values(one, case.seen(values, key.channel)), reading=reading)
        )
    return every


def fitted(case: Case, ranges: tuple[float, ...], seed: int = 1) -> LensFit:
    """The lens of such a session, as `labkit fit` has it."""
    return with_doubts(
        select(observed(case, ranges, np.random.default_rng(seed)), case.plan).lens
    )


def errors(lens: LensFit, case: Case, ranges: tuple[float, ...]) -> dict[str, float]:
    """Errors over standard errors."""
    truth = {FOCAL_LENGTH: FOCAL_MM, F_NUMBER: N, MAGNIFICATION: np.log(MP)}
    found = {
        kind: (lens.value(kind) - true) / lens.std(kind) for kind, true in truth.items()
    }
    focus_mm = (505.0 if ranges == NEAR else FOCUS_MM) - case.tape_mm
    best = best_focus(lens, case.channels[0])
    found["best focus"] = (best.value - focus_mm) / best.std
    exact = members(ranges, focus_mm + case.tape_mm, FOCAL_MM, N, MP, modes=MODES)
    true = [
        measured_of(one).values for one in exact if one.reading.key.channel in case.channels
    ]
    for k, wanted in enumerate(true):
        values, covariance = lens.posterior(k)
        z = (values - wanted)[:-1] / np.sqrt(np.diag(covariance))[:-1]
        found[f"observation {k}"] = float(np.abs(z).max())
    return found


CLOSE_UP = ("no mistake", "570 nm for 550 nm", "pitch 5 % too large", "pitch 5 % too small")
"""Cases that close range changes most: there the pupil magnification counts."""


@pytest.mark.parametrize(
    ("name", "ranges"),
    [*((name, FAR) for name in CASES), *((name, NEAR) for name in CLOSE_UP)],
)
def test_a_mistake_in_the_plan_is_named_or_is_within_the_errors(
    name: str, ranges: tuple[float, ...]
) -> None:
    case = CASES[name]
    lens = fitted(case, ranges)
    assert max(map(abs, errors(lens, case, ranges).values())) < 4
    assert lens.model.laws.mistaken == (case.column if case.named else None)


def test_a_mistake_of_two_candidates_at_one_range_is_within_the_errors() -> None:
    # one picture determines the cone times the wavelength: stop and wavelength are equally suspect
    case = Case(None, longer(550 / 450), channels="G")
    lens = fitted(case, (3000.0,))
    probabilities = {fit.model.laws.mistaken: p for p, fit in models(lens)}
    assert probabilities[F_NUMBER, ()] > 0.1
    assert probabilities[WAVELENGTH, ("G",)] > 0.1
    values, covariance = lens.posterior(0)
    true = measured_of(members((3000.0,), FOCUS_MM, FOCAL_MM, N, MP, modes=MODES)[1]).values
    off = np.abs(values) - np.abs(true)  # one range leaves the sign open
    z = off[:-1] / np.sqrt(np.diag(covariance))[:-1]
    assert np.abs(z).max() < 4


def test_doubts_about_a_right_plan_cost_little() -> None:
    lens = fitted(Case(None), FAR)
    plain = replace(lens, others=())
    for kind in (FOCAL_LENGTH, F_NUMBER, MAGNIFICATION):
        assert 1 <= lens.std(kind) / plain.std(kind) < 1.3  # at most 1.15 measured
    assert best_focus(lens, "G").std < 1.1 * best_focus(plain, "G").std
