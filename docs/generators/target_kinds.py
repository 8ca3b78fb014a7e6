"""Every kind of target that is installed, from its entry point."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points

from docs.generators.markdown import code
from labkit.plan.tables import NEEDED_BY_KIND
from labkit.target.target import open_target

EXAMPLES = {
    "sierpinski": "sierpinski:order=5,size_mm=46.8",
    "tribar": "tribar:order=5,size_mm=46.8",
    "checkerboard": "checkerboard:cells=16,size_mm=46.8",
    "slanted_edge": "slanted_edge:size_mm=46.8,angle_deg=5",
    "noise": "noise:cells=128,size_mm=46.8,seed=1",
    "wedge": "wedge:size_mm=100",
}
"""Specifications that `labkit target render` takes, of kinds that need neither a file nor a list."""


def target_kinds() -> str:
    """A section for each kind: what it is, which keys it needs, an example."""
    kinds = sorted(entry_points(group="labkit.targets"), key=lambda entry: entry.name)
    return "\n".join(line for entry in kinds for line in _section(entry))


def _section(entry: EntryPoint) -> Iterator[str]:
    module, factory = import_module(entry.module), entry.load()
    yield f"## {code(entry.name)}\n"
    yield f"{(module.__doc__ or '').strip()}\n"
    yield f"{(factory.__doc__ or '').strip().replace('``', '`').replace('spec.', 'target.')}\n"
    needed = ("kind", "size_mm", *NEEDED_BY_KIND.get(entry.name, ()))
    yield f"Needs {', '.join(f'{{confval}}`target.{key}`' for key in needed)}.\n"
    if spec := EXAMPLES.get(entry.name):
        height, width = open_target(spec).size_mm
        yield f"```\nlabkit target render {spec} {entry.name}.pdf    # {height:g} × {width:g} mm\n```\n"
