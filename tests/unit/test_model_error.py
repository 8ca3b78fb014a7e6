"""What a missing part would move is a bias of the lens; and the fit with it vouches for the optimum. Fits are played."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labkit.analysis.lens_fit import fit_lens
from labkit.analysis.local_fits import LocalFit
from labkit.analysis.model_error import confirmed, shift, with_model_error
from labkit.analysis.session_fits import SessionFits
from labkit.inference.fit import WavefrontFit
from tests.unit.test_adopted_parts import names, session

MOVED = 0.004  # waves of defocus


def moved(fit: WavefrontFit, waves: float) -> WavefrontFit:
    """The fit with its defocus moved."""
    values = fit.measured.values + np.eye(len(fit.measured.values))[0] * waves
    return replace(
        fit, state=replace(fit.state, waves=fit.waves + waves), measured=replace(fit.measured, values=values)
    )


@pytest.fixture(scope="module")
def plain() -> SessionFits:
    """Two ranges whose fits call for a smear that would move defocus at both."""
    fits = session(lambda task, again: 100.0 * names(task).count("smear"), square=0.5, diagnose=False)
    fuller = list[LocalFit | None]()
    for here, there in zip(fits.fits, fits.with_missing, strict=True):
        assert there is not None
        near = there.fit if there.fit.waves[0] * here.fit.waves[0] > 0 else there.fit.twin()
        fuller.append(LocalFit(there.task, moved(near, MOVED)))
    return replace(fits, with_missing=tuple(fuller))


def test_the_lens_leans_by_what_the_part_would_move(plain: SessionFits) -> None:
    assert plain.lens is not None
    leaning = with_model_error(plain).lens
    assert leaning is not None
    assert leaning.lean is not None
    at = leaning.model.index("best focus", "G")
    # both ranges' defocus grows by as much: the crossing moves by that over the slope, which two ranges give
    first, last = leaning.model.members
    rise = last.measured.waves[0] - first.measured.waves[0]
    slope = rise / (last.stop - first.stop)
    assert leaning.lean[at] == pytest.approx(-MOVED / slope, rel=0.05)
    assert leaning.std("best focus", "G") > abs(leaning.lean[at]) > 3 * plain.lens.std("best focus", "G")


def test_a_part_that_gave_way_to_the_missing_one_is_none_there(plain: SessionFits) -> None:
    """Both fits have a filter, 0.2 pixels squared, and none once they have the smear."""

    def filtered(local: LocalFit) -> LocalFit:
        measured = local.fit.measured
        covariance = np.diag(np.insert(np.diag(measured.covariance), 1, 1e-4))
        values = np.insert(measured.values, 1, 0.2)
        return replace(
            local,
            fit=replace(
                local.fit,
                measured=replace(
                    measured,
                    values=values,
                    covariance=covariance,
                    calibration=0 * covariance,
                    parts=("low_pass_filter.rows_px2",),
                ),
            ),
        )

    fits = tuple(map(filtered, plain.fits))
    assert plain.lens is not None
    lens = fit_lens([fits[k].member for k in plain.members], plain.lens.model.stated)
    leaning = with_model_error(replace(plain, fits=fits, lens=lens)).lens
    assert leaning is not None
    assert leaning.lean is not None
    assert leaning.lean[leaning.model.index("part", "low_pass_filter.rows_px2")] == pytest.approx(-0.2, rel=0.01)


def test_a_session_that_lacks_nothing_stays_as_it_is(plain: SessionFits) -> None:
    whole = replace(plain, with_missing=(None, None))
    assert with_model_error(whole) is whole
    assert not confirmed(whole, 0)


def test_the_nearer_twin_counts(plain: SessionFits) -> None:
    fit = plain.fits[0].fit
    modes, cone = shift(fit, moved(fit, MOVED).twin())
    assert modes == pytest.approx([MOVED])
    assert cone == 0.0


def test_an_optimum_is_confirmed_by_a_fit_that_explains_its_frames(plain: SessionFits) -> None:
    assert confirmed(plain, 0)
    assert plain.with_missing[0] is not None
    fit = plain.with_missing[0].fit
    rejected = replace(plain.with_missing[0], fit=replace(fit, verdict=replace(fit.verdict, accepted=False)))
    assert not confirmed(replace(plain, with_missing=(rejected, None)), 0)
