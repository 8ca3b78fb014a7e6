"""Columns of the field's expansion: how the modes, the cone and the scale of a tile depend on its place in the frame.

The mean over the field, or for values that follow a law the middle of the frame, has the columns of an untiled session. Here
are the field's Zernike polynomials from tilt on, each times a mode, the cone or the scale. Every kind and order of them has a
standard deviation of its own, for which the marginal likelihood of the session is largest: of an order that is not there it
tends to 0. So no order has to be chosen (M. E. Tipping, J. Mach. Learn. Res. 1, 211 (2001)). The same holds for what colours
differ by in the modes of each radial order.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from labkit.estimation.laws import (
    COMMON_MODE,
    FIELD_COLOUR,
    FIELD_CONE,
    FIELD_KINDS,
    FIELD_MODE,
    FIELD_SCALE,
    FIELD_TILT,
    MODE,
    WEAK_MODE,
    Column,
    Name,
)
from labkit.estimation.settings import SETTINGS
from labkit.optics.field import field_terms
from labkit.optics.wavefront import DEFOCUS
from labkit.optics.zernike import modes_at, noll_to_nm
from labkit.plan.tables import ENGRAVED_F_NUMBER
from labkit.types import Floats

Family = tuple[str, int, int, bool]
"""Kind of a column, radial order in the field, radial order in the pupil (0 for cone and scale), and whether the azimuthal
orders are alike: a lens that is rotationally symmetric has no other terms."""

TARGET_SLOPES = (3, 2)
"""Field polynomials that are slopes, down and right: of the scale they are the target's tilt at each station."""

BEFORE: Mapping[str, float] = {
    FIELD_MODE: SETTINGS.field_waves,
    FIELD_COLOUR: SETTINGS.colour_modes_std,
    MODE: SETTINGS.colour_modes_std,
    FIELD_CONE: ENGRAVED_F_NUMBER,
    FIELD_SCALE: SETTINGS.loose,
}
"""Standard deviation of each kind before the session."""


LEAST_DETERMINED = 0.1
"""Number of a family's terms that observations determine, below which its standard deviation stays."""

LEAST_DETERMINED_SHARE = 0.5
"""The same for weak modes, over their number: a deep cat's eye hides most of them, and few might be small by chance."""


def usual_order(tiles: int) -> int:
    """Return the largest radial order with no more terms than there are tiles, and no larger than `Settings.field_order`."""
    orders = range(1, SETTINGS.field_order + 1)
    return max((n for n in orders if len(field_terms(n)) <= tiles), default=0)


def common_columns(
    order: int,
    noll: Sequence[int],
    spread: Mapping[Family, float],
    stations: Sequence[float],
) -> Iterator[Column]:
    """Yield the columns that all channels share: modes, cone and scale times the field's polynomials up to an order.

    Slopes of the scale are the target's tilt, another one at each station.

    Parameters
    ----------
    order : radial order in the field
    noll : the modes
    spread : standard deviations by family, where they differ from those before the session
    stations : positions of the rail
    """
    for k in field_terms(order)[1:]:
        for j in noll:
            yield _column(FIELD_MODE, (k, j), spread)
        yield _column(FIELD_CONE, (k,), spread)
        if k not in TARGET_SLOPES:
            yield _column(FIELD_SCALE, (k,), spread)
    if order > 0:
        for station in stations:
            for k in TARGET_SLOPES:
                yield Column(FIELD_TILT, SETTINGS.loose, name=(station, k))


def own_columns(
    order: int, noll: Sequence[int], spread: Mapping[Family, float]
) -> Iterator[Column]:
    """Yield the columns of each channel: what it adds to the modes of all."""
    for k in field_terms(order)[1:]:
        for j in noll:
            yield _column(FIELD_COLOUR, (k, j), spread)


def mode_columns(
    j: int, channels: Sequence[str], spread: Mapping[Family, float], weak_std: float | None
) -> Iterator[Column]:
    """Yield the columns of a mode: what all channels have in common, and what each adds.

    weak_std: standard deviation of a weak mode before the session; None for other modes
    """
    if weak_std is None:
        common = Column(COMMON_MODE, SETTINGS.unknown, name=(j,))
    else:
        common = _column(WEAK_MODE, (j,), spread, weak_std)
    yield common
    for channel in channels:
        own = _column(MODE, (channel, j), spread)
        yield replace(own, std=min(own.std, common.std))


def family(column: Column) -> Family | None:
    """Return the family of a column; None for columns of other kinds."""
    if column.kind in (MODE, WEAK_MODE):
        order, _ = noll_to_nm(int(column.name[-1]))
        return column.kind, 0, order, False
    if column.kind not in (*FIELD_KINDS, FIELD_COLOUR):
        return None
    field, *pupil = (noll_to_nm(int(j)) for j in column.name)
    (n, m), (order, azimuth) = field, pupil[0] if pupil else (0, 0)
    return column.kind, n, order, abs(m) == abs(azimuth)


def polynomials(order: int, places: Floats, noll: Sequence[int], values: int) -> Floats:
    """Return derivatives (n, values, terms) of the values of observations by their coefficients over the field.

    The first term is constant. Numbers of camera parts have no other.

    Parameters
    ----------
    order : radial order in the field
    places : (n, 2) as in `Reading.place`
    noll : the modes, which are the first of the values
    values : number of values of an observation, the cone and the scale last
    """
    terms = field_terms(order)
    rows = np.zeros((len(places), values, len(terms)))
    rows[:, [*range(len(noll)), values - 2, values - 1]] = modes_at(
        terms, places[:, 1], places[:, 0]
    ).T[:, None]
    by_laws = noll.index(DEFOCUS), values - 2, values - 1
    rows[:, by_laws, 1:] -= [in_the_middle(k) for k in terms[1:]]
    rows[:, :, 0] = 1.0
    return rows


def coefficient(column: Column, order: int, noll: Sequence[int], values: int) -> int | None:
    """Return the place among the coefficients (values, terms) of `polynomials` to which a column adds; None if to none."""
    last = {FIELD_CONE: values - 2, FIELD_SCALE: values - 1}
    if column.kind in (FIELD_MODE, FIELD_COLOUR):
        k, j = column.name
        row = noll.index(int(j))
    elif column.kind in last:
        k, row = column.name[0], last[column.kind]
    else:
        return None
    return row * len(field_terms(order)) + int(k) - 1


def in_the_middle(k: int) -> float:
    """Return a field polynomial in the middle of the frame, for which best focus is stated."""
    return float(modes_at((k,), np.zeros(1), np.zeros(1))[0, 0])


def spreads(
    columns: Sequence[Column], values: Floats, variances: Floats
) -> dict[Family, float]:
    """Return the standard deviation of each family by estimates (columns,) and their variances.

    A step towards the largest marginal likelihood: the squares of the estimates over the number of them that the observations
    determine (D. J. C. MacKay, Neural Computation 4, 415 (1992)). Few steps suffice where expectation maximisation takes many.
    """
    squares: dict[Family, float] = {}
    determined: dict[Family, float] = {}
    least: dict[Family, float] = {}
    for column, value, variance in zip(columns, values, variances, strict=True):
        if (of := family(column)) is not None:
            squares[of] = squares.get(of, 0.0) + float(value) ** 2
            share = 1 - float(variance) / column.prior_std**2
            determined[of] = determined.get(of, 0.0) + max(share, 0.0)
            weak = column.kind == WEAK_MODE
            of_number = least.get(of, 0.0) + LEAST_DETERMINED_SHARE
            least[of] = of_number if weak else LEAST_DETERMINED
    # a family that hardly anything determines keeps what is known of it before the session
    return {
        of: max((square / determined[of]) ** 0.5, SETTINGS.defocus_floor_waves)
        for of, square in squares.items()
        if determined[of] > least[of]
    }


def _column(
    kind: str, name: Name, spread: Mapping[Family, float], before: float | None = None
) -> Column:
    """Return a column with its family's standard deviation. before: the one before the session; None for its kind's."""
    column = Column(kind, BEFORE[kind] if before is None else before, name=name)
    of = family(column)
    assert of is not None
    return replace(column, std=spread.get(of, column.std))
