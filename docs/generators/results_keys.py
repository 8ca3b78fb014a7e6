"""Every key of results.json: the keys from what is written, their meanings from here, and neither without the other."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from docs.generators.markdown import code
from docs.generators.results_meanings import MEANINGS, OPEN
from tests.results_samples import full_results


def results_keys() -> str:
    """An entry for each key. Raises ValueError for keys without a meaning, and for meanings without a key."""
    keys = list(dict.fromkeys(_keys("", full_results().as_json())))
    unknown, stale = set(keys) - set(MEANINGS), set(MEANINGS) - set(keys)
    if unknown or stale:
        raise ValueError(
            f"docs/generators/results_meanings.py: lacks {sorted(unknown)}, has too much {sorted(stale)}"
        )
    return "\n".join(f"{code(key)}\n: {MEANINGS[key]}\n" for key in keys)


def _keys(where: str, value: Any) -> Iterator[str]:
    """Dotted keys; [] stands for each item of a list, NAME for a key that depends on the session."""
    if where.removesuffix(".") in OPEN:
        return
    if isinstance(value, dict):
        for key, inner in value.items():
            name = "NAME" if where in NAMED else key
            yield f"{where}{name}"
            yield from _keys(f"{where}{name}.", inner)
    elif isinstance(value, list) and value and isinstance(value[0], dict):
        for item in value:
            yield from _keys(f"{where.removesuffix('.')}[].", item)


NAMED = {
    "field.lateral_colour.",
    "focus.best_focus_mm.",
    "lens.wavelengths_nm.",
    "focus.residual_waves.",
    "focus.residual_std_waves.",
    "budget.",
    "joint.",
    "model_parts.",
    "common.stated.",
    "light.",
    "widest_light_nm.",
    "focus_waves_per_nm.",
}
"""Tables whose keys depend on the session."""
