"""A real photograph without straight edges through the command; skipped where it is not at hand."""

from pathlib import Path

import pytest

from labkit.cli import run
from tests.plans import plan_text

REAL = Path(__file__).parents[3] / "shared" / "real"
NIKON = {
    "lens": {"focal_length_mm": 50.0, "f_number": 4.0},
    "sensor": {
        **{
            "pixel_pitch_um": 4.78,
            "cfa_pattern": "RGGB",
            "black_level": 600,
            "white_level": 15520,
        },
        "headerless_px": [512, 768],
    },
    "channel": [{"name": "G", "wavelength_nm": 540.0}],
    "target": {"kind": "sierpinski", "order": 4, "size_mm": 15.6},
}


@pytest.mark.skipif(not REAL.is_dir(), reason="needs ../shared/real")
def test_a_photograph_of_roses_has_no_edge_and_the_command_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = tmp_path / "plan.toml"
    plan.write_text(plan_text(NIKON))
    assert run(["edges", str(REAL / "DSC_1339_768x512_rggb.raw"), str(plan)]) == 2
    assert "no straight edge between two even sides was found" in capsys.readouterr().err
