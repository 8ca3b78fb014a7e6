"""Mistakes in the plan of a golden session are named in seconds, before any fit."""

from __future__ import annotations

from pathlib import Path

import pytest

import labkit
from benchmarks.mistakes import MISTAKES, processor_s, write_session
from labkit.errors import LabkitError

GOLDEN = Path(__file__).parents[3] / "shared" / "golden"

pytestmark = [
    pytest.mark.skipif(
        not GOLDEN.is_dir(),
        reason="the sessions with a known truth lie beside the project, not in it",
    ),
    pytest.mark.slow,
    pytest.mark.timeout(600),
]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("order 4", r"shows order 5, \[target\] order = 4: write order = 5"),
        ("negative", "shows the negative of the target"),
        ("wavelengths", "channel R has wavelength_nm = 455 and channel B has 640"),
        ("surround", r'black surround, .* write surround = "black"'),
        ("size × 2", r"one of 26 mm there: check target\.size_mm"),
    ],
)
def test_a_mistake_is_named_before_any_fit(name: str, words: str, tmp_path: Path) -> None:
    began = processor_s()
    with pytest.raises(LabkitError, match=words):
        labkit.fit(write_session(GOLDEN, MISTAKES[name], tmp_path), workers=1)
    # 1 to 2 s of a processor were measured; fits took 155 (wavelengths) and more than 300 s (order)
    assert processor_s() - began < 4
