"""Keep completed fits on disk, so that an interrupted fit of a session continues.

A fit is deterministic. Its file is named by a hash of all inputs: task, function and labkit's own source. A fit with other
inputs never takes it.
"""

from __future__ import annotations

import hashlib
import io
import pickle
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import is_dataclass
from functools import cache
from pathlib import Path
from typing import Any

import labkit
from labkit.errors import InputError
from labkit.execute import Result, Run, Task
from labkit.files import write_atomically, writing
from labkit.sharing import Shared, Value, packed, share

FOLDER = ".fits"


class KeptFits:
    """A `Run` that stores the results of another run in a folder, and reads stored results instead of computing them again.

    If the folder cannot be written, fits continue, and `problem` states the reason; it is None otherwise.
    """

    def __init__(self, run: Run, folder: Path) -> None:
        self._run = run
        self._folder = folder
        self.problem: str | None = None

    def __call__(
        self, function: Callable[[Task], Result], tasks: Sequence[Task]
    ) -> Iterator[tuple[int, Result]]:
        """Map tasks, see `Run`; stored results come first."""
        places = [self._folder / _key(function, task) for task in tasks]
        missing = []
        for index, place in enumerate(places):
            found = _read(place)
            if found is None:
                missing.append(index)
            else:
                yield index, found
        for index, result in (
            self._run(function, [tasks[index] for index in missing]) if missing else ()
        ):
            self._keep(places[missing[index]], result)
            yield missing[index], result

    def share(self, value: Value) -> Shared[Value]:
        """Return the other run's handle to a value."""
        return share(self._run, value)

    def clear(self) -> None:
        """Remove all stored results, for the session's results are written."""
        shutil.rmtree(self._folder, ignore_errors=True)

    def _keep(self, place: Path, result: object) -> None:
        try:
            with writing(self._folder):
                self._folder.mkdir(parents=True, exist_ok=True)
            write_atomically(place, pickle.dumps(result))
        except InputError as error:
            self.problem = self.problem or str(error)


class _Unpickler(pickle.Unpickler):
    """An unpickler for labkit's data classes and NumPy's arrays only: a file of a foreign session cannot run code."""

    NUMPY = ("ndarray", "dtype", "_reconstruct", "_frombuffer", "scalar")

    def find_class(self, module: str, name: str) -> Any:
        if module.partition(".")[0] == "numpy" and name in self.NUMPY:
            return super().find_class(module, name)
        if module.partition(".")[0] == "labkit" and "." not in name:
            found = super().find_class(module, name)
            if isinstance(found, type) and is_dataclass(found):
                return found
        raise pickle.UnpicklingError(f"{module}.{name} is no part of a fit")


def _read(place: Path) -> Any:
    """Read a stored result; None if there is none, or if it cannot be read."""
    with suppress(
        Exception
    ):  # unpickling what is damaged raises what it likes; such a fit is made again
        return _Unpickler(io.BytesIO(place.read_bytes())).load()
    return None


def _key(function: Callable[..., object], task: object) -> str:
    """Return a hash that is the same for equal tasks, whatever objects they share."""
    name = f"{_source()} {function.__module__}.{function.__qualname__}\n".encode()
    return hashlib.sha256(name + packed(task)).hexdigest()


@cache
def _source() -> str:
    """Return a hash of labkit's installed source."""
    digest = hashlib.sha256()
    for path in sorted(Path(str(labkit.__file__)).parent.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()
