"""Parts of the camera: to data-sheet quantities and back, shared among channels or not; and a part that labkit lacks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
import pytest

from labkit.estimation.climb import Start
from labkit.estimation.expansion import free_f_number
from labkit.estimation.scores import score_tests
from labkit.estimation.settings import SETTINGS
from labkit.estimation.stated import optics_of, wanted_parts
from labkit.imaging.estimated import root
from labkit.imaging.model import ForwardModel
from labkit.imaging.panel_aperture import Aperture
from labkit.imaging.parts import (
    ESTIMATED,
    KNOWN,
    Blades,
    CatsEye,
    Diffusion,
    LowPass,
    Obstruction,
    Part,
    Smear,
    SpectrumWidth,
    UnevenField,
    UnevenRim,
    Veil,
    Vignetted,
)
from labkit.imaging.parts.rim import USUAL_SHARE
from labkit.optics.spectrum import Spectrum
from labkit.plan import Channel, Plan
from labkit.report.fit_tables import part_table
from labkit.types import AnyFloats
from labkit.uncertain import Uncertain
from tests.plans import PORTRAIT, RED_AND_GREEN
from tests.results_samples import some_results
from tests.unit.test_cone import CARPET, FRAME, OPTICS, POSE, TRUTH, photographed

CORNER = -0.55, 0.8
GREEN = Channel(name="G", wavelength_nm=550.0)
PLAN = Plan.from_tables(PORTRAIT)
EVERY = (
    LowPass(0.3, 0.5),
    LowPass(0.6, 0.1, turned=True),
    Diffusion(0.04),
    Smear(0.02, 0.01, -0.008),
    Veil(0.03, 20.0),
    SpectrumWidth(0.03**2),
)
RIMS = (
    Blades(7, 0.3, -0.2),
    Obstruction(0.42**2),
    UnevenRim(0.05, -0.02, 0.03, 0.01),
    CatsEye(0.3, -0.4, 0.2),
    UnevenField(-0.2, 0.05, CORNER),
    Vignetted(0.6, 0.02, -0.01, -0.4, CORNER),
)
WIDTH = SpectrumWidth(0.02**2)


def estimated(part: Part) -> list[Uncertain]:
    return [Uncertain(value, 0.01) for value in part.values]


def named(part: Part) -> str:
    return part.name


@pytest.mark.parametrize("part", [*EVERY, *RIMS], ids=named)
def test_a_part_is_what_its_quantities_say(part: Part) -> None:
    back = KNOWN[part.name].from_quantities(part.quantities(estimated(part), GREEN), GREEN)
    assert back is not None
    assert type(back) is type(part)
    assert back.values == pytest.approx(part.values, rel=1e-12)


@pytest.mark.parametrize("part", [*EVERY, *RIMS], ids=named)
def test_quantities_begin_with_the_part_and_each_has_a_meaning(part: Part) -> None:
    keys = [key.split(".") for key in part.quantities(estimated(part), GREEN)]
    assert {key[0] for key in keys} == {part.name}
    assert [key[-1] for key in keys] == [*part.meanings]
    assert all(key[1:-1] == ["G"] * part.per_channel for key in keys)


@pytest.mark.parametrize("part", KNOWN.values(), ids=named)
def test_no_part_is_made_of_nothing_or_of_what_is_not_known(part: Part) -> None:
    unknown = dict.fromkeys(part.quantities(estimated(part), GREEN), Uncertain(np.nan))
    assert part.from_quantities({}, GREEN) is None
    assert part.from_quantities(unknown, GREEN) is None


def test_a_smear_of_results_without_a_slant_is_upright() -> None:
    found = {"smear.rows_px": Uncertain(0.2), "smear.columns_px": Uncertain(0.3)}
    back = Smear().from_quantities(found)
    assert back is not None
    assert back.values == pytest.approx((0.04, 0.09, 0.0))


def test_a_plan_that_states_no_part_has_none() -> None:
    assert [part.stated(PLAN, GREEN) for part in KNOWN.values()] == [None] * len(KNOWN)
    assert wanted_parts(PLAN) == []


def test_one_channel_may_want_its_width_fitted_alone() -> None:
    red, green = RED_AND_GREEN["channel"]
    plan = Plan.from_tables({**PORTRAIT, "channel": [red, {**green, "width_nm": "fit"}]})
    assert wanted_parts(plan) == ["spectrum"]
    assert optics_of(plan, "G").parts == (SpectrumWidth(),)
    assert optics_of(plan, "R").parts == ()


def test_a_lens_has_one_diaphragm() -> None:
    sought = [name for name in OPTICS.lacking if name.startswith("blades")]
    assert sought == [f"blades_{number}" for number in range(5, 12)]
    with_blades = replace(OPTICS, given=(Blades(7, 0.3, 0.1),))
    assert not [name for name in with_blades.lacking if name.startswith("blades")]
    assert "obstruction" in with_blades.lacking


def test_a_rim_of_nothing_is_round() -> None:
    assert replace(OPTICS, parts=(Blades(7), Obstruction(), UnevenRim())).rim.is_round
    assert not replace(OPTICS, parts=(Blades(7, 0.1),)).rim.is_round
    assert replace(OPTICS, given=(Obstruction(0.2),)).rim.obstructed == 0.2


@pytest.mark.parametrize(
    ("part", "beyond", "within"),
    [
        (Obstruction(), (2.0,), (0.8,)),
        (UnevenRim(), (0.9, 0.9, -3.0, 0.0), (0.3, 0.3, 0.2, 0.2)),
        (CatsEye(), (3.0, 4.0, 0.0), (0.5, 0.7, 0.0)),
        (CatsEye(), (0.0, 0.0, -2.0), (0.0, 0.0, -0.8)),
    ],
)
def test_a_rim_beyond_a_closed_curve_ends_at_the_bound_and_tells(
    part: Part, beyond: tuple[float, ...], within: tuple[float, ...]
) -> None:
    assert part.at(beyond).at_bound
    assert not part.at(within).at_bound


def test_a_rim_stays_a_closed_curve_and_a_blade_no_more_than_straight() -> None:
    cosine, sine = Blades(6).at((3.0, 4.0)).values
    assert cosine**2 + sine**2 == pytest.approx(1)
    assert Obstruction().at((2.0,)).share == pytest.approx(0.81)
    rim = replace(OPTICS, parts=(UnevenRim().at((0.9, 0.9, -3.0, 0.0)),)).rim
    assert min(np.linalg.norm(rim.edges(64)[0], axis=1)) > 0.1


def test_fits_look_for_an_obstruction_from_a_share_that_shows() -> None:
    idle = OPTICS.with_parts(["obstruction", "diffusion"])
    assert idle.parts == (Diffusion(), Obstruction())
    assert idle.begun().parts == (Diffusion(), Obstruction(USUAL_SHARE))
    found = replace(OPTICS, parts=(Obstruction(0.2),))
    assert found.begun() == found


def test_a_part_of_the_light_goes_before_a_spectrum() -> None:
    stated = replace(OPTICS, spectrum=Spectrum((0.99, 1.01), (0.5, 0.5)))
    assert replace(stated, parts=(WIDTH,)).light == WIDTH.light
    assert replace(stated, given=(WIDTH,)).light == WIDTH.light
    assert replace(stated, parts=(WIDTH,)).without(["spectrum"]) == stated
    assert replace(stated, parts=(WIDTH, Diffusion())).in_one_wavelength() == replace(
        OPTICS, parts=(Diffusion(),)
    )


def test_the_shape_is_of_parts_then_panel_then_cone() -> None:
    optics = replace(
        OPTICS, parts=(Diffusion(0.1),), panel=Aperture(0.03, -0.02)
    ).with_parts(["spectrum"])
    assert optics.camera_labels == (
        "diffusion.variance_px2",
        "spectrum.variance",
        "panel_pixels.across",
        "panel_pixels.down",
    )
    np.testing.assert_allclose(
        optics.camera_parameters, [0.1, 0.0, 0.03, -0.02, np.log(OPTICS.f_number)]
    )
    moved = optics.with_camera_parameters(optics.camera_parameters + 0.001)
    assert moved.panel == Aperture(0.031, -0.019)
    assert len(optics.camera_stds) == 5


@dataclass(frozen=True, slots=True)
class Streak(Part):
    """exp(-2 pi^2 sigma^2 w^2) along rows alone, a made-up part. variance: sigma^2, pixels squared."""

    variance: float = 0.0

    name: ClassVar[str] = "streak"
    title: ClassVar[str] = "streak"
    words: ClassVar[str] = "a streak along the rows"
    labels: ClassVar[tuple[str, ...]] = ("variance_px2",)
    usual: ClassVar[tuple[float, ...]] = (0.2,)
    meanings: ClassVar[Mapping[str, str]] = {"sigma_px": "width of the streak"}

    @property
    def values(self) -> tuple[float, ...]:
        return (self.variance,)

    def at(self, values: Sequence[float]) -> Self:
        return type(self)(*map(float, values))

    def transfer(self, rows: AnyFloats, columns: AnyFloats) -> AnyFloats:
        return np.asarray(np.exp(-2 * np.pi**2 * self.variance * (rows**2 + 0 * columns)))

    def slopes(self, rows: AnyFloats, columns: AnyFloats) -> tuple[AnyFloats, ...]:
        return (np.asarray(-2 * np.pi**2 * rows**2 * self.transfer(rows, columns)),)

    def stated(self, plan: Plan, channel: Channel) -> None:
        return None

    def quantities(
        self, numbers: Sequence[Uncertain], channel: Channel | None = None
    ) -> dict[str, Uncertain]:
        (variance,) = numbers
        return {"streak.sigma_px": root(variance, "px")}

    def from_quantities(
        self, found: Mapping[str, Uncertain], channel: Channel | None = None
    ) -> Self | None:
        return (
            type(self)(found["streak.sigma_px"].value ** 2)
            if "streak.sigma_px" in found
            else None
        )


@pytest.fixture
def streak(monkeypatch: pytest.MonkeyPatch) -> Streak:
    """A new part, among the known ones."""
    monkeypatch.setitem(KNOWN, "streak", Streak())
    monkeypatch.setitem(ESTIMATED, "streak", Streak())
    return Streak(0.06)


def test_a_new_part_has_slopes_that_are_differences_of_pictures(streak: Streak) -> None:
    optics = replace(OPTICS, parts=(Diffusion(0.02), streak))
    model = ForwardModel.build(
        optics, CARPET, FRAME, POSE, f_number_margin=SETTINGS.f_number_margin
    )
    used, drawing = [np.ones(FRAME, bool)], model.draw([POSE])
    slope = model.evaluate(TRUTH.waves, drawing, used, by_camera=True)[0].by_waves[
        len(TRUTH.waves) + 1
    ]
    step = np.array([0.0, 1e-3, 0.0])
    up, down = (
        model.with_optics(
            optics.with_camera_parameters(optics.camera_parameters + sign * step)
        ).means(TRUTH.waves, drawing, used)[0]
        for sign in (1, -1)
    )
    difference = (up - down) / 2e-3
    # a difference errs by (2 pi^2 w^2)^2 1e-6 / 6, at half a cycle a pixel 4e-6; measured 7e-6
    assert np.abs(slope - difference).max() < 1.4e-5 * np.abs(difference).max()


def test_a_new_part_is_called_for_fitted_and_told(streak: Streak) -> None:
    taken = ForwardModel.build(
        replace(OPTICS, given=(streak,)),
        CARPET,
        FRAME,
        POSE,
        f_number_margin=SETTINGS.f_number_margin,
    )
    plain = ForwardModel.build(
        OPTICS, CARPET, FRAME, POSE, f_number_margin=SETTINGS.f_number_margin
    )
    frames = replace(photographed(taken), model=plain)
    freed = free_f_number(frames, Start(TRUTH), 0.03)
    assert "streak" in freed.optics.lacking
    # twice the gain of one number is chi-squared of one: beyond 5.4 once in a thousand
    assert score_tests(freed.expansion, ["streak"], 0.03)["streak"].gain > 5.4
    model = plain.with_optics(OPTICS.with_parts(["streak"]))
    found = free_f_number(replace(frames, model=model), Start(freed.solution.state), 0.03)
    modes = len(OPTICS.noll)
    variance = Uncertain(
        found.measured.values[modes], found.measured.covariance[modes, modes] ** 0.5
    )
    assert found.measured.parts == ("streak.variance_px2",)
    assert abs(variance.value - streak.variance) < 3 * variance.std < streak.variance
    told = streak.quantities([variance])
    assert streak.finding(told).startswith(
        "the photographs call for a streak along the rows"
    )
    assert streak.finding(told).endswith(
        f"which the plan does not state: sigma {told['streak.sigma_px']}"
    )
    back = streak.from_quantities(told)
    assert back is not None
    assert back.variance == pytest.approx(variance.value)


def test_a_new_part_stands_in_the_report(streak: Streak) -> None:
    table = part_table(some_results(model_parts=streak.quantities([Uncertain(0.04, 0.01)])))
    assert table is not None
    assert table.rows[0].cells[:3] == ("streak", "width of the streak", "px")


@pytest.mark.parametrize("turn_deg", [0.0, 100.0, -60.0])
def test_a_cats_eye_begins_with_the_circle_that_an_uneven_rim_is_like(
    turn_deg: float,
) -> None:
    """The harmonics of a cut pupil, about its centroid, lead back to its circle within half a step of those that are tried."""
    turn = np.radians(turn_deg)
    true = CatsEye(0.5 * np.cos(turn), 0.5 * np.sin(turn), 0.2)
    theta = np.linspace(0, 2 * np.pi, 2000, endpoint=False)
    edge = replace(OPTICS, parts=(true,)).rim.outline(theta) * np.exp(1j * theta)
    wedges = np.imag(edge.conj() * np.roll(edge, -1)) / 2
    edge -= np.sum(wedges * (edge + np.roll(edge, -1)) / 3) / wedges.sum()
    outline = np.interp(theta, np.angle(edge), abs(edge), period=2 * np.pi)
    waves = [wave(k * theta) for k in (2, 3) for wave in (np.cos, np.sin)]
    harmonics = 2 * np.mean(waves * outline, axis=1) / outline.mean()
    *small, begun, opposite = CatsEye().starts([UnevenRim(*harmonics)])
    assert begun.values == pytest.approx(true.values, abs=0.06)
    for one, other in (small, (begun, opposite)):
        assert np.dot(one.values[:2], other.values[:2]) < 0
    assert max(one.growth for one in small) < 1e-9


def test_a_cats_eye_without_an_uneven_rim_begins_on_all_sides() -> None:
    eyes = CatsEye().starts([Blades(7, 0.3, 0.1)])
    shifts = [complex(eye.right, eye.down) for eye in eyes]
    assert sum(shifts) == pytest.approx(0.0)
    assert np.abs(shifts) == pytest.approx(0.4)
    assert replace(OPTICS, parts=(CatsEye(),)).rim.is_round


def test_the_rim_of_other_optics_leaves_all_other_parts() -> None:
    ours = replace(OPTICS, parts=(LowPass(0.2, 0.1), CatsEye(0.1, 0.0, 0.1)))
    other = replace(OPTICS, parts=(LowPass(0.4, 0.3), CatsEye(0.3, 0.2, 0.0)))
    assert ours.with_rim_of(other).parts == (ours.parts[0], other.parts[1])


def test_a_cats_eye_excludes_an_uneven_rim_and_keeps_its_centre_inside() -> None:
    assert "uneven_rim" not in replace(OPTICS, parts=(CatsEye(0.3, 0.0, 0.1),)).lacking
    assert "cats_eye" not in OPTICS.lacking
    far = CatsEye().at((3.0, 4.0, 0.0))
    assert np.hypot(far.right, far.down) == pytest.approx(0.95)
