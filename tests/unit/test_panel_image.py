"""Targets on a panel's pixels."""

from __future__ import annotations

import numpy as np
import pytest

from labkit.devices.protocols import PanelInfo, Travel
from labkit.errors import PlanError, TargetError
from labkit.panel.panels import PANELS, panel_info
from labkit.panel.picture import panel_picture
from labkit.plan import DisplaySettings
from labkit.target.target import CellTarget

PANEL = PanelInfo((100, 120), 0.1)
CHESS = np.indices((4, 6)).sum(axis=0) % 2.0


def test_every_cell_has_whole_pixels() -> None:
    picture = panel_picture(CellTarget(CHESS, (2.01, 3.015)), PANEL)
    np.testing.assert_array_equal(picture.grey, 255 * np.kron(CHESS, np.ones((5, 5))))
    assert picture.size_mm == pytest.approx((2.0, 3.0))


def test_a_grey_comes_out_as_the_panels_gamma_wants_it() -> None:
    picture = panel_picture(CellTarget(np.full((1, 1), 0.5), (1.0, 1.0)), PANEL)
    assert (picture.grey[0, 0] / 255) ** PANEL.gamma == pytest.approx(0.5, abs=0.005)


def test_a_white_surround_fills_the_panel() -> None:
    picture = panel_picture(CellTarget(np.zeros((1, 1)), (2.0, 4.0), surround=1.0), PANEL)
    assert picture.grey.shape == (100, 120)
    assert np.argwhere(picture.grey == 0).min(axis=0).tolist() == [40, 40]
    assert np.sum(picture.grey == 0) == 20 * 40


@pytest.mark.parametrize(
    ("target", "words"),
    [
        (
            CellTarget(CHESS, (2.2, 3.3)),
            r"the nearest that does is .* mm; give that as target\.size_mm",
        ),
        (CellTarget(CHESS, (10.4, 15.6)), "the panel has 100 × 120: take a smaller target"),
        (CellTarget(2 * CHESS, (2.0, 3.0)), "radiance goes up to 2"),
    ],
)
def test_a_target_that_a_panel_cannot_show_is_refused(
    target: CellTarget, words: str
) -> None:
    with pytest.raises(TargetError, match=words):
        panel_picture(target, PANEL)


def test_a_panel_is_known_by_name_or_by_pitch_and_pixels() -> None:
    ipad = panel_info(DisplaySettings(address="web:", panel="ipad-9.7-retina"))
    assert ipad.size_mm == pytest.approx(
        (147.8, 197.0), abs=0.05
    )  # the maker: 5.82 by 7.76 inches
    assert panel_info(
        DisplaySettings(address="web:", pixel_pitch_mm=0.2, pixels=(30, 40))
    ).size_mm == (6.0, 8.0)
    with pytest.raises(PlanError, match=r"known are ipad-10\.2, "):
        panel_info(DisplaySettings(address="web:", panel="ipad"))
    assert all(panel.pixels[0] < panel.pixels[1] for panel in PANELS.values())


@pytest.mark.parametrize(
    "make",
    [lambda: Travel(3, 3), lambda: PanelInfo((0, 4), 0.1), lambda: PanelInfo((4, 4), 0)],
)
def test_impossible_hardware_is_refused(make: object) -> None:
    with pytest.raises(ValueError, match=r"empty travel|a panel has"):
        make()  # type: ignore[operator]
