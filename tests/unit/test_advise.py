"""Advice before a capture, against closed forms and against what a session of that plan then gave."""

import json
from math import isfinite
from pathlib import Path

import numpy as np
import pytest

from labkit.advice.advise import Advice, advise, best_order, shortest
from labkit.advice.expected_fit import Setup
from labkit.advice.tables import session_rows
from labkit.cli import run
from labkit.demo import DEMO_PLAN
from labkit.errors import DataError, PlanError
from labkit.imaging.model import ForwardModel
from labkit.imaging.optics import Optics
from labkit.imaging.warp import Pose
from labkit.optics.lens import TELLING_STD
from labkit.panel.stripe_contrast import stripe_contrast
from labkit.plan import Plan
from labkit.plan.mode_groups import MODE_GROUPS
from labkit.target.target import open_target
from labkit.types import Floats
from tests.plans import PORTRAIT, plan_text

TEXT = DEMO_PLAN.format(address="simulated:")


@pytest.fixture(scope="module")
def plan() -> Plan:
    return Plan.parse(TEXT)


@pytest.fixture(scope="module")
def usual() -> Advice:
    """Of a small target in one channel, 70 mm f/2.8, from 3 m on, with the light of fifty photographs."""
    return advise(portrait("G", "RGGB"), ranges_mm=[3000.0, 3200.0, 3300.0], electrons=1e6)


@pytest.mark.slow
def test_errors_are_those_that_a_session_of_this_plan_had() -> None:
    # a simulated session of 59.2 mm f/4.1, two frames at each of two ranges, fitted: best focus of G +- 0.0224 mm,
    # f +- 0.354 mm, N +- 0.0238, mp +- 0.156, zero +- 9.00 mm
    lens = {"lens": {"focal_length_mm": 59.2, "f_number": 4.1}, "target": {"size_mm": 13.0}}
    sensor = {
        "sensor": {"pixel_pitch_um": 5.0, "fill_factor": 0.79},
        "fit": {"zernike_noll": [4, 15]},
    }
    colours = {
        "channel": [
            {"name": n, "wavelength_nm": nm}
            for n, nm in (("R", 630.0), ("G", 535.0), ("B", 455.0))
        ]
    }
    advice = advise(
        Plan.parse(plan_text(PORTRAIT, lens, sensor, colours)), ranges_mm=[1447.0, 1597.0]
    )
    assert advice.session is not None
    std = advice.session.std
    # one frame instead of two, and no errors of flats
    assert std["best_focus_mm.G"] == pytest.approx(0.0224, rel=0.3)
    assert std["focal_length_mm"] == pytest.approx(0.354, rel=0.05)
    assert std["f_number"] == pytest.approx(0.0238, rel=0.1)
    assert std["pupil_magnification"] == pytest.approx(0.156, rel=0.05)
    assert std["range_zero_mm"] == pytest.approx(9.0, rel=0.05)


@pytest.mark.slow
def test_what_the_ranges_hardly_tell_is_named_with_what_would_tell_it(
    usual: Advice,
) -> None:
    assert usual.session is not None
    assert "pupil_magnification" in usual.session.open_numbers()
    (tape,) = (remedy for remedy in usual.session.remedies if "tape" in remedy.what)
    assert tape in usual.session.worthwhile("pupil_magnification")
    assert tape not in usual.session.worthwhile(
        "range_zero_mm"
    )  # what one measures is no news of it
    told = f"a tape right to 1 mm would make it ± {tape.std['pupil_magnification']:.2g}"
    assert any(
        "hardly determine the pupil magnification" in note and told in note
        for note in usual.notes
    )


@pytest.mark.slow
def test_a_remedy_does_what_it_says(usual: Advice) -> None:
    assert usual.session is not None
    (tape,) = (remedy for remedy in usual.session.remedies if "tape" in remedy.what)
    taped = portrait("G", "RGGB").replace(fit={"range_zero_std_mm": 1.0})
    again = advise(taped, ranges_mm=[3000.0, 3200.0, 3300.0], electrons=1e6).session
    assert again is not None
    assert again.std == pytest.approx(tape.std)
    assert not any("tape" in remedy.what for remedy in again.remedies)


@pytest.mark.slow
def test_what_is_expected_is_said_in_rows(usual: Advice) -> None:
    rows = dict(session_rows(usual))
    assert usual.session is not None
    assert rows["best focus G"] == f"± {usual.best_focus_std_mm:.2g} mm"
    assert rows["focal length"].endswith("stated ± 1.4 mm")  # 2 % of 70 mm
    assert "with a tape right to 1 mm" in rows


def test_the_order_is_the_largest_that_an_airy_disc_resolves(plan: Plan) -> None:
    # 1.2197 * 450e-6 mm * 2.8 / 70 mm * 3200 mm = 0.0703 mm; 46.8 mm / 0.0703 mm = 666 = 3^5.9
    assert best_order(plan, 3200.0) == 5
    assert best_order(plan, 500.0) == 7


@pytest.mark.slow
def test_the_least_side_is_that_of_cells_as_wide_as_an_airy_radius(plan: Plan) -> None:
    (one,) = advise(plan, ranges_mm=[3200.0]).ranges
    assert one.size_mm == pytest.approx(3**5 * 0.0703, rel=1e-3)
    assert one.cell_airy == pytest.approx(46.8 / (3**5 * 0.0703), rel=1e-3)


@pytest.mark.slow
def test_a_display_is_resolved_from_where_its_pixels_span_an_airy_radius(
    plan: Plan,
) -> None:
    advice = advise(plan, ranges_mm=[3000.0])
    assert advice.nearest_mm == pytest.approx(25.4 / 264 / (0.0703 / 3200), rel=1e-3)
    assert any(
        "display's own pixels will be seen with 2% of contrast" in note
        for note in advice.notes
    )
    far = advise(plan, ranges_mm=[5000.0])  # the lens blurs them
    assert not any("display's own pixels" in note for note in far.notes)


def test_the_contrast_of_stripes_is_that_of_their_first_harmonic_through_lens_and_pixel(
    plan: Plan,
) -> None:
    (one,) = (plan.replace(channel=[{"name": "G", "wavelength_nm": 550.0}]),)
    at_mm = 70.0 / (1000 - 70) * 0.1  # a pitch of 0.1 mm on the sensor
    s = 1 / at_mm * 0.55e-3 * 2.8 * (1 + 70 / 930)
    lens = 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s**2))  # Goodman (6-34)
    lit = np.arange(1000) < 850 / 3
    harmonic = (
        2 * abs(np.mean(lit * np.exp(-2j * np.pi * np.arange(1000) / 1000))) / np.mean(lit)
    )
    expected = harmonic * lens * abs(np.sinc(4.78e-3 / at_mm))
    assert stripe_contrast(one, 0.1, 1000.0, 0.0) == pytest.approx(expected, rel=2e-3)
    assert stripe_contrast(one, 0.1, 1000.0, 0.5) < 0.1 * expected


def test_cells_finer_than_the_displays_pixels_are_named(plan: Plan) -> None:
    small = plan.replace(target={"size_mm": 15.0})
    assert any(
        "finer than the display's pixels" in note
        for note in advise(small, ranges_mm=[3000.0]).notes
    )


def test_far_away_the_magnification_is_not_determined() -> None:
    advice = advise(
        portrait("G", "RGGB").replace(target={"size_mm": 156.0}),
        ranges_mm=[30000.0, 32000.0, 34000.0],
    )
    assert not advice.magnification_determined
    assert advice.magnification_std is not None
    assert advice.magnification_std > TELLING_STD


@pytest.mark.slow
def test_errors_fall_with_the_square_root_of_light(plan: Plan) -> None:
    dim, bright = (
        advise(plan, ranges_mm=[3200.0], electrons=e).ranges[0] for e in (4e4, 16e4)
    )
    assert dim.std_wavefront_waves / bright.std_wavefront_waves == pytest.approx(
        2.0, rel=0.02
    )


@pytest.mark.slow
def test_photographs_for_an_error_that_is_wanted(plan: Plan) -> None:
    now = advise(plan, ranges_mm=[3200.0]).ranges[0].std_wavefront_waves
    assert advise(plan, ranges_mm=[3200.0], want_waves=now / 3).frames == pytest.approx(
        9 * 2, abs=1
    )
    assert advise(plan, ranges_mm=[3200.0], want_waves=10 * now).frames == 1


@pytest.mark.slow
def test_ranges_that_are_proposed_determine_the_magnification(usual: Advice) -> None:
    assert not usual.magnification_determined
    small = portrait("G", "RGGB").replace(target={"size_mm": 3.0})
    proposed = advise(small, ranges_mm=usual.proposed_ranges_mm, electrons=1e6)
    assert proposed.magnification_determined
    assert proposed.proposed_ranges_mm == ()


@pytest.mark.slow
def test_a_lone_range_gives_no_focus(plan: Plan) -> None:
    advice = advise(plan, ranges_mm=[3000.0])
    assert advice.best_focus_std_mm is None
    assert advice.magnification_std is None


@pytest.mark.slow
def test_a_pattern_that_determines_nothing_is_a_note_and_no_error(tmp_path: Path) -> None:
    (tmp_path / "grey.pgm").write_bytes(b"P5\n4 4\n255\n" + bytes([255] * 16))
    image = 'kind = "image"\nfile = "grey.pgm"\nsize_mm = 46.8\nsurround = "white"\n'
    text = TEXT[: TEXT.index('kind = "sierpinski"')] + image + TEXT[TEXT.index("\n[fit]") :]
    advice = advise(Plan.parse(text, tmp_path), ranges_mm=[3000.0])
    assert not isfinite(advice.ranges[0].std_defocus_waves)
    assert any("do not determine" in note for note in advice.notes)
    assert advice.as_json()["ranges"][0]["std_defocus_waves"] is None


def test_what_cannot_be_advised_on(plan: Plan) -> None:
    with pytest.raises(PlanError, match="no ranges"):
        advise(plan.replace(rail=None))
    with pytest.raises(PlanError, match="more than the focal length, 70 mm"):
        advise(plan, ranges_mm=[60.0])
    with pytest.raises(PlanError, match="range nan mm: allowed"):
        advise(plan, ranges_mm=[float("nan")])
    with pytest.raises(DataError, match="wanted error = 0 waves: allowed"):
        advise(plan, want_waves=0.0)
    with pytest.raises(DataError, match="electrons = inf: allowed"):
        advise(plan, electrons=float("inf"))


@pytest.mark.slow
def test_the_command_answers_as_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "plan.toml").write_text(portrait("G", "RGGB").to_toml())
    ranges = ["--range", "3000", "--range", "3300"]
    assert run(["advise", str(tmp_path / "plan.toml"), *ranges, "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert [one["range_mm"] for one in answer["ranges"]] == [3000.0, 3300.0]
    assert answer["session"]["std"]["best_focus_mm.G"] == answer["best_focus_std_mm"]
    assert answer["session"]["stated"]["range_zero_mm"] == 10.0
    assert run(["advise", str(tmp_path / "none.toml")]) == 2


SIDE, ELECTRONS, READ_VARIANCE = 94, 2e4, 9.0


def portrait(name: str, cfa_pattern: str | None) -> Plan:
    """One channel at 600 nm and four modes; the target spans 77.96 pixels at 3000 mm."""
    channel = {"channel": [{"name": name, "wavelength_nm": 600.0}]}
    return Plan.parse(
        plan_text(
            PORTRAIT,
            channel,
            {"sensor": {"cfa_pattern": cfa_pattern}, "fit": {"zernike_noll": [4, 7]}},
        )
    )


def brute_force_std(plan: Plan, name: str, cell: str) -> float:
    """Bound of defocus by finite differences of the picture, pixel by pixel over those whose filter is of that colour."""
    optics = Optics(
        wavelength_nm=600.0,
        reference_nm=600.0,
        f_number=2.8 * (1 + 70 / 2930),  # of the cone, the lens focused at 3 m
        pitch_um=4.78,
        active_um=4.78,
        noll=(4, 5, 6, 7),
    )
    px = 15.6 * 70 / (3000 - 70) / 4.78e-3
    turn = np.array([[np.cos(0.02), -np.sin(0.02)], [np.sin(0.02), np.cos(0.02)]])
    corners = (
        np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]]) * px / 2 @ turn
        + (SIDE - 1) / 2
        + 0.3
    )
    pose = Pose.from_corners(corners, (15.6, 15.6))
    model = ForwardModel.build(optics, open_target(plan.target), (SIDE, SIDE), pose)
    pixels = np.array(
        [
            [cell[2 * (row % 2) + col % 2] == name for col in range(SIDE)]
            for row in range(SIDE)
        ]
    )

    def mean(step: Floats) -> Floats:
        waves = np.array([0.01, 0.025, 0.025, 0.025]) + step[:4]
        (image,) = model.means(waves, model.draw([pose.moved(step[4:12])]), [pixels])
        return np.asarray((ELECTRONS + step[12]) * image + step[13])

    steps = np.diag([1e-4] * 4 + [1e-4] * 8 + [1.0, 0.1])
    by = np.array([(mean(step) - mean(-step)) / (2 * step.sum()) for step in steps])
    light = mean(np.zeros(14))
    variance = light + READ_VARIANCE
    by = np.concatenate([by, np.zeros((2, light.size))])
    variance_by = np.concatenate([by[:14], [light, np.full(light.size, READ_VARIANCE)]])
    information = (by / variance) @ by.T + (variance_by / variance**2) @ variance_by.T / 2
    information += np.diag([0.0] * 14 + [0.02**-2, 0.1**-2])
    return float(np.sqrt(np.linalg.inv(information)[0, 0]))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "cfa_pattern", "cell"),
    [
        ("R", "RGGB", "RGGB"),
        ("G", "RGGB", "RGGB"),
        ("B", "GBRG", "GBRG"),
        ("G", None, "RGGB"),
        ("L", "mono", "LLLL"),
        ("G", "mono", "GGGG"),
    ],
)
def test_errors_are_those_of_the_channels_pixels_alone(
    name: str, cfa_pattern: str | None, cell: str
) -> None:
    plan = portrait(name, cfa_pattern)
    (at,) = advise(plan, ranges_mm=[3000.0], electrons=ELECTRONS).ranges
    # finite differences of 1e-4; the condition of the information takes a few digits more
    assert at.std_defocus_waves == pytest.approx(
        brute_force_std(plan, name, cell), rel=1e-3
    )


@pytest.mark.parametrize(
    ("name", "cfa_pattern", "times"),
    [("L", "mono", 1.0), ("G", "RGGB", 2**0.5), ("R", "RGGB", 2.0)],
)
def test_a_channel_with_fewer_pixels_is_sampled_more_coarsely(
    name: str, cfa_pattern: str, times: float
) -> None:
    # a pixel of 4.78 um, and Nyquist's 0.6 um * 2.8 / 2
    notes = advise(portrait(name, cfa_pattern), ranges_mm=[3000.0]).notes
    assert any(
        f"{times * 4.78 / 0.84:.1f} times as far apart as Nyquist" in note for note in notes
    )


@pytest.mark.parametrize(
    ("name", "assumed"), [("G", "a Bayer filter array"), ("L", "a mono sensor")]
)
def test_a_filter_array_that_is_assumed_is_noted(name: str, assumed: str) -> None:
    assert any(
        f"assumed is {assumed}" in note
        for note in advise(portrait(name, None), ranges_mm=[3000.0]).notes
    )
    assert not any(
        "assumed" in note
        for note in advise(portrait(name, "mono"), ranges_mm=[3000.0]).notes
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("electrons", "last"),
    [(2e4, 36), (6e3, 15), (1e3, 0)],
)
def test_modes_are_told_as_far_as_the_light_reaches(
    plan: Plan, electrons: float, last: int
) -> None:
    """The bound of all modes up to the last one keeps to 0.01 waves, that of the next group does not."""
    advice = advise(plan, ranges_mm=[3200.0], electrons=electrons)
    assert advice.determined_noll == last
    setup = Setup.of(plan, [3200.0], electrons)
    for end in (15, *(group.last for group in MODE_GROUPS.values())):
        noll = tuple(range(4, end + 1))
        fit = setup.fit(shortest(plan), 3200.0, setup.defocus(3200.0), noll)
        assert (max(fit.bound.std[: len(noll)]) <= 0.01) == (end <= last)


def test_the_pixels_that_a_grid_takes_are_noted(plan: Plan) -> None:
    grid = {"size_mm": 46.8, "grid": [2, 3], "pitch_mm": 70.2}
    notes = advise(plan.replace(target=grid)).notes
    (words,) = [note for note in notes if "the grid spans" in note]
    # 117 × 187.2 mm through a thin lens of 70 mm at 3 m, on pixels of 4.78 um
    side = 70 / (min(plan.rail.ranges_mm) - 70) / 4.78e-3 if plan.rail else 0.0
    assert f"{117 * side:.0f} × {187.2 * side:.0f} pixels" in words


def test_a_grid_that_the_display_cannot_hold_is_noted(plan: Plan) -> None:
    grid = {"size_mm": 46.8, "grid": [9, 9], "pitch_mm": 70.2}
    notes = advise(plan.replace(target=grid)).notes
    # 148 × 197 mm of an iPad
    assert [note for note in notes if "it holds grid = [2, 3] of them" in note]
