"""The tiles of a session at a glance: fits, agreement with the field's model, and reasons for tiles left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from labkit.optics.field import FieldModel
from labkit.results import Results, Wavefront
from labkit.types import Floats

Place = tuple[int, int]


@dataclass(frozen=True, eq=False)
class Tile:
    """A tile with its fits at all ranges and in all channels.

    Parameters
    ----------
    tile : (row, column)
    centre_px : (2,) row and column of its middle, the mean of all fits; nan without a fit
    fits, accepted : numbers of fits, and of accepted ones
    pull : RMS of the pulls of its fits, see `Wavefront.pulls`; near 1 where tile and model
        agree, nan without accepted fits
    remarks : why it, or some of its fits, are left out
    """

    tile: Place
    centre_px: Floats
    fits: int
    accepted: int
    pull: float
    remarks: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """Return the fields, null for numbers that are nan."""
        known = bool(np.all(np.isfinite(self.centre_px)))
        return {
            "tile": list(self.tile),
            "centre_px": self.centre_px.tolist() if known else None,
            "fits": self.fits,
            "accepted": self.accepted,
            "pull": self.pull if np.isfinite(self.pull) else None,
            "remarks": list(self.remarks),
        }


def tiles_of(results: Results, model: FieldModel) -> tuple[Tile, ...]:
    """Return the tiles of a session by row and column, those without a fit included."""
    fits: dict[Place, list[Wavefront]] = {}
    for wavefront in results:
        if wavefront.tile is not None:
            fits.setdefault(wavefront.tile, []).append(wavefront)
    remarks = _remarks(results)
    return tuple(
        _tile(tile, fits.get(tile, []), model, remarks.get(tile, []))
        for tile in sorted({*fits, *remarks})
    )


def covered(results: Results, model: FieldModel) -> tuple[float, float]:
    """Return the shares of the frame's height and width between the outermost edges of accepted tiles; 0 without any."""
    corners = [
        fit.placement.corners_px.reshape(-1, 2)
        for fit in results
        if fit.tile is not None and fit.placement is not None and fit.accepted
    ]
    if not corners:
        return 0.0, 0.0
    extent = np.ptp(np.concatenate(corners), axis=0) / model.frame.shape_px
    down, right = np.minimum(extent, 1.0).tolist()
    return down, right


def sign_is_open(results: Results) -> bool:
    """Return whether all even modes may have the other sign together, as from one range."""
    return len(results.ranges_mm) < 2 or any(fit.sign_open for fit in results)


def _tile(
    tile: Place, fits: Sequence[Wavefront], model: FieldModel, remarks: Sequence[str]
) -> Tile:
    """Return a tile with its fits."""
    accepted = [fit for fit in fits if fit.accepted]
    middles = [middle for fit in fits if (middle := _middle_px(fit)) is not None]
    pulls = [fit.pulls for fit in accepted if fit.pulls is not None]
    return Tile(
        tile,
        np.mean(middles, axis=0) if middles else np.full(2, np.nan),
        len(fits),
        len(accepted),
        float(np.sqrt(np.mean(np.square(pulls)))) if pulls else float("nan"),
        tuple(remarks),
    )


def _middle_px(fit: Wavefront) -> Floats | None:
    """Return the middle (2,) of the target in the photographs; None where its place is not kept."""
    if fit.placement is None:
        return None
    return np.array(fit.placement.centre_px)


def _remarks(results: Results) -> dict[Place, list[str]]:
    """Return what findings say of each tile."""
    found: dict[Place, list[str]] = {}
    for finding in results.findings:
        named = finding.numbers.get("tiles")
        if finding.key is not None and finding.key.tile is not None:
            found.setdefault(finding.key.tile, []).append(finding.text)
        for tile in named if isinstance(named, list) else []:
            if isinstance(tile, list) and len(tile) == 2:
                row, column = tile
                place = int(str(row)), int(str(column))
                found.setdefault(place, []).append(_short(finding.code, finding.numbers))
    return found


def _short(code: str, numbers: Any) -> str:
    """Return a finding on many tiles in few words."""
    range_mm = numbers.get("range_mm")
    at = "" if range_mm is None else f" at {range_mm:g} mm"
    return code.removeprefix("tiles-").replace("-", " ") + at
