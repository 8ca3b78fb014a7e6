"""Each fit kept on the disk as it ends: one that was killed, or found the disk full in the end, goes on where it was.

What is kept is found by all that went in, task, function and labkit's own source: a fit is the same each time, so what
another one asks for is never taken for it.
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
    """A `Run` that keeps what another one makes, in a folder, and takes from there what is kept.

    A folder that cannot be written to costs no fit: `problem` is None as long as all are kept, or says why not.
    """

    def __init__(self, run: Run, folder: Path) -> None:
        self._run = run
        self._folder = folder
        self.problem: str | None = None

    def __call__(self, function: Callable[[Task], Result], tasks: Sequence[Task]) -> Iterator[tuple[int, Result]]:
        """As of `Run`; what is kept comes first."""
        places = [self._folder / _key(function, task) for task in tasks]
        missing = []
        for index, place in enumerate(places):
            found = _read(place)
            if found is None:
                missing.append(index)
            else:
                yield index, found
        for index, result in self._run(function, [tasks[index] for index in missing]) if missing else ():
            self._keep(places[missing[index]], result)
            yield missing[index], result

    def share(self, value: Value) -> Shared[Value]:
        """A handle for tasks to a value, as the other run has it."""
        return share(self._run, value)

    def clear(self) -> None:
        """Remove what is kept: the results are written."""
        shutil.rmtree(self._folder, ignore_errors=True)

    def _keep(self, place: Path, result: object) -> None:
        try:
            with writing(self._folder):
                self._folder.mkdir(parents=True, exist_ok=True)
            write_atomically(place, pickle.dumps(result))
        except InputError as error:
            self.problem = self.problem or str(error)


class _Unpickler(pickle.Unpickler):
    """Of labkit's own data classes and NumPy's arrays: a session from elsewhere may hold any file, but runs nothing."""

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
    """What is kept there; None if nothing is that can be read."""
    with suppress(Exception):  # unpickling what is damaged raises what it likes; such a fit is made again
        return _Unpickler(io.BytesIO(place.read_bytes())).load()
    return None


def _key(function: Callable[..., object], task: object) -> str:
    """The same for equal tasks, whatever objects they have in common."""
    name = f"{_source()} {function.__module__}.{function.__qualname__}\n".encode()
    return hashlib.sha256(name + packed(task)).hexdigest()


@cache
def _source() -> str:
    """Of labkit as it is installed."""
    digest = hashlib.sha256()
    for path in sorted(Path(str(labkit.__file__)).parent.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()
