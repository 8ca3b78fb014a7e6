"""Share values among tasks: a value travels beside the tasks, and each process keeps it for later tasks."""

from __future__ import annotations

import hashlib
import io
import pickle
import threading
from collections import OrderedDict
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

Value = TypeVar("Value")

KEPT = 8
"""Number of shared values kept by a process: targets, and photographs of the tasks under way."""


@dataclass(frozen=True)
class Shared(Generic[Value]):
    """A handle to a value, known by the digest of its content. In packed tasks it is the digest alone."""

    value: Value = field(compare=False, repr=False)
    digest: str


def share(value: Value) -> Shared[Value]:
    """Return a handle to a value for tasks."""
    return Shared(value, digest_of(value))


def packed(value: object) -> bytes:
    """Return a pickle that is the same for equal values, whatever objects they share."""
    content, shared = pack(value)
    buffer = io.BytesIO()
    pickler = _Packer(buffer)
    pickler.fast = True  # no references back
    pickler.dump(unpacked(content, shared))
    return buffer.getvalue()


def digest_of(value: object) -> str:
    """Return the SHA-256 of a value's content."""
    return hashlib.sha256(packed(value)).hexdigest()


def pack(value: object) -> tuple[bytes, dict[str, object]]:
    """Return a pickle without the shared values in it, and those values by digest."""
    buffer = io.BytesIO()
    pickler = _Packer(buffer)
    pickler.dump(value)
    return buffer.getvalue(), pickler.shared


def unpacked(content: bytes, shared: dict[str, object]) -> Any:
    """Return a packed value with its shared values."""
    return _Unpacker(io.BytesIO(content), shared).load()


def kept(shared: dict[str, object]) -> dict[str, object]:
    """Return shared values as this process kept them from earlier tasks: caches know them by identity."""
    with _lock:
        known = {digest: _kept.get(digest, value) for digest, value in shared.items()}
        _kept.update(known)
        for digest in known:
            _kept.move_to_end(digest)
        while len(_kept) > KEPT:
            _kept.popitem(last=False)
    return known


_lock = threading.Lock()
_kept: OrderedDict[str, object] = OrderedDict()


class _Packer(pickle.Pickler):
    """Pickles handles as digests, and collects their values."""

    def __init__(self, file: io.BytesIO) -> None:
        super().__init__(file, pickle.HIGHEST_PROTOCOL)
        self.shared: dict[str, object] = {}

    def persistent_id(self, found: Any) -> str | None:
        if not isinstance(found, Shared):
            return None
        self.shared[found.digest] = found.value
        return found.digest


class _Unpacker(pickle.Unpickler):
    """Reads digests as handles."""

    def __init__(self, file: io.BytesIO, shared: dict[str, object]) -> None:
        super().__init__(file)
        self._shared = shared

    def persistent_load(self, digest: str) -> Shared[Any]:
        return Shared(self._shared[digest], digest)
