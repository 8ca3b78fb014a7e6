"""From a scene to the counts of a mosaic's planes, and their likelihood (thesis 4.41)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from labkit.estimation.likelihood import NormalCounts
from labkit.restoration.grid import SceneGrid
from labkit.types import AnyComplexes, Bools, Complexes64, Floats


@dataclass(frozen=True, eq=False)
class View:
    """One plane of a mosaic: what the scene looks like through one colour's lens, at one place of the filter array's cell.

    component: which of the scene's colours it shows. place: (row, column) in the cell. transfer: half plane, of lens, pixel and
    shift, the place's own included: `SceneGrid.shifted`. counts: (rows, columns) of cells, black removed; used: of those that
    are neither clipped nor dead. light: relative illumination, by which the scene's light is multiplied. gain: counts an
    electron; read_variance: counts squared, of what does not depend on the light.
    Raises ValueError for noise that is none and a plane without a used pixel.
    """

    component: int
    place: tuple[int, int]
    transfer: Complexes64
    counts: Floats
    used: Bools
    light: Floats
    gain: float
    read_variance: float

    def __post_init__(self) -> None:
        if not (self.gain > 0 and self.read_variance > 0):
            raise ValueError(
                f"gain {self.gain:g}, read variance {self.read_variance:g}: numbers above 0 are needed"
            )
        if not self.used.any():
            raise ValueError("a plane without a usable pixel")

    def expected(self, mean: Floats) -> NormalCounts:
        """Distribution of counts about a mean, of all pixels (rows, columns) or some."""
        return NormalCounts(mean, self.gain, self.read_variance)

    def misfit(self, mean: Floats) -> float:
        """Minus the log-likelihood of the used counts, but for a constant."""
        return -self.expected(mean[self.used]).log_likelihood(self.counts[self.used])

    def slope(self, mean: Floats) -> Floats:
        """Its derivative by the mean, (rows, columns), 0 where not used."""
        return np.where(self.used, -self.expected(mean).pulls(self.counts)[0], 0.0)

    def weight(self, mean: Floats) -> Floats:
        """What its second derivative is on average, (rows, columns), 0 where not used."""
        return np.where(self.used, self.expected(mean).weights()[0], 0.0)

    def chi2(self, mean: Floats) -> float:
        """Squared deviations of the used counts, each over its variance, summed."""
        return self.expected(mean[self.used]).chi2(self.counts[self.used])


@dataclass(frozen=True, eq=False)
class Views:
    """All planes that show one scene, of all colours and frames. components: the scene's colours."""

    grid: SceneGrid
    views: tuple[View, ...]
    components: int = 1

    def __len__(self) -> int:
        return len(self.views)

    def __iter__(self) -> Iterator[View]:
        return iter(self.views)

    @property
    def data(self) -> int:
        """Counts that are used."""
        return int(sum(view.used.sum() for view in self.views))

    def levels(self) -> Floats:
        """(components,) mean of the scene by all planes of a colour: each by its own would set shifted frames at odds."""
        means = [
            (v.component, float(v.counts[v.used].mean() / v.light[v.used].mean()))
            for v in self
        ]
        return np.array(
            [np.mean([mean for c, mean in means if c == k]) for k in range(self.components)]
        )

    def seen(self) -> Bools:
        """(rows, columns) fine samples of the frame where there are data."""
        return self.grid.seen([(view.place, view.used) for view in self.views])

    def means(self, spectra: AnyComplexes) -> list[Floats]:
        """Each plane's mean. spectra: (components, half, columns) of the scene."""
        return [
            v.light * self.grid.sample(spectra[v.component] * v.transfer)
            for v in self.views
        ]

    def spread(self, planes: Sequence[Floats]) -> AnyComplexes:
        """`means`'s transpose: (components, half, columns)."""
        rows, columns = self.grid.shape
        total = np.zeros((self.components, rows // 2 + 1, columns), np.complex64)
        for view, plane in zip(self.views, planes, strict=True):
            total[view.component] += self.grid.spread(view.light * plane, view.transfer)
        return total

    def misfit(self, means: Sequence[Floats]) -> float:
        """Minus the log-likelihood of all counts."""
        return sum(view.misfit(mean) for view, mean in zip(self.views, means, strict=True))

    def slopes(self, means: Sequence[Floats]) -> list[Floats]:
        """Its derivatives by the means."""
        return [view.slope(mean) for view, mean in zip(self.views, means, strict=True)]

    def weights(self, means: Sequence[Floats]) -> list[Floats]:
        """Its second derivatives, on average."""
        return [view.weight(mean) for view, mean in zip(self.views, means, strict=True)]

    def chi2_per_pixel(self, means: Sequence[Floats]) -> float:
        """Of all used counts."""
        return (
            sum(view.chi2(mean) for view, mean in zip(self.views, means, strict=True))
            / self.data
        )
