"""Share values among tasks: a value travels once to each process, for any number of tasks."""

from __future__ import annotations

import hashlib
import io
import pickle
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

Value = TypeVar("Value")
Kept = TypeVar("Kept", covariant=True)


class Shared(Protocol[Kept]):
    """A handle to a value, small enough to be part of a task."""

    @property
    def value(self) -> Kept:
        """The value, wherever the task runs."""
        ...


@dataclass(frozen=True)
class Carried(Generic[Value]):
    """A value that travels with each task, for runs without shared values."""

    value: Value


@dataclass(frozen=True)
class Stored(Generic[Value]):
    """A shared value, read by its digest in the task's process."""

    digest: str

    @property
    def value(self) -> Value:
        """The value; LookupError outside a task."""
        found: Value = _lookup.get()(self.digest)
        return found


def _nowhere(digest: str) -> Any:
    raise LookupError(f"shared value {digest[:8]} was asked for outside of a task")


_lookup: ContextVar[Callable[[str], Any]] = ContextVar("lookup", default=_nowhere)


@contextmanager
def looked_up_by(lookup: Callable[[str], Any]) -> Iterator[None]:
    """Look up shared values by a function of their digests, within a `with` block."""
    token = _lookup.set(lookup)
    try:
        yield
    finally:
        _lookup.reset(token)


def share(run: object, value: Value) -> Shared[Value]:
    """Return a handle to a value for a run's tasks: the run's own if it has `share`, else a handle that carries the value."""
    own: Callable[[Value], Shared[Value]] = getattr(run, "share", Carried)
    return own(value)


def packed(value: object) -> bytes:
    """Return a pickle that is the same for equal values, whatever objects they share."""
    buffer = io.BytesIO()
    pickler = pickle.Pickler(buffer)
    pickler.fast = True  # no references back
    pickler.dump(pickle.loads(pickle.dumps(value)))
    return buffer.getvalue()


def digest_of(value: object) -> str:
    """Return the SHA-256 of a value's content."""
    return hashlib.sha256(packed(value)).hexdigest()
