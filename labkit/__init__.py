"""labkit measures a camera's optics from photographs of a known target.

All public names are here. A name is loaded at its first use, so `import labkit` is quick.

>>> import labkit
>>> results = labkit.fit("my-session")
>>> print(results.focus["G"])
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from labkit.version import __version__

if TYPE_CHECKING:
    from labkit.acquisition.camera_check import camera_settings, check_camera
    from labkit.acquisition.capture import capture
    from labkit.acquisition.focusing import watch_focus
    from labkit.advice.advise import advise
    from labkit.analysis.fit import fit
    from labkit.analysis.image import fit_image
    from labkit.analysis.reprocess import reprocess
    from labkit.calibration.tone_wedge import measure_tone
    from labkit.catalogue.sessions import (
        compare_sessions,
        lens_history,
        list_sessions,
        rebuild_catalogue,
    )
    from labkit.charts.measurement import measure_chart
    from labkit.demo import run_demo
    from labkit.devices.inventory import list_connected
    from labkit.devices.rail_calibration import calibrate_rail
    from labkit.devices.registry import open_devices
    from labkit.devices.serve_target import serve_target
    from labkit.edges.measurement import measure_edges
    from labkit.errors import LabkitError
    from labkit.experiments.runner import run_study
    from labkit.field.summary import summarise_field
    from labkit.field.turned import check_screw_move, split_fields
    from labkit.imaging.optics import Optics
    from labkit.noise.measure import measure_noise
    from labkit.plan import Plan
    from labkit.report.html import write_report
    from labkit.restoration.scenes import restore
    from labkit.results import Results, Wavefront
    from labkit.session.draft_plan import draft_plan
    from labkit.session.import_frames import import_frames
    from labkit.session.session import Session
    from labkit.session.verify import verify
    from labkit.target.rendering import render_target
    from labkit.target.target import open_target
    from labkit.uncertain import Uncertain

_PLACES = {
    "LabkitError": "errors",
    "Optics": "imaging.optics",
    "Plan": "plan",
    "Results": "results",
    "Session": "session.session",
    "Uncertain": "uncertain",
    "Wavefront": "results",
    "advise": "advice.advise",
    "calibrate_rail": "devices.rail_calibration",
    "camera_settings": "acquisition.camera_check",
    "capture": "acquisition.capture",
    "check_camera": "acquisition.camera_check",
    "compare_sessions": "catalogue.sessions",
    "draft_plan": "session.draft_plan",
    "fit": "analysis.fit",
    "fit_image": "analysis.image",
    "import_frames": "session.import_frames",
    "lens_history": "catalogue.sessions",
    "list_connected": "devices.inventory",
    "list_sessions": "catalogue.sessions",
    "measure_chart": "charts.measurement",
    "summarise_field": "field.summary",
    "check_screw_move": "field.turned",
    "split_fields": "field.turned",
    "measure_edges": "edges.measurement",
    "measure_noise": "noise.measure",
    "measure_tone": "calibration.tone_wedge",
    "open_devices": "devices.registry",
    "open_target": "target.target",
    "rebuild_catalogue": "catalogue.sessions",
    "render_target": "target.rendering",
    "reprocess": "analysis.reprocess",
    "restore": "restoration.scenes",
    "run_demo": "demo",
    "run_study": "experiments.runner",
    "serve_target": "devices.serve_target",
    "verify": "session.verify",
    "watch_focus": "acquisition.focusing",
    "write_report": "report.html",
}

__all__ = [
    "LabkitError",
    "Optics",
    "Plan",
    "Results",
    "Session",
    "Uncertain",
    "Wavefront",
    "__version__",
    "advise",
    "calibrate_rail",
    "camera_settings",
    "capture",
    "check_camera",
    "check_screw_move",
    "compare_sessions",
    "draft_plan",
    "fit",
    "fit_image",
    "import_frames",
    "lens_history",
    "list_connected",
    "list_sessions",
    "measure_chart",
    "measure_edges",
    "measure_noise",
    "measure_tone",
    "open_devices",
    "open_target",
    "rebuild_catalogue",
    "render_target",
    "reprocess",
    "restore",
    "run_demo",
    "run_study",
    "serve_target",
    "split_fields",
    "summarise_field",
    "verify",
    "watch_focus",
    "write_report",
]


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module 'labkit' has no attribute {name!r}")
    value = getattr(import_module(f"labkit.{_PLACES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
