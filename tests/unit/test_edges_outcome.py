"""What `labkit edges` says where its two methods contradict each other."""

from pathlib import Path

import numpy as np
import pytest
import tifffile

from labkit.edges.esfr import Esfr
from labkit.edges.outcome import MOST_DRAWN_PX, ChannelEdge, grey_picture
from labkit.edges.response import Response
from labkit.plan import Plan
from labkit.uncertain import Uncertain
from tests.edge_scenes import PLAN

NOTHING = Uncertain(0.0, 0.0)


def edge(fit: Uncertain, iso: Uncertain | None) -> ChannelEdge:
    curve = np.zeros(2), np.ones(2), np.zeros(2)
    by_the_standard = None if iso is None else Esfr(*curve, iso, NOTHING, 5.0)
    return ChannelEdge(
        channel="G",
        defocus=NOTHING,
        other_defocus=None,
        angle_deg=NOTHING,
        near=NOTHING,
        far=NOTHING,
        chi2_per_pixel=1.0,
        pixels=400,
        fitted=Response(*curve, fit, NOTHING),
        iso=by_the_standard,
    )


@pytest.mark.parametrize(
    ("iso", "told"),
    [
        ((87.4, 1.7), True),
        ((40.0, 1.0), True),
        ((61.0, 0.5), False),  # the method's own 12 %
        ((87.4, 9.0), False),
        ((float("nan"), float("nan")), False),
        (None, False),
    ],
)
def test_two_methods_that_contradict_each_other_are_told(
    iso: tuple[float, float] | None, told: bool
) -> None:
    fit = Uncertain(55.3, 1.0, "cycles/mm")
    by_the_standard = iso and Uncertain(*iso, "cycles/mm")
    findings = edge(fit, by_the_standard).disagreement((1, 2, 30, 40))
    assert bool(findings) == told
    for finding in findings:
        assert finding.code == "edge-methods-disagree"
        assert finding.numbers["fit_per_mm"] == 55.3
        assert finding.text.startswith(
            "box 1,2,30,40, channel G: MTF50 is 55.3 ± 1.0 cycles/mm by the fit and "
        )
        assert "more apart than their errors allow" in finding.text


def test_a_large_photograph_is_drawn_coarsely_at_its_own_places(tmp_path: Path) -> None:
    counts = np.full((3000, 4200), 1000, np.uint16)
    counts[600:900, 2400:] = 9000
    plan = Plan.parse(PLAN, Path())
    file = tmp_path / "large.tif"
    tifffile.imwrite(file, counts)
    grey, (left, right, bottom, top) = grey_picture(file, plan)
    assert max(grey.shape) <= 2 * MOST_DRAWN_PX
    assert (left, right, bottom, top) == (-0.5, 4199.5, 2999.5, -0.5)
    per_px = grey.shape[0] / 3000
    rows, columns = np.nonzero(grey > 0.5)
    assert rows.min() == pytest.approx(600 * per_px, abs=1)
    assert columns.min() == pytest.approx(2400 * per_px, abs=1)
    tifffile.imwrite(file, np.full((3000, 4200), 1000, np.uint16))
    assert np.ptp(grey_picture(file, plan).grey) == 0  # an even one stays even
