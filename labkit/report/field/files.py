"""Numbers of the field as tables to download: its coefficients, its profiles, and all tiles."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import product

import numpy as np

from labkit.field.curves import Band, Profile
from labkit.optics.field import FieldModel
from labkit.report.field.profiles import lines_of
from labkit.report.tiles import mean_place_px
from labkit.results import Results
from labkit.storage.spreadsheet import Cell

Rows = Iterable[Sequence[Cell]]


def field_files(
    results: Results, model: FieldModel, profiles: Mapping[str, Sequence[Profile]]
) -> Iterator[tuple[str, Rows, str]]:
    """Yield the name, the rows and the description of each file. profiles: of each channel."""
    yield "field.csv", _terms(model), "coefficients of the field's model"
    yield (
        "field_profiles.csv",
        _profiles(model, profiles),
        "focus and MTF against image height",
    )
    yield "tiles.csv", _tiles(results), "all tiles, ranges and channels"


def _terms(model: FieldModel) -> Rows:
    yield "channel", "field_noll", "pupil_noll", "waves_rms", "std_waves_rms"
    std = np.sqrt(np.diag(model.covariance))
    names = product(model.channels, model.field, model.noll)
    for name, *number in zip(names, model.waves.ravel(), std, strict=True):
        yield *name, *map(float, number)


def _profiles(model: FieldModel, of: Mapping[str, Sequence[Profile]]) -> Rows:
    yield "channel", "line", "height_mm", "direction", "quantity", "value", "std"
    names = lines_of(model.frame)
    for channel, profile in ((c, p) for c, each in of.items() for p in each):
        where = (channel, names[profile.azimuth_deg])
        bands = {"focus_error_um": profile.focus_um, "mtf50_per_mm": profile.mtf50_per_mm}
        for k, frequency in enumerate(profile.frequency_per_mm):
            band = Band(profile.mtf.value[k], profile.mtf.std[k])
            bands[f"mtf_at_{frequency:g}_per_mm"] = band
        for name, band in bands.items():
            rows = zip(profile.height_mm, band.value, band.std, strict=True)
            for height, value, std in rows:
                number = (name, float(value), float(std))
                yield *where, float(height), profile.surface, *number


def _tiles(results: Results) -> Rows:
    noll = results.wavefronts[0].noll
    head = ["range_mm", "channel", "row", "column", "row_px", "column_px", "accepted"]
    modes = [name for j in noll for name in (f"waves_{j}", f"std_{j}")]
    yield [*head, "chi2_per_pixel", *modes]
    for w in results:
        numbers: Sequence[Cell] = [None] * len(modes)
        if w.noll == noll:
            numbers = np.column_stack([w.waves, w.std]).ravel().tolist()
        place = mean_place_px([w]).tolist()
        tile = w.tile or (None, None)
        where = (w.range_mm, w.channel, *tile, *place, str(w.accepted).lower())
        yield [*where, w.chi2_per_pixel, *numbers]
