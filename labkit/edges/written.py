"""A folder of what was measured of edges: JSON, and the depth map over the photograph."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from labkit.edges.depth_map import draw_depth_map
from labkit.edges.outcome import EdgesOutcome
from labkit.errors import TargetError
from labkit.figure_style import png, styled
from labkit.files import write_atomically, writing
from labkit.finder.find_target import grey_image
from labkit.photographs.decoding import read_photograph
from labkit.plan import Plan
from labkit.types import Floats


def write_outcome(
    folder: Path, outcome: EdgesOutcome, image: Path, plan: Plan
) -> list[Path]:
    """Write edges.json and edges.png; returns their paths. Raises InputError where they cannot be written."""
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    with styled():
        figure = draw_depth_map(_grey(image, plan), outcome)
    table, picture = folder / "edges.json", folder / "edges.png"
    write_atomically(
        table, json.dumps(outcome.as_json(), indent=1, allow_nan=False).encode() + b"\n"
    )
    write_atomically(picture, png(figure))
    return [table, picture]


def _grey(image: Path, plan: Plan) -> Floats:
    mosaic = read_photograph(image, plan.sensor)
    counts = mosaic.light
    try:
        return grey_image(counts, mosaic.pattern)
    except TargetError:  # nearly even
        white = mosaic.full_light
        return np.asarray(counts[: mosaic.shape[0], : mosaic.shape[1]] / white)
