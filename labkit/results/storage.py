"""results.json, psf.npz and residuals.npz: no other module knows their format."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from labkit.errors import DataError, NewerError, PlanError, shown
from labkit.key import Key
from labkit.optics.field import FieldModel
from labkit.plan import Plan
from labkit.results.arrays import RESIDUAL_PARTS, Mapped, Named, psfs
from labkit.results.arrays import residuals as kept_residuals
from labkit.results.model import Residuals, Wavefront
from labkit.results.schema import READABLE, Content
from labkit.storage import npz
from labkit.storage.files import (
    check_name,
    drop_link,
    refuse_links,
    replacing,
    write_atomically,
    writing,
)
from labkit.storage.reading import read_bytes, read_text, reason

if TYPE_CHECKING:
    from labkit.results.results import Results

RESULTS_FILE = "results.json"
RESIDUALS = "residuals.npz"
PSFS = "psf.npz"
FIELD_FILE = "field.npz"
COVARIANCE = "covariance"  # of the field's coefficients
MOST_NUMBER_BYTES = 8  # of a number
MOST_RESULT_PIXELS = 2**28  # of any photograph
MOST_RESULTS_BYTES = 2**27  # of results.json, 15 kB a fit
MOST_RESIDUALS_BYTES = 2**29  # earlier labkits kept all
MOST_FIELD_BYTES = 2**26
REPORT_FILES = (
    "report.html",
    "figures",
)  # made of results: stale as soon as there are others


def write(folder: Path, results: Results, mapped: Mapped = map) -> Path:
    """Write all files into a folder, each whole or not at all, results.json last; the report of earlier results goes.

    mapped: draws the PSFs. Returns the path of results.json. Raises InputError where the folder cannot be written to, or is
    a link.
    """
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    refuse_links(folder)
    made_of: dict[str, Named] = {
        PSFS: psfs(results.wavefronts, mapped),
        RESIDUALS: kept_residuals(results.wavefronts),
    }
    if results.field is not None:
        made_of[FIELD_FILE] = iter([(COVARIANCE, results.field.covariance)])
    content = json.dumps(entry(results), indent=1, allow_nan=False).encode() + b"\n"
    with ExitStack() as last_first:
        # files take their places together, so that those of two fits never lie side by side for long
        last_first.enter_context(replacing(folder / RESULTS_FILE)).write(content)
        for name, arrays in made_of.items():
            npz.write(last_first.enter_context(replacing(folder / name)), arrays)
        (folder / REPORT_FILES[0]).unlink(missing_ok=True)
        drop_link(folder / REPORT_FILES[1])
        shutil.rmtree(folder / REPORT_FILES[1], ignore_errors=True)
    return folder / RESULTS_FILE


def read(folder: Path, name: str, *, residuals: bool = True) -> dict[str, Any]:
    """The fields of results: of a session's folder those of that name, or those of a results folder.

    residuals: whether to read the residuals too. Raises DataError, SessionError for a name that is unsafe, and for links, and
    NewerError for results of a later schema.
    """
    session = folder / "results"
    place = (
        session / check_name(name)
        if session.is_dir() or not (folder / RESULTS_FILE).exists()
        else folder
    )
    path = place / RESULTS_FILE
    refuse_links(session, place, path, place / RESIDUALS, place / FIELD_FILE)
    try:
        text = read_text(path, MOST_RESULTS_BYTES)
        schema = _schema(text)
    except (FileNotFoundError, NotADirectoryError):
        raise DataError(f"no {path}: run labkit fit first{_others(session)}") from None
    except (OSError, ValueError, RecursionError) as error:
        why = reason(error)
        raise DataError(f"cannot read {path}: {why}; fit the session again") from None
    _refuse_newer(path, schema)
    if schema not in READABLE:
        known = f"{READABLE[0]} to {READABLE[-1]}"
        raise DataError(
            f"{path} has schema {shown(schema)}; this version reads schemas {known}: fit the session again"
        )
    try:
        content = Content.parse(text)
        plan = plan_of(content, place)
        fields = content.fields(plan)
    except PlanError as error:
        raise DataError(f"{path}: {error}; fit the session again") from None
    except ValueError as error:
        raise DataError(
            f"{path} is not as schema {schema} has it: {error}; fit the session again"
        ) from None
    fields["field"] = _field(content, plan, place / FIELD_FILE)
    if residuals:
        fields["wavefronts"] = tuple(
            _with_residuals(fields["wavefronts"], place / RESIDUALS)
        )
    return {**fields, "plan": plan, "folder": place}


def kept_keys(folder: Path) -> set[Key]:
    """Keys of the wavefronts whose results a folder holds; empty without readable results.

    Raises NewerError.
    """
    try:
        content = kept_content(folder)
        return {entry.identity for entry in content.wavefronts} if content else set()
    except ValueError:
        return set()


def kept_content(folder: Path) -> Content | None:
    """Return the content of a folder's results.json; None where there is none.

    Raises NewerError for results of a later schema, ValueError for a corrupt file or one that cannot be read.
    """
    try:
        text = read_text(folder / RESULTS_FILE, MOST_RESULTS_BYTES)
        schema = _schema(text)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
    except OSError as error:
        raise ValueError(reason(error)) from error
    _refuse_newer(folder / RESULTS_FILE, schema)
    return Content.parse(text)


def accept_failed_fits(folder: Path) -> None:
    """Record in a folder's results.json that the user accepts the results without failed fits.

    Raises InputError where the folder cannot be written to.
    """
    content = json.loads(read_text(folder / RESULTS_FILE, MOST_RESULTS_BYTES))
    content["made_from"]["failed_accepted"] = True
    content["unanswered"] = None
    text = json.dumps(content, indent=1, allow_nan=False) + "\n"
    write_atomically(folder / RESULTS_FILE, text.encode())


def set_aside_corrupt(folder: Path) -> Path | None:
    """Rename results.json to results.json.corrupt if unreadable; return the new path, or None.

    Raises NewerError, and InputError where the folder cannot be written to.
    """
    try:
        kept_content(folder)
    except ValueError:
        aside = folder / f"{RESULTS_FILE}.corrupt"
        with writing(aside):
            (folder / RESULTS_FILE).rename(aside)
        return aside
    return None


def _refuse_newer(path: Path, schema: Any) -> None:
    """Raise NewerError for results of a later schema."""
    if isinstance(schema, int) and schema > READABLE[-1]:
        raise NewerError(
            f"{path} has schema {schema}, of a newer labkit; this version knows schemas to {READABLE[-1]}: "
            "update labkit, or give another name (--name)"
        )


def _schema(text: str) -> Any:
    """Return the number of a file's schema; None where it states none. Raises ValueError for other content than JSON."""
    entry = json.loads(text)
    return entry.get("schema") if isinstance(entry, dict) else None


def entry(results: Results) -> dict[str, Any]:
    """The content of results.json."""
    return Content.of_results(results).written()


def _others(session: Path) -> str:
    names = sorted(path.parent.name for path in session.glob(f"*/{RESULTS_FILE}"))
    return f"; results there are: {', '.join(names)} (--name)" if names else ""


def _with_residuals(wavefronts: Sequence[Wavefront], path: Path) -> Iterator[Wavefront]:
    """Yield wavefronts with their residuals in a file, where it holds them."""
    most_bytes = {
        f"{part}_{w.key}": MOST_NUMBER_BYTES * len(w.poses) * _pixels(w)
        for w in wavefronts
        for part in RESIDUAL_PARTS
    }
    try:
        arrays = npz.unpacked(read_bytes(path, MOST_RESIDUALS_BYTES), most_bytes.get)
        for w in wavefronts:
            names = [f"{part}_{w.key}" for part in RESIDUAL_PARTS]
            if all(name in arrays for name in names):
                w = replace(w, residuals=Residuals(*(arrays[name] for name in names)))
            yield w
    except FileNotFoundError:
        yield from wavefronts
    except (OSError, ValueError) as error:
        why = reason(error)
        raise DataError(f"cannot read {path}: {why}; fit the session again") from None


def _field(content: Content, plan: Plan, path: Path) -> FieldModel | None:
    """Return the wavefront over the field, with its covariance in a file. Raises DataError."""
    if (entry := content.field) is None:
        return None
    most_bytes = MOST_NUMBER_BYTES * len(entry.terms) ** 2
    try:
        arrays = npz.unpacked(
            read_bytes(path, MOST_FIELD_BYTES), {COVARIANCE: most_bytes}.get
        )
        return entry.model(
            np.asarray(arrays[COVARIANCE], float),
            plan.sensor.pixel_pitch_um,
            plan.reference_wavelength_nm,
        )
    except (OSError, ValueError, KeyError) as error:
        why = reason(error)
        raise DataError(f"cannot read {path}: {why}; fit the session again") from None


def _pixels(w: Wavefront) -> int:
    """Return the largest number of pixels that a wavefront was fitted to in a photograph."""
    return MOST_RESULT_PIXELS if w.placement is None else prod(w.placement.shape_px)


def plan_of(content: Content, folder: Path) -> Plan:
    """Return the plan that the results were made with; of results that do not hold it, the session's."""
    if content.plan is None:
        return Plan.load(folder.resolve().parents[1] / "plan.toml")
    try:
        return Plan.from_tables(content.plan, files_needed=False)
    except PlanError as error:
        raise PlanError(f"the plan in it cannot be read: {error}") from None
