"""Keep completed fits on disk, so that an interrupted fit of a session continues.

A fit is deterministic. Its file is named by a hash of all inputs: task, function, and the
versions of labkit's numerics and of the libraries below. A fit with other inputs never takes the file. Each file is signed with
a secret of the user, because sessions travel: a stored fit from another user, or an altered
one, is computed again.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
import shutil
import typing
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Any

from labkit.errors import InputError
from labkit.findings.findings import Finding, found
from labkit.jobs.execute import Result, Run, Task
from labkit.jobs.sharing import packed
from labkit.numerics import versions
from labkit.storage import typed_file
from labkit.storage.files import (
    drop_link,
    kept_secret,
    state_folder,
    write_atomically,
    writing,
)
from labkit.storage.reading import read_bytes

FOLDER = ".fits"

MOST_FIT_BYTES = 2**30

SIGNATURE_BYTES = hashlib.sha256().digest_size


class KeptFits:
    """A `Run` that stores the results of another run in a folder and reads stored results back.

    Functions must annotate the type of their results, which `typed_file` writes. If the
    folder cannot be written, fits continue, and `problem` states the reason; it is None
    otherwise.
    """

    def __init__(self, run: Run, folder: Path) -> None:
        self._run = run
        self._folder = folder
        self._refused = 0
        self.problem: str | None = None

    def __call__(
        self, function: Callable[[Task], Result], tasks: Sequence[Task]
    ) -> Iterator[tuple[int, Result]]:
        """Map tasks, see `Run`; stored results come first."""
        kind = typing.get_type_hints(function)["return"]
        places = [self._folder / _key(function, task) for task in tasks]
        missing = []
        for index, place in enumerate(places):
            kept = self._read(place, kind)
            if kept is None:
                missing.append(index)
            else:
                yield index, kept
        for index, result in (
            self._run(function, [tasks[index] for index in missing]) if missing else ()
        ):
            self._keep(places[missing[index]], typed_file.dump(result, kind))
            yield missing[index], result

    @property
    def findings(self) -> list[Finding]:
        """Stored results that were not used because they are altered or from another user."""
        if not self._refused:
            return []
        folder = str(self._folder)
        return [found("kept-fits-refused", count=self._refused, folder=folder)]

    def clear(self) -> None:
        """Remove all stored results, for the session's results are written."""
        shutil.rmtree(self._folder, ignore_errors=True)

    def _keep(self, place: Path, content: bytes) -> None:
        try:
            with writing(self._folder):
                drop_link(self._folder)
                self._folder.mkdir(parents=True, exist_ok=True)
            write_atomically(place, self._signature(place, content) + content)
        except InputError as error:
            self.problem = self.problem or str(error)

    def _read(self, place: Path, kind: Any) -> Any:
        """Read a stored result; None if there is none, or if its signature is wrong."""
        if self._folder.is_symlink():
            return None
        try:
            signed = read_bytes(place, MOST_FIT_BYTES)
            signature = signed[:SIGNATURE_BYTES]
            content = signed[SIGNATURE_BYTES:]
            if hmac.compare_digest(signature, self._signature(place, content)):
                return typed_file.load(content, kind)
        except FileNotFoundError:
            return None
        except (OSError, ValueError):
            pass
        self._refused += 1
        return None

    def _signature(self, place: Path, content: bytes) -> bytes:
        """Return a signature that only the user's secret can make."""
        return hmac.digest(self._secret, place.name.encode() + content, "sha256")

    @cached_property
    def _secret(self) -> bytes:
        with suppress(RuntimeError):  # a user without a home keeps fits for this run only
            return kept_secret(state_folder() / "kept-fits").encode()
        return secrets.token_bytes()


def _key(function: Callable[..., object], task: object) -> str:
    """Return a hash that is the same for equal tasks, whatever objects they share."""
    name = f"{versions()} {function.__module__}.{function.__qualname__}\n".encode()
    return hashlib.sha256(name + packed(task)).hexdigest()
