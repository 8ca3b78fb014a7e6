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
    from labkit.acquisition.capture import capture
    from labkit.advice.advise import advise
    from labkit.analysis.fit import fit
    from labkit.analysis.image import fit_image
    from labkit.devices.registry import open_devices
    from labkit.errors import LabkitError
    from labkit.imaging.optics import Optics
    from labkit.plan import Plan
    from labkit.report.html import write_report
    from labkit.results import Results, Wavefront
    from labkit.session.import_frames import import_frames
    from labkit.session.session import Session
    from labkit.target import open_target
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
    "capture": "acquisition.capture",
    "fit": "analysis.fit",
    "fit_image": "analysis.image",
    "import_frames": "session.import_frames",
    "open_devices": "devices.registry",
    "open_target": "target",
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
    "capture",
    "fit",
    "fit_image",
    "import_frames",
    "open_devices",
    "open_target",
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
