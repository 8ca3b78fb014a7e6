"""Edge-spread functions of one direction as products of matrices, for the thousand edges of a chart.

The edge-spread function of `labkit.edges.spread` is linear in the lens's transfer function at the few nodes of its Chebyshev
series: the matrix to distances on a fine grid depends on the direction, and not on the wavefront.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.fft
from numpy.polynomial import chebyshev

from labkit.edges.spread import (
    LEAST_REACH,
    NODES_PER_STEEPNESS,
    SLICE_NODES,
    SPREAD_PERIODS,
    TAIL,
    behind_lens,
    wavefront_at,
)
from labkit.imaging.optics import Optics
from labkit.optics.mtf import steepness, turning_transfer_function
from labkit.types import Complexes, Floats

MOST_MATRICES = (
    64  # that a process keeps, of 0.3 MB each: places of a chart share directions
)
NODES_AT_ONCE = 16  # numbers of nodes are multiples: a matrix serves many wavefronts
FINENESS = 10.0  # distances of the grid to a period of the highest frequency


@dataclass(frozen=True)
class SpreadTable:
    """Edges of a direction.

    Attributes
    ----------
    optics : of a channel
    azimuth : of the edges' normal, radians from x (right) towards y (down)
    reach_um : largest distance of use
    """

    optics: Optics
    azimuth: float
    reach_um: float

    @property
    def _airy_um(self) -> float:
        """Shortest period."""
        optics = self.optics
        return optics.airy_um * min(optics.light.nodes) / optics.rim.reach

    @property
    def _step_um(self) -> float:
        return self._airy_um / FINENESS

    @property
    def _period_um(self) -> float:
        return SPREAD_PERIODS * max(self.reach_um, LEAST_REACH * self._airy_um)

    @property
    def _half(self) -> int:
        """Distances of the grid on either side of the line."""
        return int(np.ceil(self.reach_um / self._step_um)) + 1

    def read(self, waves: Floats, r_um: Floats) -> Floats:
        """Return rows (modes + 3, n) at distances (n,), as `EdgeSpread.read` does.

        The slope by azimuth is of the lens alone.
        """
        step, line, *slopes = self._rows(waves)
        at = r_um / self._step_um + self._half
        k = np.clip(at.astype(np.intp), 0, len(step) - 2)
        t = at - k
        # Hermite's cubic by values and slopes
        h = self._step_um
        s0, s1, l0, l1 = step[k], step[k + 1], h * line[k], h * line[k + 1]
        bend = 3 * (s1 - s0) - 2 * l0 - l1
        turn = l0 + l1 - 2 * (s1 - s0)
        found = [s0 + t * (l0 + t * (bend + t * turn))]
        rest = np.array([line, *slopes])
        return np.concatenate([found, rest[:, k] * (1 - t) + rest[:, k + 1] * t])

    def _rows(self, waves: Floats) -> Floats:
        """Return the rows on the grid."""
        optics = self.optics
        at_um = self._step_um * np.arange(-self._half, self._half + 1)
        radians = 2 * np.pi / self._period_um
        nodes = sum(share * node for share, node in optics.light.shares)
        tail = 2 / np.pi**3 * nodes * optics.airy_um * optics.rim.halo
        rows = np.zeros((waves.size + 3, at_um.size))
        rows[0] = 0.5 + tail * radians * TAIL(radians * at_um)
        rows[1] = tail * radians**2 * TAIL.deriv()(radians * at_um)
        wavefronts = [
            wavefront_at(self.optics, waves, node) for _, node in optics.light.shares
        ]
        steepest = max(map(steepness, wavefronts))
        count = SLICE_NODES + int(NODES_PER_STEEPNESS * steepest)
        count = -(-count // NODES_AT_ONCE) * NODES_AT_ONCE
        left = ((1 + chebyshev.chebpts1(count)[::-1]) / 2) ** 2
        for (share, _), wavefront in zip(optics.light.shares, wavefronts, strict=True):
            to_step, to_line = _matrices(self, count, wavefront.cutoff_per_mm)
            value, slopes = turning_transfer_function(
                wavefront,
                (1 - left) * wavefront.cutoff_per_mm,
                float(np.rad2deg(self.azimuth)),
            )
            every = share * np.concatenate([value[None], slopes])
            steps = every.real @ to_step.real.T - every.imag @ to_step.imag.T
            rows[0] += steps[0]
            rows[1] += (to_line @ (share * value)).real
            rows[2:] += steps[1:]
        return rows

    def matrices(self, count: int, cutoff_per_mm: float) -> tuple[Complexes, Complexes]:
        """Return matrices (grid, nodes) from the lens's transfer function to the spread and to its slope."""
        period_um = self._period_um
        frequency = np.arange(1, int(period_um / self._airy_um) + 1, 2) / period_um
        left = 1 - frequency * 1e3 / cutoff_per_mm
        powers = chebyshev.chebvander(2 * np.sqrt(left.clip(0)) - 1, count - 1)
        transform = scipy.fft.dct(np.eye(count), axis=0) / count
        transform[0] /= 2
        series = np.where(left[:, None] > 0, powers @ transform, 0)
        series *= behind_lens(self.optics, self.azimuth, frequency)[:, None]
        at_um = self._step_um * np.arange(-self._half, self._half + 1)
        waves = np.exp(2j * np.pi * np.outer(at_um, frequency))
        to_line = 4 / period_um * waves
        to_step = waves / (0.5j * np.pi * period_um * frequency)
        return np.asarray(to_step @ series), np.asarray(to_line @ series, complex)


@lru_cache(maxsize=MOST_MATRICES)
def _matrices(
    table: SpreadTable, count: int, cutoff_per_mm: float
) -> tuple[Complexes, Complexes]:
    """Return a table's matrices, kept for the next place."""
    return table.matrices(count, cutoff_per_mm)
