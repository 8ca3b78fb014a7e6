"""Blur of edges that no wavefront makes: transfer functions against closed forms, slopes against differences."""

import numpy as np
import pytest

from labkit.edges.blur import BLURS, Blur, GaussianBlur, Motion, Sharpening, TwoSpots

NU = np.linspace(0, 1.2, 61)


@pytest.mark.parametrize("kind", BLURS, ids=lambda kind: type(kind).__name__)
@pytest.mark.parametrize("sign", [1.0, -0.3])
def test_slopes_are_those_of_differences(kind: Blur, sign: float) -> None:
    for start in kind.starts:
        numbers = sign * np.array(start)
        steps = 1e-6 * np.eye(kind.size)
        found = [
            (kind.transfer(NU, [*(numbers + h)]) - kind.transfer(NU, [*(numbers - h)]))
            / 2e-6
            for h in steps
        ]
        np.testing.assert_allclose(kind.slopes(NU, [*numbers]), found, rtol=1e-5, atol=1e-6)


def test_transfer_functions_are_those_of_their_line_spread_functions() -> None:
    assert Motion().transfer(NU, (9.0,)) == pytest.approx(np.sinc(3 * NU))
    assert TwoSpots().transfer(NU, (0.49,)) == pytest.approx(np.cos(np.pi * 0.7 * NU))
    gauss = np.exp(-2 * (np.pi * 0.6 * NU) ** 2)
    assert GaussianBlur().transfer(NU, (0.36,)) == pytest.approx(gauss)
    sharp = Sharpening().transfer(NU, (1.5, np.log(0.6)))
    assert sharp == pytest.approx(2.5 - 1.5 * gauss)
