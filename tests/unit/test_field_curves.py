"""MTF over the field and through focus: directions, sides, and errors, by closed forms and by draws."""

from dataclasses import replace

import numpy as np
import pytest

from labkit.field.curves import Profile, profiles, usable_frequencies
from labkit.field.focus_curves import through_focus
from labkit.field.places import field_points, line_end_mm
from labkit.field.surfaces import focus_um
from labkit.optics.field import FieldModel
from labkit.optics.psf import diffraction_mtf
from tests.field_samples import FRAME, NOLL, a_field, drawn


def a_lens(std: float = 0.002) -> FieldModel:
    """Curvature, tilt, astigmatism and coma over the field, of 0.03 waves or so."""
    waves = np.random.default_rng(2).normal(0, 0.03, (1, 6, len(NOLL)))
    return a_field(waves, std)


def test_a_perfect_lens_has_the_diffraction_mtf_everywhere() -> None:
    frequency = np.array([10.0, 20.0, 40.0])
    for profile in profiles(a_field(), "G", frequency, places=3):
        expected = diffraction_mtf(frequency * 540e-6 * 4.0)
        assert profile.mtf.value == pytest.approx(np.tile(expected[:, None], 3), abs=1e-6)


def test_profiles_run_through_the_centre_to_both_edges_at_four_azimuths_or_more() -> None:
    found = profiles(a_lens(), "G", [20.0], places=3)
    azimuths = {profile.azimuth_deg for profile in found}
    diagonal = np.rad2deg(np.arctan2(512, 768))
    assert {0.0, 45.0, 90.0, 135.0, diagonal, 180 - diagonal} == azimuths
    half_mm = {0.0: 768 / 2, 90.0: 512 / 2, 45.0: 512 / np.sqrt(2)}
    for profile in found:
        assert profile.height_mm[1] == 0
        assert profile.height_mm[0] == -profile.height_mm[2]
        if profile.azimuth_deg in half_mm:
            end_mm = half_mm[profile.azimuth_deg] * 5.2e-3
            assert profile.height_mm[2] == pytest.approx(end_mm)
    assert line_end_mm(FRAME, diagonal) == pytest.approx(FRAME.radius_mm)


def by(found: tuple[Profile, ...], azimuth_deg: float, surface: str) -> Profile:
    return next(p for p in found if (p.azimuth_deg, p.surface) == (azimuth_deg, surface))


def test_sides_are_not_folded_and_positive_heights_are_along_the_azimuth() -> None:
    model = a_field()
    # the focus error grows to the right: best focus is left of the centre
    model.waves[0, 0, 0] = 0.1
    model.waves[0, 1, 0] = 0.1
    across = by(profiles(model, "G", [40.0], places=5), 0.0, "tangential")
    assert np.all(np.diff(across.focus_um.value) > 0)
    assert across.mtf.value[0, 0] > across.mtf.value[0, -1] + 0.1
    down = by(profiles(model, "G", [40.0], places=5), 90.0, "tangential")
    assert down.mtf.value[0] == pytest.approx(np.full(5, down.mtf.value[0, 0]))


def test_astigmatism_parts_the_peaks_of_sagittal_and_tangential_mtf() -> None:
    """The through-focus MTF is computed from the pupil, focus from the modes."""
    model = a_field()
    model.waves[0, 0, :3] = 0.05, 0.06, -0.08
    model.waves[0, 3, 0] = 0.04
    points = field_points(FRAME)
    for curve in through_focus(model, "G", [30.0], points):
        place = points[curve.place]
        focus = focus_um(model, "G", place, curve.surface)[0]
        # the spline of 41 positions is good to a hundredth of a step of 11 um
        assert curve.best_um.value == pytest.approx(-focus, abs=0.1)


def test_the_sensor_moved_to_a_curves_peak_has_the_peaks_mtf() -> None:
    model = a_lens()
    (curve,) = (
        c
        for c in through_focus(model, "G", [30.0])
        if (c.place, c.surface) == ("right", "tangential")
    )
    moved = profiles(model, "G", [30.0], [0.0], 3, curve.best_um.value)
    right = by(moved, 0.0, "tangential")
    assert right.mtf.value[0, -1] == pytest.approx(curve.mtf.value.max(), abs=2e-3)
    there = np.interp(0.0, curve.shift_um, curve.mtf.value)
    still = by(profiles(model, "G", [30.0], [0.0], 3), 0.0, "tangential")
    assert still.mtf.value[0, -1] == pytest.approx(there, abs=2e-3)


def test_a_curve_without_a_peak_has_no_best_focus() -> None:
    curves = through_focus(a_field(), "G", [40.0], shift_um=[100.0, 110.0, 120.0, 130.0])
    assert {str(curve.best_um) for curve in curves} == {"not determined um"}


def test_errors_of_mtf_over_the_field_are_those_of_drawn_fields() -> None:
    model = a_lens()
    rng = np.random.default_rng(4)
    arguments = ("G", [10.0, 40.0], [45.0], 3)
    stated = profiles(model, *arguments)
    draws = [profiles(drawn(model, rng), *arguments) for _ in range(600)]
    # the standard deviation of 600 draws has an error of 2.9 %
    for place, profile in enumerate(stated):
        values = np.array([draw[place].mtf.value for draw in draws])
        assert values.std(axis=0) == pytest.approx(profile.mtf.std, rel=0.1)
        halves = np.array([draw[place].mtf50_per_mm.value for draw in draws])
        assert halves.std(axis=0) == pytest.approx(profile.mtf50_per_mm.std, rel=0.1)
        focus = np.array([draw[place].focus_um.value for draw in draws])
        assert focus.std(axis=0) == pytest.approx(profile.focus_um.std, rel=0.1)


def test_errors_through_focus_are_those_of_drawn_fields() -> None:
    model = a_lens()
    rng = np.random.default_rng(6)
    points = {"right": field_points(FRAME)["right"]}
    shifts = np.linspace(-120, 120, 25)
    stated = through_focus(model, "G", [20.0], points, shifts)
    draws = [
        through_focus(drawn(model, rng), "G", [20.0], points, shifts) for _ in range(600)
    ]
    for place, curve in enumerate(stated):
        values = np.array([draw[place].mtf.value for draw in draws])
        # near the peak the MTF is quadratic in defocus
        steep = curve.mtf.std > 0.3 * curve.mtf.std.max()
        assert steep.sum() > 10
        assert values.std(axis=0)[steep] == pytest.approx(curve.mtf.std[steep], rel=0.1)
        best = [draw[place].best_um.value for draw in draws]
        assert np.std(best) == pytest.approx(curve.best_um.std, rel=0.1)


def test_the_cone_widens_the_errors_of_curves_through_focus() -> None:
    model = replace(a_lens(std=1e-9), f_number_std=0.02)
    model.waves[0, 0, 0] = 0.1
    points = {"right": field_points(FRAME)["right"]}
    shifts = np.linspace(-120, 120, 25)
    at = [
        through_focus(replace(model, f_number=n), "G", [40.0], points, shifts)[0]
        for n in (3.98, 4.0, 4.02)
    ]
    change = np.abs(at[2].mtf.value - at[0].mtf.value) / 2
    assert change == pytest.approx(at[1].mtf.std, rel=0.01, abs=2e-6)
    best = (at[0].best_um.value - at[2].best_um.value) / 2
    assert best == pytest.approx(at[1].best_um.std, rel=0.1)


def test_frequencies_beyond_the_cutoff_or_nyquist_are_left_out_and_said() -> None:
    kept, notes = usable_frequencies(a_field(), "G", (10, 40, 100, 500))
    assert kept.tolist() == [10, 40]
    assert notes == (
        "100 cycles/mm is left out in G: above the Nyquist frequency of the sensor, 96 cycles/mm",
        "500 cycles/mm is left out in G: above the cutoff of the lens, 463 and the "
        "Nyquist frequency of the sensor, 96 cycles/mm",
    )
