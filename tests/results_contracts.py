"""results.json as its contracts print it, schema by schema."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from labkit.results import Results
from tests.results_samples import some_results

CONTRACT: dict[str, Any] = {
    "schema": 1,
    "labkit_version": "0.1.0",
    "created": "2026-11-21T12:00:00+00:00",
    "plan_sha256": "00",
    "convention": "corrected",
    "reference_wavelength_nm": 450.0,
    "wavefronts": [
        {
            "range_mm": 3000.0, "channel": "R", "wavelength_nm": 650.0,
            "noll": [4, 5], "waves_rms": [0.1, 0.0], "std": [0.001, 0.001], "covariance": [[1e-6, 0], [0, 1e-6]],
            "pose": [0, 0, 0, 0, 0, 0, 0, 0], "gain": 0.45, "read_noise": 1.1, "chi2_per_pixel": 1.01,
            "global_test": {"name": "embedding", "p_value": 0.4, "accepted": True, "starts": 3},
            "seconds": 4.2, "frames": ["target_3000_0.dng"],
        }
    ],
    "focus": {
        "best_focus_mm": {"R": {"value": 3024.0, "std": 0.4}},
        "pupil_magnification": {"value": 0.98, "std": 0.04, "identifiable": False},
        "residual_waves": {"R": [0.001, -0.002, 0.001]},
    },
    "warnings": ["..."],
}  # fmt: skip
"""results.json of schema 1 as its contract prints it."""

CONTRACT_2: dict[str, Any] = {
    **CONTRACT,
    "schema": 2,
    "lens": {
        "focal_length_mm": {"value": 69.10, "std": 0.09}, "f_number": {"value": 2.870, "std": 0.008},
        "pupil_magnification": {"value": 0.96, "std": 0.05}, "range_zero_mm": {"value": -5.8, "std": 4.0},
    },
    "budget": {"best_focus_mm.G": {"photons": 0.02, "calibration": 0.01, "geometry": 0.03, "model": 0.0}},
    "wavefronts": [
        {
            **CONTRACT["wavefronts"][0],
            "f_number": 2.94, "f_number_working": {"value": 2.94, "std": 0.008}, "blur_um": {"value": -34.65, "std": 0.011},
            "optimum": {"accepted": True, "p_value": 0.4, "others": 2},
            "model": {"accepted": False, "p_value": 1e-6, "missing": ["low_pass_filter"]},
        }
    ],
}  # fmt: skip
"""And of schema 2."""

CONTRACT_3: dict[str, Any] = {
    **CONTRACT_2,
    "schema": 3,
    "findings": [
        {
            "code": "camera-part-found", "where": {"range_mm": None, "channel": None, "tile": None},
            "numbers": {"part": "low_pass_filter", "log_likelihood_gain": 48004.3, "best_focus_moves_mm": {"G": 0.02}},
            "text": "...",
        }
    ],
    "wavefronts": [
        {**CONTRACT_2["wavefronts"][0], "key": {"range_mm": 3000.0, "channel": "R", "tile": None}},
    ],
}  # fmt: skip
"""And of schema 3, but for the pupil."""


def printed(folder: Path, contract: Mapping[str, Any]) -> Results:
    """What a contract prints, read from a folder; the plan is not printed there."""
    place = folder / "results" / "latest"
    place.mkdir(parents=True)
    plan = {"plan": some_results().plan.model_dump(mode="json", exclude_none=True)}
    (place / "results.json").write_text(json.dumps({**plan, **contract}))
    return Results.load(folder)
