"""Pages of the documentation that are made from the code, so that nothing in them is kept by hand.

A line ``<!-- generated: NAME -->`` in a page is replaced by what the function of that name in `MADE` returns, as Markdown.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from docs.generators.api import device_api, public_api, related_api
from docs.generators.commands import commands
from docs.generators.gallery import gallery
from docs.generators.plan_keys import lights, panels, plan_keys
from docs.generators.results_keys import results_keys
from docs.generators.target_kinds import target_kinds

MADE: dict[str, Callable[[], str]] = {
    "commands": commands,
    "device_api": device_api,
    "gallery": gallery,
    "lights": lights,
    "panels": panels,
    "plan_keys": plan_keys,
    "public_api": public_api,
    "related_api": related_api,
    "results_keys": results_keys,
    "target_kinds": target_kinds,
}

PLACE = re.compile(r"^<!-- generated: (\w+) -->$", re.MULTILINE)


def filled(text: str) -> str:
    """A page with every place for something generated filled. Raises KeyError for a name that is not known."""
    return PLACE.sub(lambda place: MADE[place[1]](), text)
