"""The plates of the field: every figure of a FieldModel, encoded, with what its texts need."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from labkit.field.curves import Profile, profiles, usable_frequencies
from labkit.field.flats import session_illumination
from labkit.field.focus_curves import through_focus
from labkit.field.geometry import FieldGeometry
from labkit.field.illumination import RelativeIllumination
from labkit.field.limits import judge_limits
from labkit.field.pair import Pair
from labkit.field.session_geometry import (
    camera_tilt,
    corner_numbers,
    session_geometry,
)
from labkit.field.surfaces import ASTIGMATISM, focus_um
from labkit.field.tables import coverage
from labkit.field.target_tilt import SeparatedTilt
from labkit.field.terms import LensTerms, lens_terms
from labkit.field.tiles import covered, sign_is_open
from labkit.field.turned import planned_screws
from labkit.figure_style import HALF_IN, Ink
from labkit.optics.field import FieldModel
from labkit.optics.rim import ROUND_EVERYWHERE
from labkit.plan import leading_channel
from labkit.report.charts import quantile_chart
from labkit.report.field.cards import field_cards
from labkit.report.field.files import Rows, field_files
from labkit.report.field.geometry_charts import (
    distortion_chart,
    distortion_factor,
    lateral_chart,
    longest_um,
)
from labkit.report.field.maps import covering, map_chart
from labkit.report.field.profiles import (
    SIDES,
    Side,
    file_key,
    height_chart,
    inner_points,
    limits_um,
    lines_of,
    surfaces_chart,
    through_chart,
)
from labkit.report.field.sampled import (
    FOCUS_STEPS,
    MTF_STEPS,
    Grid,
    after_plane_um,
    mtf_over,
)
from labkit.report.field.shapes import (
    COMA,
    Shapes,
    astigmatism_chart,
    coma_chart,
    longest_waves,
    pupils_chart,
    stamp_half_width_um,
    stamps_chart,
)
from labkit.report.field.tables import (
    field_table,
    light_table,
    limit_table,
    places_table,
    screw_table,
    tilt_table,
)
from labkit.report.field.tile_charts import (
    TileSight,
    fit_quality_chart,
    held_out_map,
    held_out_pulls,
    place_pulls,
    place_pulls_map,
    tile_sight,
    tiles_chart,
)
from labkit.report.photographs import Photographs
from labkit.report.pictures import Panel, Plate, drawing, picture
from labkit.report.table import Card, millimetres
from labkit.results import Results, Wavefront
from labkit.types import Floats


@dataclass(frozen=True, eq=False)
class FieldArtist:
    """Draws the field's plates.

    model: of the field; inks: of the channels; results: of all tiles; nearest: the tile's wavefront whose photograph is
    shown
    """

    model: FieldModel
    inks: dict[str, Ink]
    results: Results
    nearest: Wavefront

    @cached_property
    def terms(self) -> list[LensTerms]:
        """The field of each channel in the words of the bench."""
        return [lens_terms(self.model, channel) for channel in self.model.channels]

    def cards(self) -> list[Card]:
        """Return what the report says of the field first."""
        return field_cards(self.terms)

    @cached_property
    def camera_tilt(self) -> SeparatedTilt | None:
        """The slope of focus that is the camera's, without the target's tilt; None where the places do not show it."""
        return camera_tilt(self.results, self.geometry)

    @property
    def tilt(self) -> Pair:
        """The slope of focus that screws change: the camera's, or that of the leading channel's focal surface."""
        camera = self.camera_tilt
        if camera is not None:
            return camera.slope
        (lead,) = (t for t in self.terms if t.channel == self.lead)
        return lead.tilt.slope

    @property
    def sign_open(self) -> bool:
        """Return whether tilt, curvature, astigmatism and focus may all have the other sign: no screw is then told to move."""
        return sign_is_open(self.results)

    @property
    def coverage(self) -> str:
        """The shares of the frame between the tiles' outermost edges, in words."""
        return coverage(covered(self.results, self.model))

    def contents(self) -> dict[str, Any]:
        """Return the values of templates/field.html.j2; None for a table without rows."""
        geometry, plan = self.geometry, self.results.plan
        others = {} if geometry is None else corner_numbers(geometry)
        limits = judge_limits(plan.limits, self.model, self.lead, others)
        told = plan.mount.screws_mm is not None and not self.sign_open
        screws = planned_screws(plan) if told else None
        camera = self.camera_tilt
        return {
            "camera_tilt": camera,
            "field_coverage": self.coverage,
            "field_sign_open": self.sign_open,
            "field_table": field_table(self.terms),
            "limit_table": limit_table(limits) if limits else None,
            "light_over_table": light_table(self.illumination),
            "places_table": None if geometry is None else places_table(geometry, others),
            "tilt_table": None if camera is None else tilt_table(camera),
            "screw_table": None if screws is None else screw_table(self.tilt, screws),
        }

    def files(self) -> Iterator[tuple[str, Rows, str]]:
        """Yield the name, the rows and the description of each file of numbers."""
        return field_files(self.results, self.model, self.profiles)

    @cached_property
    def tiles_mm(self) -> Floats:
        """(n, 2) y and x of the tiles of the shown photograph."""
        return self.model.frame.heights_mm(self.sight.places_px)

    @cached_property
    def sight(self) -> TileSight:
        """The tiles of the shown photograph."""
        return tile_sight(self.results, self.nearest)

    @property
    def lead(self) -> str:
        """The channel whose figures stand in the page; those of the others can be opened."""
        return leading_channel(self.model.channels)

    @cached_property
    def grid(self) -> Grid:
        """Places of the maps of focus."""
        return Grid.edge_to_edge(self.model.frame, FOCUS_STEPS)

    @cached_property
    def per_mm(self) -> Floats:
        """The frequencies of profiles, cycles/mm."""
        return usable_frequencies(self.model, self.lead)[0]

    @property
    def highest_per_mm(self) -> float:
        """The frequency of maps and of through-focus curves, cycles/mm."""
        return float(self.per_mm[-1])

    @cached_property
    def profiles(self) -> dict[str, tuple[Profile, ...]]:
        """Sagittal and tangential profiles of each channel along four lines."""
        lines = tuple(lines_of(self.model.frame))
        return {
            channel: profiles(self.model, channel, self.per_mm, lines)
            for channel in self.model.channels
        }

    def _along_lines(
        self,
        kind: str,
        channel: str,
        draw: Callable[[tuple[Profile, ...]], Figure],
        **of: object,
    ) -> Plate:
        """Return a plate of a channel's profiles, a panel for each line."""
        panels = []
        for azimuth, words in lines_of(self.model.frame).items():
            pair = tuple(p for p in self.profiles[channel] if p.azimuth_deg == azimuth)
            key = f"{channel}_{file_key(words)}"
            of_line = {"channel": channel, "line": words, **of}
            panels.append(drawing(kind, draw(pair), of_line, key))
        return Plate(f"{kind}s", panels)

    def focus(self) -> Iterator[Plate]:
        """Yield the focal surfaces: maps of each channel, profiles of the leading one."""
        surfaces = {
            channel: focus_um(self.model, channel, self.grid.places_px)
            for channel in self.model.channels
        }
        levels = covering([value for value, _ in surfaces.values()])
        towards = {t.channel: t.tilt.direction_deg for t in self.terms}
        maps = [
            self._map(
                "focus",
                channel,
                "focus error of the sensor",
                *surface,
                levels,
                towards=towards[channel],
            )
            for channel, surface in surfaces.items()
        ]
        yield Plate("field_focus", maps, across=3)
        yield self._after_plane(surfaces[self.lead][1])
        yield self._surfaces(self.lead)

    def _map(
        self,
        key: str,
        channel: str,
        words: str,
        value: Floats,
        std: Floats,
        levels: Floats,
        **settings: Any,
    ) -> Panel:
        title = f"{channel}  {words}"
        chart = map_chart(
            self.grid, value, title, "µm", levels, tiles_mm=self.tiles_mm, **settings
        )
        of = _extremes(channel, value, std, what=words)
        return picture("field_map", chart, of, f"{key}_{channel}")

    def _after_plane(self, std: Floats) -> Plate:
        channel = self.lead
        left = after_plane_um(self.model, channel, self.grid)
        places = self.grid.places_px
        pair = [focus_um(self.model, channel, places, d)[0] for d in SIDES]
        apart = pair[1] - pair[0]
        words = "tangential less sagittal"
        panels = [
            self._map("flat", channel, "after the best plane", *left, covering(left[:1])),
            self._map("apart", channel, words, apart, std, covering([apart])),
            self._map(
                "std", channel, "standard error", std, std, covering([std]), signed=False
            ),
        ]
        return Plate("field_flat", panels, across=3)

    def _surfaces(self, channel: str) -> Plate:
        limits = limits_um([p for of in self.profiles.values() for p in of])
        frame, ink = self.model.frame, self.inks[channel]
        return self._along_lines(
            "field_surface", channel, lambda pair: surfaces_chart(pair, frame, ink, limits)
        )

    def contrast(self) -> Iterator[Plate]:
        """Yield MTF over the frame, against height and through focus, and PSFs, of the leading channel."""
        yield from self._contrast(self.lead)

    def _contrast(self, channel: str) -> Iterator[Plate]:
        if not self.per_mm.size:
            return
        yield self._heights(channel)
        yield self._mtf_maps(channel)
        half_um = stamp_half_width_um(self.model, self.model.channels)
        ink = self.inks[channel]
        stamps = stamps_chart(self.model, channel, ink, half_um)
        frame = self.model.frame
        curves = through_focus(
            self.model, channel, [self.highest_per_mm], inner_points(frame)
        )
        through = through_chart(curves, frame, ink)
        of = {"channel": channel, "per_mm": self.highest_per_mm}
        yield Plate(
            "field_points",
            [
                picture("field_psf", stamps, of, channel),
                drawing("field_through", through, of, channel),
            ],
            width_um=2 * half_um,
        )

    def _heights(self, channel: str) -> Plate:
        frame, ink = self.model.frame, self.inks[channel]
        return self._along_lines(
            "field_height",
            channel,
            lambda pair: height_chart(pair, frame, ink),
            per_mm=self.per_mm.tolist(),
        )

    def _mtf_maps(self, channel: str) -> Plate:
        grid = Grid.edge_to_edge(self.model.frame, MTF_STEPS)
        over: dict[Side, tuple[Floats, Floats]] = {
            direction: mtf_over(self.model, channel, grid, self.highest_per_mm, direction)
            for direction in SIDES
        }
        levels = covering([value for value, _ in over.values()])
        panels = []
        for direction, (value, std) in over.items():
            title = f"{channel}  MTF at {self.highest_per_mm:g} cycles/mm, {direction}"
            figure = map_chart(
                grid, value, title, "", levels, signed=False, width_in=HALF_IN
            )
            per_mm = self.highest_per_mm
            of = _extremes(channel, value, std, direction=direction, per_mm=per_mm)
            key = f"{channel}_{direction}"
            panels.append(picture("field_mtf_map", figure, of, key))
        return Plate("field_mtf_maps", panels)

    def shapes(self) -> Iterator[Plate]:
        """Yield coma and astigmatism over the frame, of the leading channel, and the pupil unless round everywhere."""
        yield self._shapes(self.lead)
        if self.model.rim != ROUND_EVERYWHERE:
            pupils = pupils_chart(self.model)
            yield Plate("field_pupils", [drawing("field_pupils", pupils)])

    def _shapes(self, channel: str) -> Plate:
        ink = self.inks[channel]
        panels = []
        for kind, pair, draw in (
            ("field_coma", COMA, coma_chart),
            ("field_astigmatism", ASTIGMATISM, astigmatism_chart),
        ):
            shapes = Shapes.over(self.model, channel, pair)
            scale = longest_waves(self.model, pair)
            figure = draw(shapes, ink, scale)
            size = np.hypot(*shapes.waves.T)
            of = {"channel": channel, "low": size.min(), "high": size.max()}
            panels.append(drawing(kind, figure, of, channel))
        return Plate("field_shapes", panels)

    @cached_property
    def geometry(self) -> FieldGeometry | None:
        """Places where the lens puts the tiles; None for tiles that are no grid of equal targets."""
        return session_geometry(self.results)

    def places(self) -> Iterator[Plate]:
        """Yield distortion and lateral colour."""
        if (geometry := self.geometry) is None:
            return
        factor = distortion_factor(geometry)
        figure = distortion_chart(geometry, self.inks[self.lead], factor)
        corner = geometry.percent(self.model.frame.radius_mm)
        of = {"factor": factor, "percent": corner, "reference": geometry.model.channels[0]}
        panels = [drawing("field_distortion", figure, of)]
        longest = longest_um(geometry)
        for channel in geometry.model.channels[1:]:
            figure = lateral_chart(geometry, channel, self.inks[channel], longest)
            of = {"channel": channel, "scale": geometry.lateral_colour[channel].scale}
            panels.append(drawing("field_lateral", figure, of, channel))
        yield Plate("field_places", panels)

    @cached_property
    def illumination(self) -> dict[str, RelativeIllumination]:
        """Light over the frame of each channel, where the session has flats."""
        return session_illumination(self.results)

    def light(self) -> Iterator[Plate]:
        """Yield relative illumination."""
        maps = {
            channel: light.percent(self.grid.places_px)
            for channel, light in self.illumination.items()
        }
        if not maps:
            return
        levels = covering([value for value, _ in maps.values()])
        panels = []
        for channel, (value, std) in maps.items():
            title = f"{channel}  relative illumination"
            figure = map_chart(self.grid, value, title, "%", levels, signed=False)
            of = _extremes(channel, value, std)
            panels.append(picture("field_light", figure, of, channel))
        yield Plate("field_light", panels, across=3)

    def tiles(self, photographs: Photographs) -> Iterator[Plate]:
        """Yield where the tiles were, and how well the model describes them."""
        frame, sight = self.model.frame, self.sight
        if not sight.fits:
            return
        title = f"{self.nearest.channel}  {millimetres(sight.range_mm)}"
        of = {"sight": sight, "channel": self.nearest.channel}
        panels = [
            picture("field_tiles", tiles_chart(frame, sight, photographs), of),
            drawing("field_chi2", fit_quality_chart(frame, sight, title), of),
        ]
        yield Plate("field_tiles", panels)
        if pulls := held_out_pulls(self.results):
            rms = float(np.sqrt(np.mean(np.concatenate([*pulls.values()]) ** 2)))
            quantiles = self._quantiles("tiles held out", pulls)
            over_frame = held_out_map(self.results, frame, sight)
            yield Plate(
                "field_held_out",
                [
                    drawing("field_held_out", quantiles, {"rms": rms}),
                    drawing("field_held_out_map", over_frame, {"rms": rms}),
                ],
            )
        if (geometry := self.geometry) is not None:
            quantiles = self._quantiles("places of the tiles", place_pulls(geometry))
            over_frame = place_pulls_map(geometry, sight)
            outliers = {"geometry": geometry}
            yield Plate(
                "field_pulls",
                [
                    drawing("field_pulls", quantiles, outliers),
                    drawing("field_pulls_map", over_frame, outliers),
                ],
            )

    def _quantiles(self, title: str, pulls: dict[str, Floats]) -> Figure:
        return quantile_chart(title, pulls, self.inks, "pulls", (HALF_IN, 3.2))

    def others(self) -> Iterator[Plate]:
        """Yield the same plates of the other channels."""
        for channel in self.model.channels:
            if channel != self.lead:
                yield self._surfaces(channel)
                yield from self._contrast(channel)
                yield self._shapes(channel)


def _extremes(
    channel: str, value: Floats, std: Floats, **more: object
) -> dict[str, object]:
    """Return the least and greatest number of a channel's map, and its greatest error, for the map's text."""
    return {
        "channel": channel,
        "low": float(value.min()),
        "high": float(value.max()),
        "std": float(std.max()),
        **more,
    }
