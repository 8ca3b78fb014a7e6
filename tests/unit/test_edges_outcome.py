"""What `labkit edges` says of edges that the lens does not explain."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from labkit.edges.blur import Motion
from labkit.edges.esfr import Esfr
from labkit.edges.outcome import MOST_DRAWN_PX, ChannelEdge, grey_picture
from labkit.edges.response import Response
from labkit.plan import Plan
from labkit.uncertain import Uncertain
from tests.edge_scenes import PLAN

NOTHING = Uncertain(0.0, 0.0)


def edge(edition: int = 2023, **more: Any) -> ChannelEdge:
    curve = np.zeros(2), np.ones(2), np.zeros(2)
    return ChannelEdge(
        channel="G",
        defocus=NOTHING,
        other_defocus=None,
        angle_deg=NOTHING,
        near=NOTHING,
        far=NOTHING,
        chi2_per_pixel=1.0,
        pixels=400,
        fitted=Response(*curve, NOTHING, NOTHING),
        iso=Esfr(*curve, NOTHING, NOTHING, 5.0, edition),
        **more,
    )


@pytest.mark.parametrize(
    ("of", "code", "words"),
    [
        (edge(), "", ""),
        (edge(bow_px=1.2), "", ""),  # the polynomial of 2023 follows it
        (edge(2017, bow_px=0.1), "", ""),
        (edge(2017, bow_px=1.2), "edge-bowed", "curved by 1.2 pixels"),
        (edge(contradiction=8.0), "edge-methods-disagree", "by 8.0 standard errors"),
        (
            edge(other_blur=Motion.words, contradiction=8.0),
            "edge-blurred-otherwise",
            "no lens makes its blur: motion during the exposure",
        ),
    ],
)
def test_what_the_lens_does_not_explain_is_told_with_its_cause(
    of: ChannelEdge, code: str, words: str
) -> None:
    findings = of.disagreement((1, 2, 30, 40))
    assert [finding.code for finding in findings] == ([code] if code else [])
    for finding in findings:
        assert finding.text.startswith("box 1,2,30,40, channel G: ")
        assert words in finding.text


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
