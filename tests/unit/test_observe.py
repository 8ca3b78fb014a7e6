"""What a session's frames say, ready to be fitted: which of them, how often they are read, where the cut stands."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest

import labkit.analysis.observe
import labkit.calibration.stack
from labkit.analysis.observe import observe
from labkit.errors import DataError
from labkit.estimation.observation import Observation
from labkit.key import Key
from labkit.photographs.decoding import read_photograph
from labkit.photographs.photograph import Cut, Photograph
from labkit.plan import Plan, Sensor
from labkit.target.target import open_target
from tests.sensor import BLACK, Bench, light_at


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    """Darks, and flats and two target frames at each of three ranges."""
    made = Bench(tmp_path)
    with made.session:
        made.usual(2, (2000.0, 2200.0, 2400.0))
        for range_mm in (2400.0, 2000.0, 2200.0):
            made.add("target", range_mm, 15000 * light_at(range_mm), 2)
        yield made


def observed(
    bench: Bench,
    range_mm: float | Sequence[float] | None = None,
    channel: str | Sequence[str] | None = None,
) -> list[Observation]:
    plan = bench.session.plan
    return observe(
        bench.session, plan, open_target(plan.target), range_mm=range_mm, channel=channel
    )[0]


def test_each_photograph_is_decoded_once(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    decoded: Counter[str] = Counter()

    def counted(path: Path, sensor: Sensor, cut: Cut) -> Photograph:
        decoded[path.name] += 1
        return read_photograph(path, sensor, cut)

    for module in (labkit.analysis.observe, labkit.calibration.stack):
        monkeypatch.setattr(module, "read_photograph", counted)
    assert len(observed(bench)) == 9
    assert decoded == Counter(frame.file for frame in bench.session.frames)


def test_ranges_and_channels_are_chosen_singly_or_several(bench: Bench) -> None:
    assert [o.key for o in observed(bench, 2000, "G")] == [Key(2000.0, "G")]
    several = observed(bench, [2400.0000005, 2000], ("B", "R"))
    assert [(o.range_mm, o.channel) for o in several] == [
        (2000.0, "R"),
        (2000.0, "B"),
        (2400.0, "R"),
        (2400.0, "B"),
    ]
    assert len(observed(bench, tuple(np.array([2000.0, 2200.0])))) == 6


def test_what_the_session_has_not_is_named_with_what_it_has(bench: Bench) -> None:
    with pytest.raises(
        DataError, match=r"no target frames at 1234.5 mm: the session has 2000, 2200, 2400"
    ):
        observed(bench, [2000.0, 1234.5])
    with pytest.raises(DataError, match="channel IR: allowed are R, G, B"):
        observed(bench, channel=["R", "IR"])
    for range_mm, channel in (([], None), (None, [])):
        with pytest.raises(DataError, match="is empty"):
            observed(bench, range_mm, channel)


def test_an_observation_says_where_its_cut_stands_in_the_frame(bench: Bench) -> None:
    observation = observed(bench, 2200.0, "G")[0]
    assert observation.origin_px == (30, 50)  # ten pixels around the corners of the plan
    assert observation.shape == observation.frames[0].counts.shape
    for frame, name, corners in zip(
        observation.frames, observation.names, observation.corners_px, strict=True
    ):
        np.testing.assert_allclose(
            corners, [[40, 60], [40, 160], [140, 160], [140, 60]], atol=1e-9
        )
        mosaic = read_photograph(
            bench.session.folder / "frames" / name, bench.session.plan.sensor
        )
        rows, columns = observation.shape
        cut = mosaic.counts[30 : 30 + rows, 50 : 50 + columns]
        assert (
            np.max(np.abs(frame.counts - (cut - BLACK))) < 5
        )  # the darks' level is the plan's within noise


def test_flats_of_another_range_are_taken_with_a_warning(bench: Bench) -> None:
    bench.add("target", 2150.0, 15000 * light_at(2150.0))
    plan = bench.session.plan
    _, findings = observe(bench.session, plan, open_target(plan.target), range_mm=2150.0)
    assert [str(finding) for finding in findings] == [
        "no flat frames at 2150 mm: those at 2200 mm are taken instead"
    ]


def test_another_plan_than_the_sessions_may_be_given(bench: Bench, tmp_path: Path) -> None:
    other = tmp_path / "other.toml"
    other.write_text(
        (bench.session.folder / "plan.toml").read_text().replace("[40, 60]", "[44, 60]")
    )
    plan = Plan.load(other)
    observations, _ = observe(
        bench.session, plan, open_target(plan.target), range_mm=2000.0
    )
    assert observations[0].corners_px[0][0] == pytest.approx([44, 60])
