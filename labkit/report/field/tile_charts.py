"""Where the tiles were in the photograph, which were left out, and how well the model describes each."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from math import nan

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from labkit.field.geometry import FieldGeometry
from labkit.figure_style import HALF_IN, INK
from labkit.findings.findings import Finding
from labkit.key import Tile, same_range
from labkit.optics.field import FieldFrame
from labkit.report.field.maps import SEQUENTIAL, colour_bar, even_levels, frame_axes
from labkit.report.photographs import Photographs
from labkit.report.pictures import show_frame
from labkit.report.tiles import mean_place_px
from labkit.results import Results, Wavefront
from labkit.types import Floats

FITTED, DOUBTFUL, LEFT_OUT = "#0072b2", "#d55e00", "#a8281c"


@dataclass(frozen=True, eq=False)
class TileSight:
    """The tiles of one range.

    range_mm: of the photographs; fits: of one channel, by tile; left_out: tiles that the photographs do not show whole, or
    that no fit was made of, with the reason in words
    """

    range_mm: float | None
    fits: Mapping[Tile, Wavefront]
    left_out: Mapping[Tile, str]

    @property
    def apart(self) -> bool:
        """Return whether tiles are of different photographs, each of one target at another place."""
        return len({fit.frames for fit in self.fits.values()}) > 1

    @property
    def doubtful(self) -> list[Tile]:
        """Tiles whose fit contradicts the others, or whose optimum is doubtful."""
        return [tile for tile, fit in self.fits.items() if fit.test and not fit.accepted]

    @property
    def places_px(self) -> Floats:
        """(n, 2) mean row and column of each fit's tile."""
        return np.array([mean_place_px([fit]) for fit in self.fits.values()])

    def corners_px(self, tile: Tile) -> Floats:
        """Return the corners (4, 2) of a tile; of one that was left out as its neighbours predict them."""
        if tile in self.fits:
            return _corners(self.fits[tile])
        known = np.array([[1.0, *at] for at in self.fits])
        corners = np.array([_corners(fit).ravel() for fit in self.fits.values()])
        terms = np.linalg.lstsq(known, corners, rcond=None)[0]
        return np.asarray(np.array([1.0, *tile]) @ terms).reshape(4, 2)


def _corners(fit: Wavefront) -> Floats:
    assert fit.placement is not None
    return np.asarray(fit.placement.corners_px.mean(axis=0))


def tile_sight(results: Results, nearest: Wavefront) -> TileSight:
    """Return the tiles of a wavefront's range and channel."""
    fits = {
        w.tile: w
        for w in results.at_range(nearest.range_mm)
        if w.channel == nearest.channel and w.tile is not None and w.placement is not None
    }
    left_out = dict[Tile, str]()
    for finding in results.findings:
        for tile in _tiles_of(finding, nearest.range_mm):
            if tile not in fits:
                left_out[tile] = finding.code
    return TileSight(nearest.range_mm, fits, left_out)


def _tiles_of(finding: Finding, range_mm: float | None) -> list[Tile]:
    """Return the tiles of a range that a finding says were left out."""
    if finding.code == "tile-left-out" and finding.key is not None:
        at, tiles = finding.key.range_mm, [finding.key.tile]
    elif finding.code == "tiles-not-found":
        at = finding.numbers.get("range_mm")  # type: ignore[assignment]
        tiles = finding.numbers.get("tiles", [])  # type: ignore[assignment]
    else:
        return []
    return (
        [(t[0], t[1]) for t in tiles if t is not None] if same_range(at, range_mm) else []
    )


def tiles_chart(frame: FieldFrame, sight: TileSight, photographs: Photographs) -> Figure:
    """Draw the outlines of the tiles in the photograph, with those left out dashed and crossed."""
    figure, axes = frame_axes(frame, HALF_IN, below_in=0.32, labelled=False)
    show_frame(axes, frame.shape_px, photographs, -0.6, 1.1)
    for tile in sight.fits:
        doubtful = tile in sight.doubtful
        _outline(axes, sight.corners_px(tile), DOUBTFUL if doubtful else FITTED, doubtful)
    for tile in sight.left_out:
        if sight.fits:
            corners = sight.corners_px(tile)
            _outline(axes, corners, LEFT_OUT, bold=False, dashes="--")
            axes.plot(*corners[[0, 2], ::-1].T, color=LEFT_OUT, lw=0.8)
            axes.plot(*corners[[1, 3], ::-1].T, color=LEFT_OUT, lw=0.8)
    _tile_legend(figure, sight)
    return figure


def _outline(
    axes: Axes, corners: Floats, colour: str, bold: bool, dashes: str = "-"
) -> None:
    closed = corners[[0, 1, 2, 3, 0], ::-1]
    axes.plot(*closed.T, color=colour, lw=2.0 if bold else 1.0, ls=dashes)


def _tile_legend(figure: Figure, sight: TileSight) -> None:
    kinds = [("measured", FITTED, "-", len(sight.fits) - len(sight.doubtful))]
    kinds += [("doubtful", DOUBTFUL, "-", len(sight.doubtful))]
    kinds += [("left out", LEFT_OUT, "--", len(sight.left_out))]
    figure.legend(
        handles=[
            Line2D([], [], color=colour, ls=dashes, label=f"{count} {words}")
            for words, colour, dashes, count in kinds
            if count
        ],
        loc="lower left",
        ncols=3,
        borderpad=0,
        handlelength=1.6,
    )


def fit_quality_chart(frame: FieldFrame, sight: TileSight, title: str) -> Figure:
    """Draw the χ² per pixel of each tile at its place."""
    chi2 = {tile: fit.chi2_per_pixel for tile, fit in sight.fits.items()}
    flagged = {tile for tile, fit in sight.fits.items() if not fit.accepted}
    return tile_map(frame, sight, chi2, flagged, title, "χ² per pixel")


def place_pulls(geometry: FieldGeometry) -> dict[str, Floats]:
    """Return the pulls of the tiles' places by channel: residuals of the model over their errors, without outliers."""
    channels = np.array([place.key.channel for place in geometry.model.places])
    return {
        channel: geometry.pulls[(channels == channel) & ~geometry.fit.apart]
        for channel in geometry.model.channels
    }


def held_out_pulls(results: Results) -> dict[str, Floats]:
    """Return the pulls (fits, modes) of tiles that are held out, by channel; without channels that have none."""
    every = {
        channel: [w.pulls for w in results.of_channel(channel) if w.pulls is not None]
        for channel in results.channels
    }
    return {channel: np.array(pulls) for channel, pulls in every.items() if pulls}


def held_out_map(results: Results, frame: FieldFrame, sight: TileSight) -> Figure:
    """Draw the RMS of each tile's pulls over all ranges and channels; flagged: tiles with a doubtful fit."""
    squares: dict[Tile, list[float]] = {tile: [] for tile in sight.fits}
    for wavefront in results:
        if wavefront.tile in squares and wavefront.pulls is not None:
            squares[wavefront.tile].append(float(np.mean(wavefront.pulls**2)))
    rms = {tile: float(np.mean(of or nan)) ** 0.5 for tile, of in squares.items()}
    title = "pulls of tiles held out"
    return tile_map(frame, sight, rms, sight.doubtful, title, "σ RMS")


def place_pulls_map(geometry: FieldGeometry, sight: TileSight) -> Figure:
    """Draw the RMS of each tile's pulls over all ranges and channels; flagged: tiles set apart in any."""
    every = np.array([place.tile for place in geometry.model.places])
    own = {tile: np.all(every == tile, axis=1) for tile in sight.fits}
    squares = {tile: geometry.pulls[at] ** 2 for tile, at in own.items()}
    rms = {tile: float(np.mean(of)) ** 0.5 for tile, of in squares.items()}
    flagged = {tile for tile, at in own.items() if np.any(geometry.fit.apart[at])}
    frame = geometry.model.frame
    return tile_map(frame, sight, rms, flagged, "pulls of the places", "σ RMS")


def tile_map(
    frame: FieldFrame,
    sight: TileSight,
    numbers: Mapping[Tile, float],
    flagged: Collection[Tile],
    title: str,
    unit: str,
) -> Figure:
    """Draw a number of each tile at its place; flagged tiles have a bold edge."""
    figure, axes = frame_axes(frame, HALF_IN, title=title, below_in=0.86)
    places = frame.heights_mm(sight.places_px)
    values = np.array([numbers[tile] for tile in sight.fits])
    bold = [tile in flagged for tile in sight.fits]
    levels = even_levels(float(np.nanmin(values)), float(np.nanmax(values)))
    shown = axes.scatter(
        places[:, 1],
        places[:, 0],
        c=values,
        cmap=SEQUENTIAL,
        vmin=levels[0],
        vmax=levels[-1],
        s=np.clip(9000 / len(values), 8, 160),
        marker="s",
        edgecolors=[DOUBTFUL if each else INK for each in bold],
        linewidths=[1.6 if each else 0.4 for each in bold],
    )
    colour_bar(figure, shown, unit, width=0.5)
    return figure
