"""ISO 12233's slanted edge, against the standard's steps written out one by one, and its corner cases."""

import numpy as np
import pytest

from labkit.edges.esfr import Plane, esfr
from labkit.errors import DataError
from labkit.experiments.edge_camera import EdgeCamera
from labkit.types import Floats

NOLL = (4, 8, 11)
PITCH_UM = 4.78


def picture(
    angle_deg: float, defocus: float, f_number: float = 5.6, frame: int = 56
) -> Floats:
    camera = EdgeCamera(0.55, f_number, PITCH_UM, frame=frame, finer=4, reach_px=24)
    return camera.mean(
        np.radians(angle_deg), 0.4, (400.0, 3600.0), np.array([defocus, 0.03, -0.02]), NOLL
    )


def by_the_standard(values: Floats) -> tuple[Floats, Floats]:
    """Frequencies (cycles/mm) and e-SFR of a nearly vertical edge, as ISO 12233:2017 describes it, line by line."""
    rows, columns = values.shape
    slope = offset = 0.0
    for once in range(2):
        centroids = []
        for row in range(rows):
            line = [
                (values[row, c + 1] - values[row, c - 1]) / 2 for c in range(1, columns - 1)
            ]
            middle = (columns - 1) / 2 if not once else offset + slope * row
            at = np.arange(1, columns - 1)
            window = 0.54 + 0.46 * np.cos(2 * np.pi * (at - middle) / columns)
            weighed = np.array(line) * window
            centroids.append(float(weighed @ at / weighed.sum()))
        slope, offset = np.polyfit(np.arange(rows), centroids, 1)
    whole = (
        int(np.floor(rows * abs(slope)) / abs(slope)) if rows * abs(slope) >= 1 else rows
    )
    totals: dict[int, list[float]] = {}
    for row in range(whole):
        for column in range(columns):
            totals.setdefault(int(np.floor(4 * (column - slope * row))), []).append(
                values[row, column]
            )
    # as many quarters as the box has, the edge in the middle
    middle = int(np.floor(4 * offset))
    keys = [
        min(max(k, min(totals)), max(totals))
        for k in range(middle - 2 * columns, middle + 2 * columns)
    ]
    edge = np.array([np.mean(totals[k]) for k in keys])
    spread = np.zeros_like(edge)
    spread[1:-1] = (edge[2:] - edge[:-2]) / 2
    response = np.abs(np.fft.rfft(spread * np.hamming(4 * columns)))
    k: Floats = np.arange(response.size) / spread.size
    with np.errstate(invalid="ignore", divide="ignore"):
        response = (
            response
            / response[0]
            * np.nan_to_num(2 * np.pi * k / np.sin(2 * np.pi * k), nan=1.0)
        )
    return k * 4 / (PITCH_UM * 1e-3 * np.cos(np.arctan(slope))), response


def falls_to(frequency: Floats, response: Floats, level: float) -> float:
    k = int(np.argmax(response < level))
    share = (response[k - 1] - level) / (response[k - 1] - response[k])
    return float(frequency[k - 1] + share * (frequency[k] - frequency[k - 1]))


@pytest.mark.parametrize(
    ("angle", "defocus"), [(5.0, 0.05), (5.0, 0.5), (-8.0, 0.3), (12.0, 0.8), (-4.0, 0.1)]
)
def test_mtf50_is_that_of_the_standard_written_out_within_one_percent(
    angle: float, defocus: float
) -> None:
    values = picture(angle, defocus)
    found, (frequency, response) = esfr([Plane(values)], PITCH_UM), by_the_standard(values)
    assert found.mtf50.value == pytest.approx(falls_to(frequency, response, 0.5), rel=0.01)
    assert found.slant_deg == pytest.approx(abs(angle), abs=0.05)


def test_edges_along_rows_are_measured_as_those_along_columns() -> None:
    values = picture(6.0, 0.4)
    upright, lying = (esfr([Plane(v)], PITCH_UM) for v in (values, values.T))
    np.testing.assert_allclose(lying.value, upright.value, atol=1e-12)


def test_a_plane_of_a_bayer_mosaic_has_the_response_of_the_whole() -> None:
    # the pixel is no larger for being one of four; bins are twice as wide, which costs sinc(f / 2) in place of sinc(f / 4)
    values = picture(7.0, 0.7, frame=112)
    whole = esfr([Plane(values)], PITCH_UM)
    plane = esfr([Plane(values[1::2, ::2], (1, 0), 2)], PITCH_UM)
    greens = esfr(
        [Plane(values[::2, 1::2], (0, 1), 2), Plane(values[1::2, ::2], (1, 0), 2)], PITCH_UM
    )
    assert plane.mtf50.value == pytest.approx(whole.mtf50.value, rel=0.03)
    assert greens.mtf50.value == pytest.approx(whole.mtf50.value, rel=0.03)


def test_the_error_of_mtf50_is_its_scatter() -> None:
    rng, values = np.random.default_rng(1), picture(5.0, 0.5)
    found = [
        esfr([Plane(rng.poisson(values).astype(float))], PITCH_UM).mtf50 for _ in range(60)
    ]
    scatter = np.std([of.value for of in found])
    assert np.median([of.std for of in found]) == pytest.approx(
        scatter, rel=0.35
    )  # 60 tell it to 9 %


@pytest.mark.parametrize(
    ("angle", "words"), [(0.0, "slanted by 0.0 degrees"), (45.0, "slanted by 4")]
)
def test_an_edge_that_the_method_cannot_measure_is_refused(
    angle: float, words: str
) -> None:
    with pytest.raises(DataError, match=words):
        esfr([Plane(picture(angle, 0.5))], PITCH_UM)
