"""Where the tiles were in the photograph, which were left out, and how well the model describes each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from labkit.field.geometry import FieldGeometry
from labkit.figure_style import FAINT, HALF_IN, INK, SOFT_INK, Ink, chart
from labkit.findings import Finding
from labkit.key import Tile, same_range
from labkit.optics.field import FieldFrame
from labkit.report.charts import normal_quantiles
from labkit.report.field.maps import SEQUENTIAL, even_levels, frame_axes
from labkit.report.photographs import Photographs
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
    figure, axes = _pixel_axes(frame, photographs)
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


def _pixel_axes(frame: FieldFrame, photographs: Photographs) -> tuple[Figure, Axes]:
    """Return the frame in pixels with its photograph."""
    figure, axes = frame_axes(frame, HALF_IN, below_in=0.32, labelled=False)
    rows, columns = frame.shape_px
    axes.set(xlim=(-0.5, columns - 0.5), ylim=(rows - 0.5, -0.5))
    if photographs.preview is not None:
        shown, block = photographs.preview, photographs.preview_px
        edges = (-0.5, shown.shape[1] * block - 0.5, shown.shape[0] * block - 0.5, -0.5)
        axes.imshow(shown, cmap="gray", vmin=-0.6, vmax=1.1, extent=edges)
    return figure, axes


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


def fit_quality_chart(frame: FieldFrame, fits: Sequence[Wavefront], title: str) -> Figure:
    """Draw the χ² per pixel of each tile at its place."""
    places_px = np.array([mean_place_px([fit]) for fit in fits])
    chi2 = np.array([fit.chi2_per_pixel for fit in fits])
    flagged = [not fit.accepted for fit in fits]
    return tile_map(frame, places_px, chi2, flagged, title, "χ² per pixel")


def pulls_chart(title: str, pulls: Mapping[str, Floats], inks: Mapping[str, Ink]) -> Figure:
    """Draw quantiles of each channel's pulls against normal ones, with a 99 % band."""
    figure, axes = chart(HALF_IN, 3.2)
    axes.set_title(title)
    axes.axline((0, 0), slope=1, color=SOFT_INK, lw=0.8)
    for k, (channel, every) in enumerate(pulls.items()):
        normal, low, high, observed = normal_quantiles(every.ravel())
        if k == 0:
            axes.fill_between(normal, low, high, color=FAINT, lw=0)
        ink = inks[channel]
        axes.plot(
            normal, observed, ink.marker, ms=2.6, mew=0, color=ink.colour, label=channel
        )
    axes.set(xlabel="normal quantile, σ", ylabel="quantile of the pulls, σ")
    axes.legend(loc="upper left", handletextpad=0.2)
    return figure


def place_pulls_chart(geometry: FieldGeometry, inks: Mapping[str, Ink]) -> Figure:
    """Draw quantiles of the tiles' places less the model's, over their errors."""
    channels = np.array([place.key.channel for place in geometry.model.places])
    pulls = {
        channel: geometry.pulls[(channels == channel) & ~geometry.fit.apart]
        for channel in geometry.model.channels
    }
    return pulls_chart("places of the tiles", pulls, inks)


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
    rms = np.array([np.mean(of) ** 0.5 if of else np.nan for of in squares.values()])
    flagged = [tile in sight.doubtful for tile in squares]
    places_px = np.array([mean_place_px([sight.fits[tile]]) for tile in squares])
    title, unit = "pulls of tiles held out", "σ RMS"
    return tile_map(frame, places_px, rms, flagged, title, unit)


def place_pulls_map(geometry: FieldGeometry, sight: TileSight) -> Figure:
    """Draw the RMS of each tile's pulls over all ranges and channels; flagged: tiles set apart in any."""
    tiles = list(sight.fits)
    every = np.array([place.tile for place in geometry.model.places])
    pulls = geometry.pulls
    rms, flagged = [], []
    for tile in tiles:
        own = np.all(every == tile, axis=1)
        rms.append(float(np.sqrt(np.mean(pulls[own] ** 2))))
        flagged.append(bool(np.any(geometry.fit.apart[own])))
    places_px = np.array([mean_place_px([sight.fits[tile]]) for tile in tiles])
    title, unit = "pulls of the places", "σ RMS"
    frame = geometry.model.frame
    return tile_map(frame, places_px, np.array(rms), flagged, title, unit)


def tile_map(
    frame: FieldFrame,
    places_px: Floats,
    values: Floats,
    flagged: Sequence[bool],
    title: str,
    unit: str,
) -> Figure:
    """Draw a number (n,) of each tile at its place (n, 2); flagged tiles have a bold edge."""
    figure, axes = frame_axes(frame, HALF_IN, title=title, below_in=0.86)
    places = frame.heights_mm(places_px)
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
        edgecolors=[DOUBTFUL if bold else INK for bold in flagged],
        linewidths=[1.6 if bold else 0.4 for bold in flagged],
    )
    height_in = figure.get_size_inches()[1]
    at = (0.16, 0.3 / height_in, 0.5, 0.08 / height_in)
    bar = figure.colorbar(shown, cax=figure.add_axes(at), orientation="horizontal")
    bar.ax.tick_params(labelsize=7, pad=1, length=2, colors=SOFT_INK, labelcolor=INK)
    bar.ax.text(1.05, 0.5, unit, va="center", fontsize=7.5, transform=bar.ax.transAxes)
    bar.ax.grid(False)
    return figure
