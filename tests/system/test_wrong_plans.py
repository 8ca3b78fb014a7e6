"""Fits by wrong plans: whatever they end in, no warning of Python or NumPy reaches a user, not even from a worker process."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from labkit.plan import Plan

WRONG: dict[str, dict[str, Any]] = {
    "another order": {"target": {"order": 2}},
    "twice the size": {"target": {"size_mm": 31.2}},
    "a white surround": {"target": {"surround": "white"}},
    "another colour": {"channel": [{"name": "G", "wavelength_nm": 420.0}]},
    "another stop": {"lens": {"f_number": 11.0}},
    "another lens": {"lens": {"focal_length_mm": 105.0}},
    "half the pitch": {"sensor": {"pixel_pitch_um": 2.4}},
    "more modes": {"fit": {"zernike_noll": None, "most_noll": 28}},
    "a cat's eye": {"lens": {"obstruction": 0.5, "blades": 5}},
}


@pytest.mark.slow
@pytest.mark.parametrize("name", WRONG)
def test_no_warning_of_numpy_reaches_a_user(
    captured: Path, tmp_path: Path, name: str
) -> None:
    session = shutil.copytree(captured, tmp_path / "night")
    plan = Plan.load(session / "plan.toml").replace(**WRONG[name])
    (tmp_path / "wrong.toml").write_text(plan.to_toml())
    command = "from labkit.cli import main; main()"
    options = ["--plan", "wrong.toml", "--workers", "2", "--patience", "2"]
    done = subprocess.run(
        [sys.executable, "-c", command, "fit", str(session), *options],
        cwd=tmp_path,
        env={**os.environ, "PYTHONWARNINGS": "error::RuntimeWarning"},
        capture_output=True,
        text=True,
    )
    # as an error in a process at work it would be the reason why a fit is left out
    assert "Warning" not in done.stdout + done.stderr
    assert done.returncode in (0, 1, 2)
