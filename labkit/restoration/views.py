"""From a scene to the counts of a mosaic's planes, and their likelihood (thesis 4.41)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from labkit.estimation.likelihood import NormalCounts
from labkit.restoration.grid import SceneGrid
from labkit.types import AnyComplexes, Bools, Complexes64, Floats


@dataclass(frozen=True, eq=False)
class View:
    """One plane of a mosaic: the scene through one colour's lens, at one place of the filter array's cell.

    Attributes
    ----------
    component : which of the scene's colours it shows
    place : (row, column) in the cell
    transfer : half plane, of lens, pixel and shift, the place's own included: `SceneGrid.shifted`
    counts : (rows, columns) of cells, above black
    used : usable counts
    light : relative illumination, which multiplies the scene
    gain : counts per electron
    read_variance : counts squared

    Raises
    ------
    ValueError : noise that is not above 0, or a plane without a used pixel
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
        """Return the distribution of counts about a mean."""
        return NormalCounts(mean, self.gain, self.read_variance)

    def seen(self, mean: Floats) -> NormalCounts:
        """Return the distribution of the used counts about a mean (rows, columns)."""
        return self.expected(mean[self.used])

    def slope(self, mean: Floats) -> Floats:
        """Return the misfit's derivative (rows, columns) by the mean, 0 for unused counts."""
        return np.where(self.used, -self.expected(mean).pulls(self.counts)[0], 0.0)

    def weight(self, mean: Floats) -> Floats:
        """Return the misfit's mean second derivative (rows, columns), 0 for unused counts."""
        return np.where(self.used, self.expected(mean).weights()[0], 0.0)


@dataclass(frozen=True, eq=False)
class Views:
    """All planes that show one scene, of all colours and frames. components: number of the scene's colours.

    Arrays of planes are (views, rows, columns).
    """

    grid: SceneGrid
    views: tuple[View, ...]
    components: int = 1

    def __len__(self) -> int:
        return len(self.views)

    def __iter__(self) -> Iterator[View]:
        return iter(self.views)

    @cached_property
    def counts(self) -> Floats:
        """Counts above black of all planes."""
        return np.array([view.counts for view in self])

    @cached_property
    def light(self) -> Floats:
        """Relative illumination of all planes."""
        return np.array([view.light for view in self])

    @property
    def data(self) -> int:
        """Number of used counts."""
        return int(sum(view.used.sum() for view in self))

    def levels(self) -> Floats:
        """Return the mean of the scene in each colour, by all its planes: separate means would contradict each other."""
        totals = np.zeros(self.components)
        planes = np.zeros(self.components)
        for view in self:
            mean = view.counts[view.used].mean() / view.light[view.used].mean()
            totals[view.component] += mean
            planes[view.component] += 1
        return totals / planes

    def flat(self, levels: Floats) -> Floats:
        """Return all planes of an even scene, levels (components,)."""
        return np.array([view.light * levels[view.component] for view in self])

    def seen(self) -> Bools:
        """Return the mask (rows, columns) of fine samples of the frame with data."""
        return self.grid.seen([view.used for view in self])

    def means(self, spectra: AnyComplexes) -> Floats:
        """Return the mean counts of all planes. spectra: (components, half, columns) of the scene."""
        return np.array(
            [v.light * self.grid.sample(spectra[v.component] * v.transfer) for v in self]
        )

    def spread(self, planes: Sequence[Floats] | Floats) -> AnyComplexes:
        """Return the transpose of `means`: (components, half, columns)."""
        rows, columns = self.grid.shape
        total = np.zeros((self.components, rows // 2 + 1, columns), np.complex64)
        for view, plane in zip(self, planes, strict=True):
            total[view.component] += self.grid.spread(view.light * plane, view.transfer)
        return total

    def misfit(self, means: Floats) -> float:
        """Return minus the log-likelihood of the used counts."""
        return -sum(
            view.seen(mean).log_likelihood(view.counts[view.used])
            for view, mean in zip(self, means, strict=True)
        )

    def slopes(self, means: Floats) -> Floats:
        """Return the misfit's derivatives by the means."""
        return np.array([v.slope(mean) for v, mean in zip(self, means, strict=True)])

    def weights(self, means: Sequence[Floats] | Floats) -> Floats:
        """Return the misfit's mean second derivatives."""
        return np.array([v.weight(mean) for v, mean in zip(self, means, strict=True)])

    def chi2(self, means: Floats) -> float:
        """Return the squared deviations of the used counts over their variances, summed."""
        return sum(
            view.seen(mean).chi2(view.counts[view.used])
            for view, mean in zip(self, means, strict=True)
        )
