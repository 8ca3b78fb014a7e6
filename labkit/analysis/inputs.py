"""Inputs of a fit: what its results record of them, and whether results are up to date."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from labkit.numerics import source_digest
from labkit.results.entries import MadeFrom
from labkit.results.schema import Content
from labkit.session.session import Session
from labkit.session.stored_plan import PLAN_FILE
from labkit.storage.files import sha256_of
from labkit.version import __version__


def made_from(
    ranges_mm: float | Sequence[float] | None,
    channels: str | Sequence[str] | None,
    noll: tuple[int, int] | None,
    patience_s: float,
    joint: bool,
    split: bool,
    plain: bool,
    own_plan: bool,
) -> MadeFrom:
    """Return the record of a fit's settings, to which the photographs are still to be added."""
    return MadeFrom(
        "",
        source_digest(),
        own_plan,
        None if ranges_mm is None else tuple(np.atleast_1d(ranges_mm).tolist()),
        None if channels is None else tuple(np.atleast_1d(channels).tolist()),
        noll,
        patience_s,
        joint,
        split,
        plain,
    )


def of_frames(
    settings: MadeFrom, session: Session, failed: Sequence[str], accepted: bool
) -> MadeFrom:
    """Return the record of a fit: its settings, the photographs, and fits that failed."""
    return replace(
        settings,
        frames_sha256=frames_digest(session),
        failed=tuple(failed),
        failed_accepted=accepted,
    )


def frames_digest(session: Session) -> str:
    """Return the SHA-256 of names, kinds, ranges and checksums of a session's photographs."""
    lines = [
        json.dumps([frame.file, frame.kind, frame.range_mm, frame.sha256])
        for frame in session.frames
    ]
    return hashlib.sha256("\n".join(sorted(lines)).encode()).hexdigest()


def why_outdated(content: Content, session: Session, accept_failed: bool) -> str:
    """Return the reason to make results again; empty if they are up to date.

    accept_failed: whether results without fits that failed are accepted
    """
    made = content.made_from
    version = content.labkit_version
    if made is None:
        return f"labkit {version} did not record what its results were made from"
    if made.frames_sha256 != frames_digest(session):
        return "the session has other photographs now"
    as_planned = made.own_plan and made.noll is None
    if as_planned and content.plan_sha256 != sha256_of(session.folder / PLAN_FILE):
        return "the plan was changed"
    if made.numerics_sha256 != source_digest():
        newer = "has other source" if version == __version__ else f"is {__version__} now"
        return f"made by labkit {version}, which {newer}"
    if made.failed and not (accept_failed or made.failed_accepted):
        return "; ".join(made.failed)
    return ""
