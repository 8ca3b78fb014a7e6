"""Findings about the geometry of the field, and about tilts."""

from __future__ import annotations

from collections.abc import Iterator

from labkit.field.geometry import FieldGeometry
from labkit.field.target_tilt import SeparatedTilt
from labkit.findings.findings import Finding, found


def geometry_findings(geometry: FieldGeometry) -> Iterator[Finding]:
    """Yield what the places of the tiles say: tiles that contradict the others, a bent target, unknown numbers."""
    for key in geometry.outliers:
        yield found("tile-misplaced", key)
    if geometry.bend is not None:
        bend = geometry.bend
        yield found(
            "target-bent",
            None,
            {"depth": str(bend.depth_mm)},
            depth_mm=bend.depth_mm.as_json(),
            p_value=bend.p_value,
        )
    # a dome that may be there is hardly ever known, and moves distortion alone
    named = [what for what in geometry.unknown if not what.startswith("how far")]
    if named:
        yield found("places-undetermined", None, {"list": ", ".join(named)}, unknown=named)


def tilt_findings(tilt: SeparatedTilt) -> Iterator[Finding]:
    """Yield what is unknown of tilts, and a perspective that is not the target's tilt."""
    for words in tilt.unknown:
        yield found("tilt-untested", None, {"words": words})
    if tilt.perspective_contradicted:
        yield found(
            "perspective-contradicted",
            None,
            {"share_words": str(tilt.share)},
            share=tilt.share.as_json(),
            p_value=tilt.p_value,
        )
