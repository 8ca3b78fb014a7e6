"""A session of the simulator in tests/golden, which shares nothing with labkit, through import and fit, against its truth.

Largest errors of six sessions, as `python -m tests.golden.measure 0 1 2 3 4 5` prints them; the test fits that of seed 0.
The limits, in benchmarks/claims.toml, are at most twice the largest.

    TABLE
"""

from pathlib import Path

import pytest

from benchmarks.claims import CLAIMS, limit
from tests.golden.measure import errors, import_and_fit
from tests.golden.simulate import defocus_waves, write_session

figures = next(claim for claim in CLAIMS["held"] if claim["name"] == "golden_small")["figures"]


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> dict[str, float]:
    truth: Path = tmp_path_factory.mktemp("truth")
    write_session(truth, seed=0)
    import_and_fit(truth, truth / "session")
    return errors(truth, truth / "session")


@pytest.mark.xfail(reason="the fit takes the f-number at infinity for that of the cone, 3.8 % larger", strict=True)
@pytest.mark.slow
@pytest.mark.timeout(1800)  # 55 s of a core's time
def test_a_session_of_another_simulator_is_estimated_as_well_as_is_claimed(measured: dict[str, float]) -> None:
    assert {name: measured[name] for name in figures if measured[name] > limit("golden_small", name)} == {}
    assert measured["rejected"] == 0


@pytest.mark.parametrize(("range_mm", "waves"), [(3013.2, 0.07484), (3200.0, 1.06783), (3300.0, 1.55325)])
def test_the_simulators_defocus_has_the_published_values(range_mm: float, waves: float) -> None:
    # of 70 mm, f/2.8, pupil magnification 0.985 and best focus at 3 m, to the five digits that are published
    assert defocus_waves(range_mm, 3000.0, 70.0, 2.8, 0.985) == pytest.approx(waves, abs=6e-6)
