"""Best focus of wavefronts whose sign the ranges leave open."""

from __future__ import annotations

import pytest

from labkit.analysis.session_results import as_focus
from labkit.estimation.doubts import with_turned
from labkit.estimation.select import select
from tests.lens_samples import measured_of, members, stated, turned

PLAN = stated(70.0, 2.8)


@pytest.mark.parametrize("twins", [False, True])
def test_best_focus_of_open_signs_is_within_its_errors_whichever_sign_is_chosen(
    twins: bool,
) -> None:
    # two ranges so close together that either side of best focus explains them
    every = members((30_000.0, 30_001.0), 28_000.0, 70.0, 2.8, modes={6: 0.02, 7: 0.03})
    found = select([turned(one) if twins else one for one in every], PLAN)
    assert found.open_signs.all()
    others = list(with_turned(found.lens, range(len(every)), measured_of(every[0]).signs))
    focus = as_focus(found.lens, others)
    assert focus is not None
    for best in focus.best_focus_mm.values():
        assert abs(best.value - 28_000.0) < 4 * best.std


def test_best_focus_of_known_signs_has_the_errors_of_the_lens_alone() -> None:
    every = members((1900.0, 2000.0, 2100.0), 2010.0, 70.0, 2.8, modes={6: 0.02, 7: 0.03})
    lens = select(every, PLAN).lens
    signs = measured_of(every[0]).signs
    # a station turned against the others contradicts them
    assert list(with_turned(lens, range(len(every)), signs)) == []
