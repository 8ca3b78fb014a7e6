"""What was found of the camera, and what it was asked about: rows of text."""

from __future__ import annotations

from labkit.report.quantities import estimated, fixed
from labkit.results import Results

NAMES = {
    "low_pass_filter": "low-pass filter",
    "low_pass_filter_turned": "low-pass filter, turned by 45°",
    "diffusion": "charge diffusion",
    "smear": "smear",
    "veil": "veil of stray light",
    "spectrum": "spectrum",
    "panel_pixels": "the panel's pixels",
}
"""Parts of the camera, as results name them, in words."""

NUMBERS = {
    "spread_px": "distance of its spots",
    "rows_px": "along rows",
    "columns_px": "along columns",
    "sigma_px": "standard deviation",
    "width_nm": "standard deviation",
    "share": "of all light",
    "lit_across": "share of its third that a stripe is lit over",
    "lit_down": "share of the pitch along it",
}


def part_rows(results: Results) -> list[dict[str, str]]:
    """Name, what of it, unit and estimate of each number of the parts that were fitted."""
    rows, before = list[dict[str, str]](), ""
    for key, number in results.model_parts.items():
        part, *channel, what = key.split(".")
        of = ", ".join([NUMBERS.get(what, what), *channel])
        name = NAMES.get(part, part) if part != before else ""
        rows.append({"name": name, "of": of, "unit": number.unit, "estimate": estimated(number), "first": name})
        before = part
    return rows


def missing_words(results: Results) -> str:
    """What the data call for that the model lacks, in words; nothing where it lacks nothing."""
    return ", ".join(NAMES.get(name, name) for name in dict.fromkeys(name for w in results for name in w.missing))


def tried_rows(results: Results) -> list[dict[str, str]]:
    """Parts that the photographs were asked about: what each would gain, and whether it was taken in."""
    return [
        {"name": NAMES.get(p.name, p.name), "gain": fixed(p.gain, 1), "adopted": "taken in" if p.adopted else ""}
        for p in results.parts_tried
    ]
