"""Gain and read noise of a plan constrain a fit together with the session's own flats and darks."""

from __future__ import annotations

import pytest

from labkit.analysis.observe import noise_prior
from labkit.calibration.calibrate import calibrate
from labkit.calibration.photon_transfer import ROUNDING_VARIANCE, NoiseEstimate
from labkit.calibration.stated_noise import UNMEASURED, noise_findings, with_stated
from labkit.errors import PlanError
from labkit.plan import Channel, Plan
from tests.plans import SMALL, plan_text

CHANNEL = Channel(
    name="G",
    wavelength_nm=550.0,
    gain_counts_per_e=0.28,
    gain_std=0.0014,
    read_noise_counts=3.0,
    read_noise_std=0.03,
)


def test_stated_noise_is_the_prior_of_a_fit_without_flats() -> None:
    prior = noise_prior(with_stated(UNMEASURED, CHANNEL), 4095.0)
    assert prior.gain == 0.28
    assert prior.gain_std == pytest.approx(0.005)
    assert prior.read_variance == pytest.approx(9.0 + ROUNDING_VARIANCE)
    assert prior.read_variance_std == pytest.approx(0.02)


def test_a_plans_noise_reaches_the_calibration_of_a_session_without_flats() -> None:
    keys = {"gain_counts_per_e": 0.28, "gain_std": 0.0014}
    channel = [{"name": "G", "wavelength_nm": 550.0, **keys}]
    plan = Plan.parse(plan_text(SMALL)).replace(channel=channel)
    assert calibrate([], plan).noise["G"] == NoiseEstimate(0.28, 0.0014, None, None)


def test_measured_and_stated_noise_are_averaged_by_their_errors() -> None:
    both = with_stated(NoiseEstimate(0.284, 0.0014, 3.0, 0.3), CHANNEL)
    assert both.gain == pytest.approx(0.282)
    assert both.gain_std == pytest.approx(0.0014 / 2**0.5)


def test_a_contradiction_is_named_and_the_sessions_own_is_used() -> None:
    own = NoiseEstimate(0.56, 0.003, 3.0, 0.3)
    assert with_stated(own, CHANNEL).gain == 0.56
    (finding,) = noise_findings({"G": own}, [CHANNEL])
    assert finding.code == "noise-contradicts-plan"
    assert "gain_counts_per_e = 0.28 in the plan" in finding.text


def test_an_error_without_its_number_is_refused() -> None:
    channel = [{"name": "G", "wavelength_nm": 550.0, "gain_std": 0.01}]
    with pytest.raises(PlanError, match="gain_std stands without gain_counts_per_e"):
        Plan.parse(plan_text(SMALL)).replace(channel=channel)
