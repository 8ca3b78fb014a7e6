"""Disks against the closed form of their Fourier transform, and against a count of points."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import j1

from labkit.errors import PlanError, TargetError
from labkit.plan import TargetSpec
from labkit.target.target import open_target
from labkit.targets.disks import Disks


def test_a_disk_has_its_own_fourier_series_in_the_pass_band_and_nothing_beyond_the_stop_band() -> (
    None
):
    bandwidth, n, period = 2.0, 192, 32.0
    at = (np.arange(n) - n // 2) * period / n
    target = Disks((2, 3), 4.0, 2.5, surround=1.0)
    got = (
        np.fft.fft2(np.fft.ifftshift(1 - target.sample(at, at, bandwidth)))
        * (period / n) ** 2
    )
    nu = np.fft.fftfreq(n, period / n)
    passed, stopped = np.abs(nu) <= bandwidth, np.abs(nu) > 1.3 * bandwidth
    rho = np.hypot(nu[:, None], nu[None, :]) + 1e-9
    one = (
        1.25 * j1(2 * np.pi * 1.25 * rho) / rho
    )  # of a disk of radius 1.25 (Born and Wolf, 8.5.2)
    rows = 2 * np.cos(2 * np.pi * 2 * nu)[:, None]  # two rows at -2 and 2 mm
    cols = (1 + 2 * np.cos(2 * np.pi * 4 * nu))[None, :]  # three columns at -4, 0 and 4 mm
    want = one * rows * cols
    # 1e-4 of the filter in each axis, relative to the strongest line
    assert np.max(np.abs(got - want)[np.ix_(passed, passed)]) < 2e-4 * np.max(np.abs(want))
    assert np.max(np.abs(got[stopped])) < 1e-4 * np.max(np.abs(want))


@pytest.mark.parametrize(("surround", "around"), [(0.0, 0.0), (1.0, 1.0), (None, 0.0)])
def test_points_are_black_in_disks_and_white_between_them(
    surround: float | None, around: float
) -> None:
    target = Disks((2, 3), 4.0, 2.5, surround)
    assert target.size_mm == (8.0, 12.0)
    points = target.radiance(
        np.array([-2.0, 2.0, 0.0, -2.0, -2.0, 4.5]),
        np.array([-4.0, 4.9, 0.0, -2.7, -2.8, 0.0]),
    )
    np.testing.assert_array_equal(points, [0, 0, 1, 1, 0, around])


def test_far_from_edges_the_filter_changes_nothing() -> None:
    target = Disks((1, 1), 30.0, 10.0, 0.0)  # the filter reaches 9.06 / 3 mm
    np.testing.assert_allclose(
        target.sample([0.0, 10.0, 20.0], [0.0], 3.0)[:, 0], [0, 1, 0], atol=4e-6
    )


def test_a_plan_gives_rows_columns_and_diameter() -> None:
    target = open_target(
        TargetSpec(
            kind="disks", size_mm=45.0, grid=(5, 6), diameter_mm=4.0, surround="unknown"
        )
    )
    assert target == Disks((5, 6), 9.0, 4.0)
    with pytest.raises(PlanError, match=r'diameter_mm is missing: kind = "disks" needs it'):
        TargetSpec.from_tables({"kind": "disks", "size_mm": 45.0, "grid": [5, 6]})
    with pytest.raises(
        TargetError, match=r"of 9 mm, 9 mm apart: allowed are .* below their distance"
    ):
        open_target(TargetSpec(kind="disks", size_mm=45.0, grid=(5, 6), diameter_mm=9.0))
