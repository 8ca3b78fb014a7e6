"""A panel's own pixels: what a plan may say of them, what advice and flats say, and how photographs show them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labkit.analysis.fit import first_view
from labkit.calibration.calibrate import calibrate, channel_data
from labkit.errors import PlanError
from labkit.estimation.climb import NoisePrior
from labkit.estimation.likelihood import FrameData
from labkit.estimation.observation import Observation
from labkit.imaging.warp import Pose
from labkit.panel.drawn_target import PanelTarget
from labkit.panel.pattern_in_flats import repeating
from labkit.panel.seen_pixels import SeenPixels, refuse_other_pixels, seen_pixels
from labkit.panel.target_pixels import as_shown, pixels_per_cell
from labkit.photographs.decoding import read_photograph
from labkit.photographs.exposure import aperiodic_noise, exposure_problem, pixel_noise
from labkit.plan import Plan, TargetPixels
from labkit.target.target import CellTarget, open_target
from labkit.types import Floats
from tests.plans import PORTRAIT, Tables, plan_text
from tests.sensor import PRNU, SHAPE, Bench, light_at

DISPLAY: Tables = {
    "display": {"address": "simulated:", "pixel_pitch_mm": 0.0962963, "pixels": [400, 400]}
}
STRIPES = {"pitch_mm": 0.0962963, "layout": "rgb-stripes"}


def planned(*tables: Tables, **pixels: object) -> Plan:
    plan = Plan.parse(plan_text(PORTRAIT, *tables))
    return plan.replace(target={"pixels": pixels}) if pixels else plan


def lattice(per_px: float = 0.21, lean: float = 0.02, depth: float = 0.5) -> Floats:
    """What a panel's stripes make of white on the sensor: two harmonics across, one down."""
    y, x = np.meshgrid(*(np.arange(n, dtype=float) for n in SHAPE), indexing="ij")
    phase, down = 2 * np.pi * per_px * (x + lean * y), 2 * np.pi * per_px * (y - lean * x)
    return np.asarray(
        1
        + depth * np.cos(phase + 0.3)
        + 0.1 * depth * np.cos(2 * phase)
        + 0.1 * depth * np.cos(down)
    )


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"pitch_mm": 0.0}, "target.pixels.pitch_mm = 0"),
        ({"pitch_mm": -0.1}, "target.pixels.pitch_mm = -0.1"),
        ({**STRIPES, "layout": "pentile"}, "target.pixels.layout = 'pentile'"),
        (
            {**STRIPES, "aperture": [1.2, 0.9]},
            "target.pixels.aperture = \\[1.2, 0.9\\]: allowed is \\[across, down\\]",
        ),
        ({**STRIPES, "aperture": [0.8]}, "target.pixels.aperture"),
        ({**STRIPES, "gap": 0.1}, "target.pixels.gap"),
    ],
)
def test_impossible_numbers_are_refused_by_name(
    wrong: dict[str, object], named: str
) -> None:
    with pytest.raises(PlanError, match=named):
        planned(**wrong)


def test_white_around_a_panels_stripes_is_refused() -> None:
    with pytest.raises(PlanError, match='surround = "white"'):
        planned({"target": {"surround": "white"}}, **STRIPES)


def test_a_plan_with_pixels_is_written_and_read() -> None:
    plan = planned(**STRIPES, aperture=[0.8, 0.9])
    assert Plan.parse(plan.to_toml()) == plan
    assert plan.target.pixels == TargetPixels(
        pitch_mm=0.0962963, layout="rgb-stripes", aperture=(0.8, 0.9)
    )


def test_each_channel_sees_its_own_stripe_with_the_aperture_stated() -> None:
    plan = planned(pitch_mm=0.0962963, layout="bgr-rows", aperture=[0.8, 0.9])
    target = open_target(plan.target)
    shown = [as_shown(plan, target, name) for name in ("R", "G", "B")]
    assert [
        (s.place, s.lying, s.aperture) for s in shown if isinstance(s, PanelTarget)
    ] == [(place, True, (0.8, 0.9)) for place in (2, 1, 0)]
    assert as_shown(planned(), target, "G") is target
    with pytest.raises(PlanError, match='channel "M" is none of R, G and B'):
        as_shown(plan, target, "M")


def test_the_pitch_may_be_the_displays_and_must_not_contradict_it() -> None:
    shown = planned(DISPLAY, layout="rgb-stripes")
    assert pixels_per_cell(shown, open_target(shown.target)) == 2
    other = planned(DISPLAY, pitch_mm=0.1245)
    with pytest.raises(
        PlanError,
        match=r"pitch_mm = 0\.1245 contradicts .display., whose panel has pixels of 0.0963 mm",
    ):
        pixels_per_cell(other, open_target(other.target))
    missing = planned(layout="rgb-stripes")
    with pytest.raises(PlanError, match="pitch_mm is missing"):
        pixels_per_cell(missing, open_target(missing.target))


def test_a_cell_of_no_whole_number_of_pixels_is_refused() -> None:
    plan = planned(pitch_mm=0.0777)
    with pytest.raises(
        PlanError, match=r"target.pixels: .* does not fit pixels of 0.0777 mm.*pitch_mm"
    ):
        pixels_per_cell(plan, open_target(plan.target))


def test_a_flat_of_stripes_is_not_black_and_its_noise_not_the_stripes() -> None:
    rng, size = np.random.default_rng(3), (96, 128)
    mean = 3000 * lattice(0.42)[: size[0], : size[1]]
    plane = (600 + mean + 40 * rng.standard_normal(size)).astype(np.uint16)
    assert 5 * pixel_noise(plane) > 3000  # what it was refused for
    assert aperiodic_noise(plane) == pytest.approx(40, rel=0.12)  # measured: 6 % too small


def test_flats_of_stripes_still_tell_light_and_response(tmp_path: Path) -> None:
    bench, ranges = Bench(tmp_path), {2000.0: 0.21, 2200.0: 0.236}
    with bench.session:
        bench.add("dark", None, 0.0, 6)
        for range_mm, per_px in ranges.items():
            bench.add("flat", range_mm, 18000 * light_at(range_mm) * lattice(per_px), 6)
        target = bench.add("target", 2200.0, 1000.0)
        calibration = calibrate(bench.session.frames, bench.session.plan)
        mosaic = read_photograph(target.path, bench.session.plan.sensor)
        assert calibration.panel_seen
        assert (
            exposure_problem(
                read_photograph(bench.session.frames[8].path, bench.session.plan.sensor),
                "flat",
                "RGB",
            )
            is None
        )
        for name, gain in (("R", 0.45), ("G", 0.45), ("B", 0.45)):
            data = channel_data(calibration, target, mosaic, name)
            ratio = (data.illumination / (light_at(2200.0) * bench.sensor.response))[
                data.mask
            ]
            ratio /= ratio.mean()
            # measured: 0.0027 to 0.0037 where pixels differ by 0.006 and the stripes by 0.36
            assert ratio.std() < 0.006
            assert data.noise.gain == pytest.approx(gain, rel=0.02)
        assert calibration.response is not None
    assert calibration.response.std() == pytest.approx(PRNU, rel=0.2)


def test_a_flat_without_a_pattern_has_none() -> None:
    noise = 0.006 * np.random.default_rng(5).standard_normal((100, 120))
    assert repeating(noise, np.ones(noise.shape, bool)) is None


def test_a_pattern_is_found_wherever_it_is_aliased_to() -> None:
    truth = lattice(0.21)[::2, ::2] - 1
    noise = 0.006 * np.random.default_rng(5).standard_normal(truth.shape)
    found = repeating(truth + noise, np.ones(truth.shape, bool))
    assert found is not None
    # measured: 0.0032 inside and 0.010 with the rim, of 0.36
    assert np.std((found - truth)[12:-12, 12:-12]) < 0.006
    assert np.std(found - truth) < 0.02


def photographed(target: PanelTarget, colour: str, range_mm: float) -> Observation:
    """A carpet of 3 x 3 cells, 120 pixels a side, through a Gaussian."""
    size, noise = 150, np.random.default_rng(ord(colour))
    pose = Pose.from_corners(
        np.array([[15.3, 14.8], [15.9, 134.6], [135.2, 134.1], [134.7, 14.2]]),
        target.size_mm,
    )
    fine = np.arange(4 * size) / 4 - 0.375
    y, x = pose.to_target(fine[:, None], fine[None, :])
    seen = (
        target.radiance(y * target.size_mm[0] / 2, x * target.size_mm[1] / 2)
        .reshape(size, 4, size, 4)
        .mean(axis=(1, 3))
    )
    counts = 5000 * seen + 50 * noise.standard_normal(seen.shape)
    places = {
        "R": (slice(0, None, 2), slice(0, None, 2)),
        "B": (slice(1, None, 2), slice(1, None, 2)),
    }
    used = np.zeros(counts.shape, bool)
    used[places.get(colour, (slice(0, None, 2), slice(1, None, 2)))] = True
    frame = FrameData(counts, used, np.ones(counts.shape), np.zeros(counts.shape))
    blurred_pose = Pose.from_corners(
        pose.corners_px() + 0.3, target.size_mm
    )  # found to a third of a pixel
    return Observation(
        range_mm,
        range_mm,
        colour,
        ("a",),
        (frame,),
        (blurred_pose,),
        NoisePrior(1, 1, 1, 1),
        ((0, 0),),
        2,
    )


CARPET = CellTarget(
    np.asarray(np.kron(np.diag([0.0, 1.0, 0.0]), np.ones((3, 3))), float), (9.0, 9.0)
)


@pytest.fixture(scope="module", params=["rgb-stripes", "bgr-stripes", "rgb-rows"])
def seen(request: pytest.FixtureRequest) -> tuple[str, SeenPixels]:
    layout: str = request.param
    order, way = layout.split("-")
    shown = [
        photographed(
            PanelTarget.of(CARPET, (36, 36), order.index(c.lower()), lying=way == "rows"),
            c,
            500.0,
        )
        for c in "RGB"
    ]
    found = seen_pixels([first_view(o, CARPET) for o in shown], CARPET)
    assert found is not None
    return layout, found


def test_photographs_tell_pitch_and_layout(seen: tuple[str, SeenPixels]) -> None:
    layout, found = seen
    assert (found.per_cell, found.layout) == (4, layout)
    assert found.pitch_mm == pytest.approx(0.25)
    assert (
        f'pixels = {{ pitch_mm = 0.25, layout = "{layout}" }} to [target]'
        in found.finding.text
    )
    assert "\n" not in found.finding.text


def test_stripes_of_another_panel_are_refused(seen: tuple[str, SeenPixels]) -> None:
    layout, found = seen
    right = TargetPixels.from_tables({"pitch_mm": 0.25, "layout": layout})
    refuse_other_pixels(right, 4, found)
    with pytest.raises(
        PlanError, match=r"pitch_mm = 0.5, .*by them it is pixels = \{ pitch_mm = 0.25"
    ):
        refuse_other_pixels(right.model_copy(update={"pitch_mm": 0.5}), 2, found)
    turned = "bgr" if layout.startswith("rgb") else "rgb"
    with pytest.raises(PlanError, match=layout):
        refuse_other_pixels(
            right.model_copy(update={"layout": layout.replace(layout[:3], turned)}),
            4,
            found,
        )


def test_whole_pixels_show_nothing() -> None:
    whole = PanelTarget.of(CARPET, (36, 36), 1)
    plain = photographed(replace(whole, aperture=(3.0, 1.0)), "G", 500.0)
    assert seen_pixels([first_view(plain, CARPET)], CARPET) is None
