"""The targets beside the carpet, against closed forms and countings of their own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from labkit.errors import PlanError, TargetError
from labkit.plan import Plan, TargetSpec
from labkit.target.rendering import render_target
from labkit.target.target import CellTarget, open_target, read_spec
from labkit.targets.noise import noise_cells
from labkit.targets.slanted_edge import SlantedEdge
from labkit.targets.tribar import tribar_cells, triple
from labkit.types import Floats
from tests.plans import PORTRAIT, plan_text

KINDS = [
    "tribar:order=3,size_mm=25.4",
    "checkerboard:cells=9,size_mm=25.4",
    "noise:cells=32,size_mm=25.4",
]


def right_of_edge_transform(
    side: float, slope: float, nu_y: Floats, nu_x: Floats
) -> Floats:
    """Fourier transform of the white part of a square: along x between edge and side, then along y, by hand."""
    y, x = nu_y[:, None], np.where(nu_x == 0, 1e-7, nu_x)[None, :]
    edge, end = (
        np.sinc(side * (y + slope * x)),
        np.exp(-1j * np.pi * x * side) * np.sinc(side * y),
    )
    return np.asarray(side * (edge - end) / (2j * np.pi * x))


@pytest.mark.parametrize("angle_deg", [-40.0, 5.0, 45.0])
def test_a_slanted_edge_has_its_own_fourier_series_in_the_pass_band_and_nothing_beyond_the_stop_band(
    angle_deg: float,
) -> None:
    side, bandwidth, n = 6.0, 3.0, 216
    at = (np.arange(n) - n // 2) * 24.0 / n
    target = SlantedEdge(side, angle_deg)
    got = np.fft.fft2(np.fft.ifftshift(target.sample(at, at, bandwidth))) * (24.0 / n) ** 2
    nu = np.fft.fftfreq(n, 24.0 / n)
    passed, stopped = np.abs(nu) <= bandwidth, np.abs(nu) > 1.3 * bandwidth
    want = right_of_edge_transform(
        side, np.tan(np.radians(angle_deg)), nu[passed], nu[passed]
    )
    # 1e-4 of the filter in each axis, relative to the strongest line
    assert np.max(np.abs(got[np.ix_(passed, passed)] - want)) < 2e-4 * np.max(np.abs(want))
    assert np.max(np.abs(got[stopped])) < 1e-4 * np.max(np.abs(want))


@pytest.mark.parametrize("surround", [0.0, 1.0])
def test_an_upright_edge_is_two_cells(surround: float) -> None:
    y, x = np.linspace(-4, 4, 41), np.linspace(-5, 5, 37)
    cells = CellTarget(np.array([[0.0, 1.0]]), (6.0, 6.0), surround)
    # the kernel ends with a step of 2.3 / (pi 2.3 9.06) / I0(8.6) = 5e-5, which Gauss's rule misplaces by up to 1/12
    np.testing.assert_allclose(
        SlantedEdge(6.0, 0.0, surround).sample(y, x, 2.0),
        cells.sample(y, x, 2.0),
        rtol=0,
        atol=4e-6,
    )


def test_a_slanted_edge_is_white_on_its_right_and_leans_right_below() -> None:
    target = SlantedEdge(10.0, 45.0, surround=None)
    points = target.radiance(
        np.array([-2.0, -2.0, 2.0, 2.0, 0.0]), np.array([-3.0, -1.0, 1.0, 3.0, 6.0])
    )
    np.testing.assert_array_equal(points, [0, 1, 0, 1, 0])


def test_three_bars_are_five_times_as_long_as_wide_and_a_width_apart() -> None:
    bars = triple()
    line = "".join("W" if value else "." for value in bars[5])
    assert line == ".WW..WW..WW."
    assert bars[:, 1].sum() == 5 * 2


def test_each_octave_of_bars_is_half_as_large_as_the_one_above() -> None:
    cells = tribar_cells(3)
    assert cells.shape == (96, 96)
    np.testing.assert_array_equal(cells[48:, :48], tribar_cells(2))
    assert set(np.flatnonzero(np.diff(cells[24, :48])) + 1) == {
        4,
        12,
        20,
        28,
        36,
        44,
    }  # bars of 8 cells


def test_a_checkerboard_changes_colour_at_every_square() -> None:
    target = open_target(TargetSpec(kind="checkerboard", cells=5, size_mm=10.0))
    assert isinstance(target, CellTarget)
    assert target.cells[0, 0] == 1
    assert np.all(np.diff(target.cells, axis=0) != 0)
    assert np.all(np.diff(target.cells, axis=1) != 0)


def test_noise_of_a_seed_stays_what_it_was_printed_as() -> None:
    rows = ["".join("W" if value else "." for value in row) for row in noise_cells(6, 1)]
    assert rows == ["WW.W..", "W.W.WW", ".W....", "..W..W", "WWW..W", "W.WWWW"]
    assert not np.array_equal(noise_cells(6, 1), noise_cells(6, 2))


def test_noise_is_white_half_the_time() -> None:
    # 65536 tosses: the mean's standard deviation is 0.00195; allow four of them
    assert abs(noise_cells(256, 0).mean() - 0.5) < 4 * 0.5 / 256


@pytest.mark.parametrize("spec", KINDS)
def test_a_printed_target_holds_every_cell_at_its_true_size(
    spec: str, tmp_path: Path
) -> None:
    target = open_target(read_spec(spec))
    assert isinstance(target, CellTarget)
    made = render_target(target, tmp_path / "target.png", pixels=2 * target.cells.shape[0])
    with Image.open(made.path) as picture:
        np.testing.assert_array_equal(
            np.asarray(picture), np.kron(255 * target.cells, np.ones((2, 2)))
        )
        # a PNG holds whole pixels per metre
        assert made.pixels[0] / picture.info["dpi"][0] == pytest.approx(1.0, rel=1 / 1000)
    page = render_target(target, tmp_path / "target.pdf").path.read_bytes()
    assert b"/MediaBox [ 0 0 72 72 ]" in page  # 25.4 mm = 1 inch = 72 points


def test_a_target_without_cells_is_printed_finely(tmp_path: Path) -> None:
    target = open_target(read_spec("slanted_edge:angle_deg=5,size_mm=25.4"))
    made = render_target(target, tmp_path / "edge.png")
    assert made.pixels == (600, 600)
    assert (
        made.notes[0] == "what is not upright is drawn in steps of a dot, 42.3 um"
    )  # an inch over 600
    assert (
        b"/MediaBox [ 0 0 72 72 ]"
        in render_target(target, tmp_path / "edge.pdf").path.read_bytes()
    )


PLAN = plan_text(PORTRAIT, {"target": {"kind": None, "order": None, "size_mm": 30.0}})


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        ('kind = "tribar"', r'target\.order is missing: kind = "tribar" needs it'),
        (
            'kind = "checkerboard"',
            r'target\.cells is missing: kind = "checkerboard" needs it',
        ),
        (
            'kind = "noise"\ncells = 0',
            r"target\.cells = 0: allowed is a whole number, 1 to 4096",
        ),
        (
            'kind = "noise"\ncells = 9\nseed = -1',
            r"target\.seed = -1: allowed is a whole number, 0 to 4294967295",
        ),
        (
            'kind = "slanted_edge"\nangle_deg = 60',
            r"target\.angle_deg = 60.*: allowed is a number, -45 to 45",
        ),
    ],
)
def test_a_plan_that_lacks_what_its_target_needs_is_refused_in_one_line(
    lines: str, says: str, tmp_path: Path
) -> None:
    with pytest.raises(PlanError, match=says) as caught:
        Plan.parse(PLAN + lines, tmp_path)
    assert "\n" not in str(caught.value)


def test_an_edge_beyond_its_angles_is_refused() -> None:
    with pytest.raises(TargetError, match="-45 to 45 degrees"):
        SlantedEdge(10.0, 46.0)
