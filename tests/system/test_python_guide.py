"""The Python of docs/guides/python.md, run as it stands on a session of the simulator in tests/golden, beside its truth."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest

from labkit.plan import Plan
from labkit.raw.decode import read_raw
from labkit.types import Floats
from tests.golden.simulate import ACTIVE, FINER, ORDER, PITCH_UM, SIZE_MM, cone, write_session

PAGE = Path(__file__).parents[2] / "docs" / "guides" / "python.md"
pytestmark = pytest.mark.slow

LIMIT_OF_A_SESSION, LIMIT_OF_ONE = 0.0018, 0.0018
"""Waves RMS of each mode: twice the 0.0009 that six sessions and one photograph erred by at most."""


@pytest.fixture(scope="module")
def golden(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("golden")
    write_session(folder, seed=0)
    return folder


def blocks() -> list[str]:
    return re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


def truth(folder: Path) -> Floats:
    """Modes 4 to 15 of green at 1600 mm."""
    wavefronts = json.loads((folder / "truth.json").read_text())["wavefronts"]
    (entry,) = (w for w in wavefronts if (w["range_mm"], w["channel"]) == (1600.0, "G"))
    return np.array(entry["waves"])


def test_photographs_become_a_plot_of_the_mtf(golden: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(golden)
    mpl.use("agg")
    names: dict[str, Any] = {}
    exec(blocks()[0], names)
    assert (golden / "mtf.png").stat().st_size > 5_000
    w = names["w"]
    np.testing.assert_allclose(w.waves, truth(golden), atol=LIMIT_OF_A_SESSION)


def test_one_photograph_in_memory_is_fitted(golden: Path) -> None:
    code = blocks()[1]
    # the page's numbers are those of this session's target, lens and sensor
    numbers = (
        f"order={ORDER},size_mm={SIZE_MM:g}",
        f"f_number={cone('G'):.2f}",
        f"active_um={PITCH_UM * ACTIVE / FINER:.2f}",
    )
    assert [number in code for number in numbers] == [True] * 3
    mosaic = read_raw(golden / "target_1600_0.dng", Plan.load(golden / "plan.toml").sensor)
    names: dict[str, Any] = {"counts": mosaic.counts - mosaic.black_map()}
    exec(f"import labkit\n{code}", names)
    w = names["w"]
    even = np.isin(w.noll, (4, 5, 6, 11, 12, 13, 14, 15))
    # one range cannot decide between twins: the even modes may all have the other sign
    signed = np.where(even, np.sign(w.waves[0] * truth(golden)[0]), 1.0) * w.waves
    np.testing.assert_allclose(signed, truth(golden), atol=LIMIT_OF_ONE)
