"""PSFs and residuals of thousands of fits: files that do not grow without bound."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labkit.results import Results, Wavefront, arrays
from tests.results_samples import REJECTED, a_wavefront, written


def fits(count: int) -> tuple[Wavefront, ...]:
    return tuple(a_wavefront(tile=(0, k)) for k in range(count))


def test_windows_become_narrower_for_many_fits_and_never_narrower_than_the_least() -> None:
    # 32 and 8 wavelengths times the f-number, six samples each, to both sides
    assert arrays.psf_size(6.0, 249) == 385
    assert arrays.psf_size(6.0, 1000) == 259
    assert arrays.psf_size(6.0, 9000) == 97
    for count in (1, 250, 1000, 3000, 9000):
        size = arrays.psf_size(6.0, count)
        assert size % 2 == 1
        assert size == 97 or 4 * count * size**2 <= arrays.MOST_PSF_BYTES


def test_every_fit_keeps_its_psf_in_a_window_of_unit_sum(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(arrays, "MOST_PSF_BYTES", 3 * 4 * 101**2)
    folder = written(tmp_path, wavefronts=fits(3))
    with np.load(folder / "psf.npz") as kept:
        psfs = [kept[f"psf_3000_R_0_{k}"] for k in range(3)]
        assert set(kept) == {"spacing_um", *(f"psf_3000_R_0_{k}" for k in range(3))}
    for psf in psfs:
        assert psf.shape == (101, 101)
        assert psf.sum() == pytest.approx(1, abs=1e-5)
    assert (folder / "psf.npz").stat().st_size < arrays.MOST_PSF_BYTES + 2000


def test_residuals_beyond_the_room_are_of_doubtful_fits_and_an_even_sample(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    many = list(fits(16))
    many[5] = replace(many[5], test=REJECTED)
    residuals = many[0].residuals
    assert residuals is not None
    monkeypatch.setattr(arrays, "MOST_RESIDUAL_BYTES", 5 * 12 * residuals.data.size)
    folder = written(tmp_path, wavefronts=tuple(many))
    again = Results.load(folder)
    kept = [w.tile[1] for w in again if w.residuals is not None and w.tile is not None]
    assert kept == [0, 4, 5, 8, 12]
    assert len(again) == 16
